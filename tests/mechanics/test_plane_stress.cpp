// Sheets in plane stress: the equilibrium of quadrilaterals against exact states and against thin plates of hexahedra.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>
#include <set>

#include "box.hpp"
#include "imic3d/mechanics/equilibrium.hpp"

namespace imic3d::mechanics {
namespace test_plane_stress {

/// n[0] x n[1] quads on [0, size]; interior nodes moved at random by `distortion` of the cell size.
mesh::Mesh sheet(std::array<int, 2> n, Eigen::Vector2d size, double thickness, double distortion = 0.0) {
  const mesh::Mesh solid = testing::box({n[0], n[1], 1}, {size[0], size[1], 1.0});
  mesh::Mesh mesh;
  mesh.type = mesh::CellType::quad4;
  mesh.thickness = thickness;
  const Eigen::Index nodes = solid.nodes.rows() / 2;
  mesh.nodes = solid.nodes.topRows(nodes);
  mesh.cells = solid.cells.leftCols(4);
  for (const char* end : {"left", "right"})
    for (int node : solid.node_groups.at(end))
      if (node < nodes) mesh.node_groups[end].push_back(node);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> shift(-distortion, distortion);
  for (Eigen::Index i = 0; i < nodes; ++i) {
    const bool inside =
        mesh.nodes(i, 0) > 0 && mesh.nodes(i, 0) < size[0] && mesh.nodes(i, 1) > 0 && mesh.nodes(i, 1) < size[1];
    if (!inside) mesh.node_groups["boundary"].push_back(static_cast<int>(i));
    if (inside)
      for (int k = 0; k < 2; ++k) mesh.nodes(i, k) += shift(random) * size[k] / n[static_cast<std::size_t>(k)];
  }
  return mesh;
}

std::vector<int> plane_dofs(const std::vector<int>& nodes) {
  std::vector<int> dofs;
  for (int node : nodes) dofs.insert(dofs.end(), {3 * node, 3 * node + 1});
  return dofs;
}

std::shared_ptr<const material::FiniteStrainLaw> power_linear(bool plane_stress = true) {
  return material::make_law({.hardening = "power_linear", .tie_initial_modulus = true, .plane_stress = plane_stress});
}
const std::vector<double> steel = {198e3, 0.25, 284.0, 1480.0, 0.042};

/// A homogeneous deformation prescribed on the boundary must be found in the interior of a distorted mesh.
void patch_test(const mesh::Mesh& mesh) {
  const Communicator world;
  const mesh::Partition partition = mesh::partition(mesh, world);
  Eigen::Matrix2d G;
  G << 0.08, 0.03, 0.01, -0.03;
  const auto dofs = plane_dofs(mesh.node_groups.at("boundary"));
  Equilibrium equilibrium(partition, mesh, power_linear(), dofs, {});
  std::vector<LoadStep> steps;
  for (double s : {0.5, 1.0}) {
    LoadStep step{.time = s, .prescribed = Eigen::VectorXd(static_cast<Eigen::Index>(dofs.size())), .force = {}};
    for (std::size_t i = 0; i < dofs.size(); ++i)
      step.prescribed[static_cast<Eigen::Index>(i)] = s * G.row(dofs[i] % 3).dot(mesh.nodes.row(dofs[i] / 3).head<2>());
    steps.push_back(step);
  }
  double worst = 0.0, spread = 0.0, plastic = 0.0, thickness_stress = 0.0;
  const auto status = equilibrium.run(steps, steel, 0.0, [&](int t, const FrameState& state) {
    for (Eigen::Index node = 0; node < mesh.nodes.rows(); ++node) {
      const Eigen::Vector2d exact =
          steps[static_cast<std::size_t>(t)].time * G * mesh.nodes.row(node).head<2>().transpose();
      worst =
          std::max(worst, (state.displacement.segment<3>(3 * node) - Eigen::Vector3d(exact[0], exact[1], 0.0)).norm());
    }
    const Eigen::RowVectorXd mean = state.cauchy_stress.colwise().mean();
    spread = (state.cauchy_stress.rowwise() - mean).norm() / state.cauchy_stress.norm();
    thickness_stress = state.cauchy_stress.rightCols<2>().norm() + state.cauchy_stress.col(2).norm();
    plastic = state.plastic_strain.minCoeff();
    thickness_stress /= state.cauchy_stress.norm();
  });
  ASSERT_EQ(status.frames, 2) << status.message;
  EXPECT_GT(plastic, 0.01);
  EXPECT_LT(worst, 1e-10);
  EXPECT_LT(spread, 1e-10);
  EXPECT_LT(thickness_stress, 1e-12);
}

TEST(PlaneStress, PatchTestOnDistortedQuadrilaterals) { patch_test(sheet({4, 4}, {1.0, 1.2}, 0.3, 0.25)); }
TEST(PlaneStress, PatchTestOnDistortedQuadraticQuadrilaterals) {
  patch_test(mesh::quadratic(sheet({4, 4}, {1.0, 1.2}, 0.3, 0.25)));
}

void newton_order(const mesh::Mesh& mesh) {
  const Communicator world;
  const mesh::Partition partition = mesh::partition(mesh, world);
  std::set<int> ends(mesh.node_groups.at("left").begin(), mesh.node_groups.at("left").end());
  ends.insert(mesh.node_groups.at("right").begin(), mesh.node_groups.at("right").end());
  const auto dofs = plane_dofs({ends.begin(), ends.end()});
  Equilibrium equilibrium(partition, mesh, power_linear(), dofs, {.tolerance = 1e-13, .keep_factors = false});
  LoadStep step{.time = 1.0, .prescribed = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(dofs.size())), .force = {}};
  for (std::size_t i = 0; i < dofs.size(); ++i)
    if (mesh.nodes(dofs[i] / 3, 0) > 2.0) step.prescribed[static_cast<Eigen::Index>(i)] = dofs[i] % 3 == 0 ? 0.3 : 0.1;
  const auto status = equilibrium.run(
      {step}, steel, 0.0, [](int, const FrameState& state) { EXPECT_GT(state.plastic_strain.minCoeff(), 0.01); });
  ASSERT_EQ(status.frames, 1) << status.message;
  const auto& r = status.residuals;
  double order = 0.0;
  for (std::size_t i = 2; i < r.size(); ++i)
    if (r[i - 1] < 1e-2 && r[i] > 1e-12 && r[i] < r[i - 1])
      order = std::max(order, std::log(r[i]) / std::log(r[i - 1]));
  // log r_{k+1} / log r_k: 2 for quadratic convergence of a residual that is relative already.
  EXPECT_GE(order, 1.8) << ::testing::PrintToString(r);
  EXPECT_LT(r.size(), 12U);
}

TEST(PlaneStress, NewtonConvergesQuadratically) { newton_order(sheet({4, 2}, {4.0, 1.0}, 1.0, 0.2)); }
TEST(PlaneStress, NewtonConvergesQuadraticallyOnQuadraticQuadrilaterals) {
  newton_order(mesh::quadratic(sheet({4, 2}, {4.0, 1.0}, 1.0, 0.2)));
}

/// Tension of a strip: the force is thickness x width x stress of the closed form, also under prescribed force.
TEST(PlaneStress, AStripInTensionFollowsTheClosedForm) {
  const double thickness = 0.4, width = 2.0, length = 5.0, strain = 0.1;
  const mesh::Mesh mesh = sheet({5, 3}, {length, width}, thickness, 0.2);
  const Communicator world;
  const mesh::Partition partition = mesh::partition(mesh, world);
  std::set<int> dofs;
  for (const char* end : {"left", "right"})
    for (int node : mesh.node_groups.at(end)) dofs.insert(3 * node);
  dofs.insert(3 * mesh.node_groups.at("left").front() + 1);
  LoadStep step{.time = 1.0, .prescribed = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(dofs.size())), .force = {}};
  Eigen::Index row = 0;
  for (int dof : dofs) step.prescribed[row++] = mesh.nodes(dof / 3, 0) > 1.0 ? length * (std::exp(strain) - 1.0) : 0.0;
  double force = 0.0, narrowing = 0.0, stress = 0.0;
  Equilibrium equilibrium(partition, mesh, power_linear(), {dofs.begin(), dofs.end()}, {});
  const auto status = equilibrium.run({step}, steel, 0.0, [&](int, const FrameState& state) {
    const auto& end = mesh.node_groups.at("right");
    for (int node : end) force += state.internal[3 * node];
    narrowing = state.displacement[3 * end.back() + 1] - state.displacement[3 * end.front() + 1];
    stress = state.cauchy_stress.col(0).mean();
  });
  ASSERT_EQ(status.frames, 1) << status.message;
  // tau = E (strain - p) = sigma_y(p); the nominal stress is tau / stretch, the true one tau / J.
  double low = 0.0, high = strain;
  for (int i = 0; i < 200; ++i) {
    const double p = 0.5 * (low + high);
    (198e3 * (strain - p) > 1480 * p + 284 * std::pow(1 + p / (0.042 * 284 / (198e3 - 1480)), 0.042) ? low : high) = p;
  }
  const double tau = 198e3 * (strain - low), lateral = -0.5 * low - 0.25 * tau / 198e3;
  EXPECT_NEAR(force / (thickness * width * tau * std::exp(-strain)), 1.0, 1e-10);
  EXPECT_NEAR(narrowing / (width * std::expm1(lateral)), 1.0, 1e-9);
  EXPECT_NEAR(stress / (tau * std::exp(-strain - 2.0 * lateral)), 1.0, 1e-10);
}

/// A sheet and a plate of hexahedra, the same elements in the plane: as the plate gets thinner, force and displacement
/// of a clamped strip tend to the sheet's. Two thicknesses tell a limit from a coincidence.
TEST(PlaneStress, IsTheLimitOfAThinPlate) {
  const Eigen::Vector2d size(2.0, 1.0);
  const auto pull = [&](const mesh::Mesh& mesh, double* transverse) {
    const Communicator world;
    const mesh::Partition partition = mesh::partition(mesh, world);
    const bool plane = mesh::dimension(mesh.type) == 2;
    std::set<int> dofs;
    for (const char* end : {"left", "right"})
      for (int node : mesh.node_groups.at(end)) dofs.insert({3 * node, 3 * node + 1});
    for (Eigen::Index node = 0; !plane && node < mesh.nodes.rows(); ++node)  // mid-plane
      if (mesh.nodes(node, 2) == 0.0) dofs.insert(3 * static_cast<int>(node) + 2);
    LoadStep step{
        .time = 1.0, .prescribed = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(dofs.size())), .force = {}};
    Eigen::Index row = 0;
    for (int dof : dofs) step.prescribed[row++] = dof % 3 == 0 && mesh.nodes(dof / 3, 0) > 1.0 ? 0.04 : 0.0;
    double force = 0.0;
    Equilibrium equilibrium(partition, mesh, power_linear(plane), {dofs.begin(), dofs.end()}, {.increments = 4});
    const auto status = equilibrium.run({step}, steel, 0.0, [&](int, const FrameState& state) {
      for (int node : mesh.node_groups.at("right")) force += state.internal[3 * node];
      for (Eigen::Index node = 0; node < mesh.nodes.rows(); ++node)
        if ((mesh.nodes.row(node) - Eigen::RowVector3d(1.0, 1.0, 0.0)).norm() < 1e-9)
          *transverse = state.displacement[3 * node + 1];
      EXPECT_GT(state.plastic_strain.maxCoeff(), 0.02);
    });
    EXPECT_EQ(status.frames, 1) << status.message;
    return force;
  };
  double of_sheet = 0.0;
  const double sheet_stress = pull(mesh::quadratic(sheet({8, 6}, size, 1.0)), &of_sheet);
  std::vector<double> force_error, displacement_error;
  for (double half : {0.1, 0.02}) {
    double of_plate = 0.0;
    const double stress = pull(mesh::quadratic(testing::box({8, 6, 1}, {size[0], size[1], half})), &of_plate) / half;
    force_error.push_back(std::abs(stress / sheet_stress - 1.0));
    displacement_error.push_back(std::abs(of_plate / of_sheet - 1.0));
  }
  std::printf(
      "thin plate against sheet: force %.2e, %.2e, transverse displacement %.2e, %.2e (half thickness 0.1, 0.02)\n",
      force_error[0], force_error[1], displacement_error[0], displacement_error[1]);
  EXPECT_LT(force_error[1], 1e-3);
  EXPECT_LT(displacement_error[1], 3e-3);
  EXPECT_LT(force_error[1], 0.5 * force_error[0]);
  EXPECT_LT(displacement_error[1], 0.5 * displacement_error[0]);
}

TEST(PlaneStress, AThreeDimensionalLawOnASheetIsRefused) {
  const mesh::Mesh mesh = sheet({1, 1}, {1.0, 1.0}, 1.0);
  const mesh::Partition partition = mesh::partition(mesh, Communicator{MPI_COMM_SELF});
  EXPECT_THROW(Equilibrium(partition, mesh, power_linear(false), {}, {}), InputError);
  const mesh::Mesh solid = testing::box({1, 1, 1}, {1.0, 1.0, 1.0});
  const mesh::Partition parts = mesh::partition(solid, Communicator{MPI_COMM_SELF});
  EXPECT_THROW(Equilibrium(parts, solid, power_linear(), {}, {}), InputError);
}

}  // namespace test_plane_stress
}  // namespace imic3d::mechanics
