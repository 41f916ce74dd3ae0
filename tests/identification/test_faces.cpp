// Two faces, seen with two and with three components: geometry, rigid motion, identification, and the calibration's
// share.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_faces {

using testing::Plate;

constexpr double thickness = 1.0;

/// The strip with two layers (the front one alone with `half`), its front seen with two components and its back with
/// three.
Specimen two_faces(bool half) {
  return make_specimen(mesh::extrude(testing::strip(), half ? 0.5 * thickness : thickness, half ? 1 : 2), "bottom",
                       "top", 1, half, "specimen", {{.back = false, .components = 2}, {.back = true, .components = 3}});
}

/// A displacement [3 * nodes] from a formula.
template <class Field>
Eigen::VectorXd nodal(const mesh::Nodes& nodes, const Field& field) {
  Eigen::VectorXd u(3 * nodes.rows());
  for (Eigen::Index i = 0; i < nodes.rows(); ++i)
    u.segment<3>(3 * i) = field(Eigen::Vector3d(nodes.row(i).transpose()));
  return u;
}

TEST(Faces, MeansOverSquares) {
  const mesh::Mesh fine = testing::strip(60, 80);
  const Eigen::Matrix<double, Eigen::Dynamic, 2> at = Eigen::RowVector2d(0.4, 4.3);
  const Eigen::VectorXd x = fine.nodes.col(0), y = fine.nodes.col(1);
  const double side = 1.2;
  const auto mean = [&](const Eigen::VectorXd& field) { return (means_over_squares(fine, at, side) * field)[0]; };
  EXPECT_NEAR(mean(Eigen::VectorXd::Ones(x.size())), 1.0, 1e-12);
  EXPECT_NEAR(mean(x + 2.0 * y), 0.4 + 2.0 * 4.3, 1e-9);
  const double chords =
      0.1 * 0.1 / 6.0;  // by which straight lines between nodes are above a parabola, no more in the mean
  EXPECT_NEAR(mean(x.cwiseAbs2()), 0.4 * 0.4 + side * side / 12.0, 1.5 * chords);
  EXPECT_NEAR(mean(y.cwiseAbs2()), 4.3 * 4.3 + side * side / 12.0, 1.5 * chords);
  EXPECT_NEAR(mean(x.cwiseProduct(y)), 0.4 * 4.3, 1.5 * chords);
  EXPECT_EQ((Eigen::MatrixXd(means_over_squares(fine, at, 0.0)) - Eigen::MatrixXd(interpolation(fine, at))).norm(),
            0.0);
}

TEST(Faces, ShowTheFieldThatTheVolumeHas) {
  const auto affine = [](const Eigen::Vector3d& x) -> Eigen::Vector3d {
    return Eigen::Matrix3d{{0.01, 0.02, -0.03}, {0.04, -0.01, 0.05}, {0.02, 0.03, -0.02}} * x +
           Eigen::Vector3d(0.1, 0.2, 0.3);
  };
  const auto symmetric = [](const Eigen::Vector3d& x) {  // about the mid-plane
    return Eigen::Vector3d(0.01 * x[0] + 0.02 * x[1], 0.03 * x[1], -0.02 * (x[2] + 0.5 * thickness));
  };
  const auto check = [](const Specimen& specimen, const auto& field, double tolerance) {
    ASSERT_EQ(specimen.faces.size(), 2U);
    const Face& back = specimen.faces[1];
    EXPECT_NEAR((back.surface.mesh.nodes.col(2).array() + thickness).abs().maxCoeff(), 0.0, 1e-12);
    for (Eigen::Index e = 0; e < back.surface.mesh.cells.rows(); ++e) {  // counter-clockwise in x and y
      const auto at = [&](int k) -> Eigen::Vector3d {
        return back.surface.mesh.nodes.row(back.surface.mesh.cells(e, k)).transpose();
      };
      EXPECT_GT((at(2) - at(0)).cross(at(3) - at(1))[2], 0.0);
    }
    const Eigen::VectorXd volume = nodal(specimen.volume.nodes, field), seen = specimen.project(volume);
    const Eigen::VectorXd all = specimen.three_components(seen, 7.0), truth = nodal(specimen.surface.mesh.nodes, field);
    for (Eigen::Index i = 0; i < specimen.surface.mesh.nodes.rows(); ++i)
      for (int a = 0; a < 3; ++a)
        EXPECT_NEAR(all[3 * i + a], a == 2 && i < specimen.faces[0].nodes() ? 7.0 : truth[3 * i + a], tolerance);
    const Eigen::VectorXd ends = specimen.displacement_from_surface * seen;
    for (std::size_t k = 0; k < specimen.displacement_dofs.size(); ++k) {
      const int dof = specimen.displacement_dofs[k];
      EXPECT_NEAR(ends[static_cast<Eigen::Index>(k)], dof % 3 == 2 ? 0.0 : volume[dof], tolerance);
    }
  };
  check(two_faces(false), affine, 1e-12);
  check(two_faces(true), symmetric, 1e-12);
}

TEST(Faces, ForceLeavesSixRigidMotionsToTheImagesAndDisplacementThree) {
  const Specimen specimen = two_faces(false);
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(2e-4, Eigen::Vector3d(0.5, -0.7, 0.4).normalized()).toRotationMatrix();
  const auto bent = [](const Eigen::Vector3d& x) {
    return Eigen::Vector3d(0.001 * x[1] * x[1], 0.02 * x[1], 5e-4 * x[0] * x[1]);
  };
  const auto moved = [&](const Eigen::Vector3d& x) -> Eigen::Vector3d {
    return turn * (x + bent(x)) + Eigen::Vector3d(0.02, -0.01, 0.05) - x;
  };
  const Eigen::VectorXd here = specimen.project(nodal(specimen.volume.nodes, bent)),
                        there = specimen.project(nodal(specimen.volume.nodes, moved));
  Eigen::SparseMatrix<double> M(here.size(), here.size());
  for (Eigen::Index i = 0; i < here.size(); ++i) M.insert(i, i) = 1.0 + 0.2 * static_cast<double>(i % 5);
  Path path{.frames = 1,
            .surface = here,
            .reaction = {},
            .limit_point = false,
            .message = {},
            .newton_iterations = 0,
            .increments = {}};
  fit_rigid_motion(specimen, Control::force, M, there, path);
  // First order in the rotation; u_z of the front is not seen, so that the lever of its in-plane motion lacks it: 0.012
  // mm.
  EXPECT_LT((path.surface - there).cwiseAbs().maxCoeff(), 4e-6);
  EXPECT_GT((here - there).cwiseAbs().maxCoeff(), 0.03);
  EXPECT_EQ(rigid_modes(specimen, Control::force, here).cols(), 6);
  EXPECT_EQ(rigid_modes(specimen, Control::displacement, here).cols(), 3);
  EXPECT_EQ(rigid_modes(specimen, Control::images, here).cols(), 0);
  const Specimen one = make_specimen(mesh::extrude(testing::strip(), thickness, 2), "bottom", "top", 1, false);
  EXPECT_EQ(rigid_modes(one, Control::force, Eigen::VectorXd::Zero(one.projection.rows())).cols(), 3);
  EXPECT_EQ(rigid_modes(one, Control::displacement, Eigen::VectorXd::Zero(one.projection.rows())).cols(), 0);
}

const std::vector<double> stretch = {0.003, 0.005, 0.008, 0.02, 0.06, 0.12};
const Stage stage{.free = {0, 2}, .frames = {0, 1, 2, 3, 4, 5}};

/// The specimen leans towards the cameras while it is pulled, by up to six times `angle` about x and 4 times about y:
/// what the images show is not where the simulation holds it.
void lean(Plate& plate, double angle) {
  const auto& faces = plate.specimen.faces;
  const Eigen::Index nodes = faces[0].nodes();  // both faces have the same order
  for (Eigen::Index t = 0; t < plate.record.force.size(); ++t) {
    const auto part = static_cast<double>(t + 1);
    const Eigen::Matrix3d turn = (Eigen::AngleAxisd(angle * part, Eigen::Vector3d::UnitX()) *
                                  Eigen::AngleAxisd(-2.0 / 3.0 * angle * part, Eigen::Vector3d::UnitY()))
                                     .toRotationMatrix();
    Eigen::VectorXd all = plate.specimen.three_components(plate.record.surface_displacement.col(t));
    for (Eigen::Index i = 0; i < nodes; ++i) all[3 * i + 2] = -all[3 * (nodes + i) + 2];  // unseen, by symmetry
    for (const Face& face : faces)
      for (Eigen::Index i = 0; i < face.nodes(); ++i) {
        const Eigen::Vector3d X = face.surface.mesh.nodes.row(i).transpose(),
                              x = X + all.segment<3>(3 * (face.first_node + i));
        const Eigen::Vector3d u = turn * x + Eigen::Vector3d(0.0, 0.0, 0.01 * part) - X;
        for (int a = 0; a < face.components; ++a)
          plate.record.surface_displacement(face.first_unknown + face.components * i + a, t) = u[a];
      }
  }
  plate.record.driving = without_leaning(plate.specimen, plate.record.surface_displacement);
}

TEST(Faces, ParametersAreFoundWhateverTheSpecimenDoesThroughItsPlane) {
  const Communicator world;
  for (const double angle : {3e-4, 6e-3})
    for (const auto functional : {Functional::force_driven, Functional::displacement_driven}) {
      Plate plate(stretch, two_faces(true));
      lean(plate, angle);
      ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
      auto parameters = plate.truth;
      parameters[0] *= 0.9, parameters[2] *= 1.1;
      const auto result = gauss_newton(world, model, plate.images, testing::information(plate), stage,
                                       {.functional = functional, .eta = 1e-4}, parameters);
      EXPECT_TRUE(result.converged);
      std::printf("leaning: E %+.1e, S_y %+.1e\n", parameters[0] / plate.truth[0] - 1.0,
                  parameters[2] / plate.truth[2] - 1.0);
      // u_z of the front is not seen
      const double tolerance = functional == Functional::force_driven ? 2e-4 : angle < 1e-3 ? 1e-3 : 4e-3;
      EXPECT_NEAR(parameters[0] / plate.truth[0], 1.0, tolerance);
      EXPECT_NEAR(parameters[2] / plate.truth[2], 1.0, tolerance);
    }
}

/// An error of the cameras' numbers, here a scale and a shear of what the front's camera measures, moves the parameters
/// as far as the covariance's share says.
TEST(Faces, ShareOfTheCalibrationIsWhatWrongCamerasDo) {
  const Communicator world;
  for (const auto functional : {Functional::force_driven, Functional::displacement_driven}) {
    Plate plate(stretch, two_faces(true));
    Eigen::MatrixXd error = Eigen::MatrixXd::Zero(plate.record.surface_displacement.rows(), plate.record.force.size());
    const Face& front = plate.specimen.faces.front();
    for (Eigen::Index i = 0; i < front.unknowns(); ++i) error.row(i) = 5e-4 * plate.record.surface_displacement.row(i);
    for (Eigen::Index i = 0; i < front.nodes(); ++i)
      error.row(2 * i) += 1e-4 * plate.record.surface_displacement.row(2 * i + 1);
    GaussNewtonOptions options{.functional = functional, .eta = 1e-5, .force_noise = 5.0};
    options.noise_model = {
        .image = 1.0, .references = 1, .force = 1.0, .driving = {}, .calibration = {error}, .draws = 2, .seed = 5};
    ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
    auto parameters = plate.truth;
    const auto predicted =
        gauss_newton(world, model, plate.images, testing::information(plate), stage, options, parameters).covariance;

    auto same = plate.truth;  // the other shares are as if the cameras were certain
    options.noise_model.calibration.clear();
    const auto certain =
        gauss_newton(world, model, plate.images, testing::information(plate), stage, options, same).covariance;
    EXPECT_EQ(certain.calibration.norm(), 0.0);
    EXPECT_LT((predicted.total - predicted.calibration - certain.total).norm(), 1e-6 * certain.total.norm());

    plate.record.surface_displacement += error;
    plate.record.driving += error;
    ForwardModel wrong(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
    auto found = plate.truth;
    options.noise_model = {};
    const auto result = gauss_newton(world, wrong, plate.images, testing::information(plate), stage, options, found);
    EXPECT_TRUE(result.converged);
    for (int j = 0; j < 2; ++j) {
      const double moved = std::abs(found[static_cast<std::size_t>(stage.free[static_cast<std::size_t>(j)])] -
                                    plate.truth[static_cast<std::size_t>(stage.free[static_cast<std::size_t>(j)])]);
      const double share = std::sqrt(predicted.calibration(j, j));
      EXPECT_GT(moved, 0.0);
      EXPECT_NEAR(share / moved, 1.0, 0.05) << "parameter " << j;
      std::printf("calibration, parameter %d: moved %.4g, predicted %.4g\n", j, moved, share);
    }
  }
}

}  // namespace test_faces
}  // namespace imic3d::identification
