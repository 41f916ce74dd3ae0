// Derivatives of whole paths by the parameters of the law, direct differentiation against differences of simulations.
#include <gtest/gtest.h>
#include <petscsys.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <numeric>
#include <set>

#include "box.hpp"
#include "imic3d/mechanics/equilibrium.hpp"

namespace imic3d::mechanics {
namespace test_sensitivities {

enum class Driven { by_displacement, by_force, by_images };

struct LawCase {
  std::string name;
  material::LawChoice choice;
  std::vector<double> parameters;
};

const LawCase power{
    "power_linear", {.hardening = "power_linear", .tie_initial_modulus = true}, {198e3, 0.25, 284.0, 4480.0, 0.042}};
const LawCase all{"voce, kinematic, Hill, rate",
                  {.hardening = "voce", .effects = {"kinematic", "hill", "rate"}},
                  {198e3, 0.25, 284, 400, 10, 3500, 20e3, 150, 1.2, 0.9, 1.1, 20, 0.005, 1e-3}};
const LawCase kinematic{
    "kinematic", {.hardening = "linear", .effects = {"kinematic"}}, {198e3, 0.25, 284, 4900, 20e3, 150}};
const std::vector<LawCase> laws = {
    power,
    {"power_linear in Cauchy stress",
     {.hardening = "power_linear", .cauchy_yield = true},
     {198e3, 0.25, 264.0, 4480.0, 0.05, 2e-3}},
    {"voce", {.hardening = "voce"}, {198e3, 0.25, 284, 400, 10, 3500}},
    kinematic,
    {"Hill", {.hardening = "linear", .effects = {"hill"}}, {198e3, 0.25, 284, 4900, 1.2, 0.9, 1.1, 20}},
    {"rate", {.hardening = "linear", .effects = {"rate"}}, {198e3, 0.25, 284, 4900, 0.005, 1e-3}},
    all};

/// A bar along x whose section and so the stress is not uniform, 3 cells long.
mesh::Mesh bar(mesh::CellType type) {
  mesh::Mesh mesh = testing::box({3, 2, 1}, {3.0, 1.5, 0.5});
  if (mesh::dimension(type) == 2) {
    const Eigen::Index nodes = mesh.nodes.rows() / 2;
    mesh.type = mesh::CellType::quad4;
    mesh.thickness = 0.5;
    mesh.nodes = Eigen::MatrixXd(mesh.nodes.topRows(nodes));
    mesh.cells = mesh::Cells(mesh.cells.leftCols(4));
    for (auto& [name, group] : mesh.node_groups) std::erase_if(group, [&](int node) { return node >= nodes; });
  }
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) mesh.nodes(i, 1) *= 1.0 - 0.07 * mesh.nodes(i, 0);
  return type == mesh::CellType::hex20 || type == mesh::CellType::quad8 ? mesh::quadratic(std::move(mesh)) : mesh;
}

/// What the test looks at, all frames one after another.
struct Path {
  Eigen::VectorXd displacement, reaction;
  Eigen::MatrixXd plastic_strain;  // [cells x frames]
  std::vector<Eigen::VectorXd> d_displacement, d_reaction;
  PathStatus status;
};

class Bar {
 public:
  Bar(mesh::CellType type, Driven driven, LawCase law) : mesh_(bar(type)), driven_(driven), case_(std::move(law)) {
    case_.choice.plane_stress = mesh::dimension(type) == 2;
    law_ = material::make_law(case_.choice);
    std::set<int> dofs;
    for (int node : mesh_.node_groups.at("left")) {
      for (int i = 0; i < 3; ++i)
        if (driven == Driven::by_displacement || i == 0 || (i == 1 && mesh_.nodes(node, 1) == 0.0) ||
            (i == 2 && mesh_.nodes(node, 2) == 0.0))
          dofs.insert(3 * node + i);
    }
    if (driven == Driven::by_displacement)
      for (int node : mesh_.node_groups.at("right"))
        for (int i = 0; i < 3; ++i) dofs.insert(3 * node + i);
    if (case_.choice.plane_stress) std::erase_if(dofs, [](int dof) { return dof % 3 == 2; });
    dofs_.assign(dofs.begin(), dofs.end());
    // Weak images that see x of every node, and of neighbours together, elsewhere than the forces take it.
    const Eigen::Index size = 3 * mesh_.nodes.rows();
    std::vector<Eigen::Triplet<double>> entries;
    for (Eigen::Index i = 0; i < size; i += 3) entries.emplace_back(i, i, 50.0);
    for (Eigen::Index cell = 0; cell < mesh_.cells.rows(); ++cell)
      for (int corner = 0; corner < 3; ++corner) {
        const int a = 3 * mesh_.cells(cell, corner), b = 3 * mesh_.cells(cell, corner + 1);
        entries.emplace_back(a, b, 5.0), entries.emplace_back(b, a, 5.0);
      }
    optical_.stiffness.resize(size, size);
    optical_.stiffness.setFromTriplets(entries.begin(), entries.end());
    const Eigen::VectorXd stretch = 0.04 * mesh_.nodes.reshaped<Eigen::RowMajor>();
    // Between two frames on the way from one to the next: images that jump back at the beginning of a frame unload all
    // of the bar.
    const auto seen = [stretch](int frame, double fraction) -> Eigen::VectorXd {
      const double before = frame > 0 ? levels[static_cast<std::size_t>(frame) - 1] : 0.0;
      return (before + fraction * (levels[static_cast<std::size_t>(frame)] - before)) * stretch;
    };
    // Of the third order, so that the tangent is not that of the stiffness.
    optical_.force = [this, seen](int frame, double fraction, const Eigen::VectorXd& U) -> Eigen::VectorXd {
      const Eigen::VectorXd gap = seen(frame, fraction) - U;
      return optical_.stiffness * (gap.array() + gap.array().cube()).matrix();
    };
    optical_.d_force = [this, seen](int frame, double fraction, const Eigen::VectorXd& U,
                                    const Eigen::VectorXd& dU) -> Eigen::VectorXd {
      const Eigen::VectorXd gap = seen(frame, fraction) - U;
      return -optical_.stiffness * ((1.0 + 3.0 * gap.array().square()) * dU.array()).matrix();
    };
  }

  static constexpr double turn = 0.7;                          ///< [rad]
  static constexpr std::array levels = {0.4, 0.8, 1.0, 0.97};  ///< of the frames

  /// As if there were so much memory [bytes]; 0: what there is.
  void solve_within(double memory) { memory_ = memory; }
  /// Cells of different sections, the one more than the other changed by `by`.
  void change_section(double by) { mesh_.section = initial_section() + by * change_of_section(); }
  /// Two directions beside those of the forces: the section's change, and twice that.
  void differentiate_by_section() { by_section_ = true; }
  [[nodiscard]] const LawCase& law() const { return case_; }
  [[nodiscard]] bool under_given_forces() const { return driven_ == Driven::by_force; }

  /// Pulled beyond yield in three frames, of several increments some, then unloaded; `sideways`: times a force across
  /// at every node on the way. Derivatives in `directions` of the forces, too: the k-th turned by `turn` * k towards
  /// another one.
  Path pull(const std::vector<double>& parameters, const std::vector<int>& free = {}, double sideways = 0.0,
            int directions = 0) {
    std::vector<LoadStep> steps;
    for (const double level : levels) {
      LoadStep step{.time = static_cast<double>(steps.size()) + level,
                    .prescribed = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(dofs_.size())),
                    .force = {}};
      if (driven_ == Driven::by_displacement)
        for (std::size_t i = 0; i < dofs_.size(); ++i)
          if (mesh_.nodes(dofs_[i] / 3, 0) > 2.0)
            step.prescribed[static_cast<Eigen::Index>(i)] = dofs_[i] % 3 == 0   ? 0.08 * level
                                                            : dofs_[i] % 3 == 1 ? 0.02 * level
                                                                                : 0.0;
      if (driven_ != Driven::by_displacement) {
        step.force.setZero(3 * mesh_.nodes.rows());
        const auto& right = mesh_.node_groups.at("right");
        for (int node : right) step.force[3 * node] = 250.0 * level / static_cast<double>(right.size());
      }
      if (sideways != 0.0 || directions > 0) {
        Eigen::VectorXd across = Eigen::VectorXd::Zero(3 * mesh_.nodes.rows()), along = across;
        for (Eigen::Index node = 0; node < mesh_.nodes.rows(); ++node)
          across[3 * node + 1] = level * (1.0 + static_cast<double>(steps.size())) * mesh_.nodes(node, 0);
        for (Eigen::Index node = 0; node < mesh_.nodes.rows(); ++node)
          along[3 * node] = level * 30.0 * mesh_.nodes(node, 1);
        step.force = step.force.size() > 0 ? Eigen::VectorXd(step.force + sideways * across)
                                           : Eigen::VectorXd(sideways * across);
        step.d_prescribed.setZero(step.prescribed.size(), directions);
        Eigen::MatrixXd turned(across.size(), directions);
        for (int k = 0; k < directions; ++k) turned.col(k) = std::cos(turn * k) * across + std::sin(turn * k) * along;
        step.d_force = turned.sparseView();
      }
      if (by_section_) {
        step.d_prescribed.setZero(step.prescribed.size(), directions + 2);
        step.d_section.setZero(mesh_.cells.rows(), directions + 2);
        for (int k = 0; k < 2; ++k)
          step.d_section.col(directions + k) = (1.0 + k) * change_of_section().cwiseQuotient(mesh_.section);
        step.d_force.conservativeResize(3 * mesh_.nodes.rows(), directions + 2);
      }
      steps.push_back(std::move(step));
    }
    if (by_section_) directions += 2;
    const Communicator world;
    const mesh::Partition partition = mesh::partition(mesh_, world);
    const double tight = driven_ == Driven::by_images ? 1e-12 : 1e-13;
    Equilibrium equilibrium(
        partition, mesh_, law_, dofs_,
        {.max_iterations = 40, .tolerance = tight, .derivative_tolerance = 1e-11, .memory_of_solver = memory_});
    Path path;
    path.d_displacement.resize(free.size() + static_cast<std::size_t>(directions)),
        path.d_reaction.resize(path.d_displacement.size());
    path.plastic_strain.resize(mesh_.cells.rows(), static_cast<Eigen::Index>(steps.size()));
    const auto append = [](Eigen::VectorXd& list, const Eigen::VectorXd& more) {
      list.conservativeResize(list.size() + more.size());
      list.tail(more.size()) = more;
    };
    path.status = equilibrium.run(
        steps, parameters, 0.0,
        [&](int t, const FrameState& state) {
          append(path.displacement, state.displacement), append(path.reaction, state.internal);
          path.plastic_strain.col(t) = state.plastic_strain;
          for (std::size_t k = 0; k < path.d_displacement.size(); ++k)
            append(path.d_displacement[k], state.d_displacement[k]), append(path.d_reaction[k], state.d_internal[k]);
        },
        {}, driven_ == Driven::by_displacement ? std::vector<int>{1, 2, 1, 1} : std::vector<int>{2, 8, 8, 1},
        driven_ == Driven::by_images ? &optical_ : nullptr, free);
    return path;
  }

 private:
  [[nodiscard]] Eigen::VectorXd initial_section() const {
    return Eigen::VectorXd::LinSpaced(mesh_.cells.rows(), 0.9, 1.1);
  }
  [[nodiscard]] Eigen::VectorXd change_of_section() const {
    Eigen::VectorXd change(mesh_.cells.rows());
    for (Eigen::Index cell = 0; cell < change.size(); ++cell)
      change[cell] = cell % 3 == 1 ? 0.5 : 0.1 * static_cast<double>(cell % 2);
    return change;
  }

  mesh::Mesh mesh_;
  Driven driven_;
  bool by_section_ = false;
  LawCase case_;
  double memory_ = 0.0;
  std::shared_ptr<const material::FiniteStrainLaw> law_;
  std::vector<int> dofs_;
  OpticalTerm optical_;
};

/// By every parameter of the law: the error of central differences falls with the step to 1e-6 and less, until rounding
/// makes it rise.
void expect_derivatives(Bar bar) {
  const auto& parameters = bar.law().parameters;
  std::vector<int> free(parameters.size());
  for (std::size_t j = 0; j < free.size(); ++j) free[j] = static_cast<int>(j);
  const Path path = bar.pull(parameters, free);
  const std::string of = bar.law().name + " ";
  ASSERT_EQ(path.status.frames, 4) << of << path.status.message;
  const Eigen::Index last = path.plastic_strain.cols() - 1;
  EXPECT_GT(path.plastic_strain.col(2).minCoeff(), 1e-3) << of << "must yield";
  EXPECT_LT((path.plastic_strain.col(last) - path.plastic_strain.col(2)).minCoeff(), 1e-9) << of << "must unload";

  for (std::size_t j = 0; j < free.size(); ++j) {
    std::vector<double> errors;
    double largest_step = 0.0, smallest_step = 1.0;
    std::string table;
    for (const double h : {3e-2, 3e-3, 3e-4, 1e-4, 1e-5, 1e-7, 1e-9}) {
      const auto at = [&](double sign) {
        auto moved = parameters;
        moved[j] += sign * h * parameters[j];
        return bar.pull(moved);
      };
      const Path plus = at(1.0), minus = at(-1.0);
      // Other increments are another function.
      if (plus.status.increments != path.status.increments || minus.status.increments != path.status.increments)
        continue;
      const auto error = [&](const Eigen::VectorXd& a, const Eigen::VectorXd& b, const Eigen::VectorXd& derivative) {
        return ((a - b) / (2.0 * h * parameters[j]) - derivative).norm() / derivative.norm();
      };
      largest_step = std::max(largest_step, h), smallest_step = std::min(smallest_step, h);
      errors.push_back(error(plus.displacement, minus.displacement, path.d_displacement[j]));
      if (!bar.under_given_forces())
        errors.back() = std::max(errors.back(), error(plus.reaction, minus.reaction, path.d_reaction[j]));
      char line[60];
      std::snprintf(line, sizeof line, "\n  %.0e  %.2e", h, errors.back());
      table += line;
    }
    ASSERT_GE(errors.size(), 4U) << of;
    const auto best = std::min_element(errors.begin(), errors.end());
    const std::string what = of + "parameter " + std::to_string(j) + table;
    EXPECT_LE(*best, 1e-6) << what;
    EXPECT_GT(*best, 0.0) << what;
    // Either branch where it was reached: the steps beyond may have taken other increments.
    if (largest_step > 1e-2) {
      EXPECT_GT(errors.front(), 10.0 * *best) << what;
    }
    if (smallest_step < 1e-6) {
      EXPECT_GT(errors.back(), 10.0 * *best) << what;
    }
  }
}

/// In a direction of the external forces, beside a parameter.
TEST(Sensitivities, InADirectionOfTheForces) {
  for (const auto type : {mesh::CellType::hex20, mesh::CellType::quad4})
    for (const Driven driven : {Driven::by_displacement, Driven::by_force}) {
      Bar bar(type, driven, power);
      const Path path = bar.pull(power.parameters, {2}, 0.0, 1);
      ASSERT_EQ(path.status.frames, 4) << path.status.message;
      ASSERT_EQ(path.d_displacement.size(), 2U);
      double best = 1.0, coarse = 0.0;
      for (const double h : {1e-2, 1e-3, 1e-4, 1e-5, 1e-6}) {
        const Path plus = bar.pull(power.parameters, {}, h), minus = bar.pull(power.parameters, {}, -h);
        if (plus.status.increments != path.status.increments || minus.status.increments != path.status.increments)
          continue;
        const double error = ((plus.displacement - minus.displacement) / (2.0 * h) - path.d_displacement[1]).norm() /
                             path.d_displacement[1].norm();
        best = std::min(best, error), coarse = std::max(coarse, error);
      }
      EXPECT_LE(best, 1e-6);
      EXPECT_GT(coarse, 10.0 * best);
      if (driven == Driven::by_displacement) {
        EXPECT_GT(path.d_reaction[1].norm(), 1.0);
      }
    }
}

/// In a direction of the cells' section, beside a parameter and a direction of the forces.
TEST(Sensitivities, InADirectionOfTheSection) {
  for (const auto type : {mesh::CellType::hex20, mesh::CellType::hex8, mesh::CellType::quad4, mesh::CellType::quad8})
    for (const Driven driven : {Driven::by_displacement, Driven::by_force}) {
      Bar bar(type, driven, power);
      bar.change_section(0.0);
      bar.differentiate_by_section();
      const Path path = bar.pull(power.parameters, {2}, 0.0, 1);
      ASSERT_EQ(path.status.frames, 4) << path.status.message;
      ASSERT_EQ(path.d_displacement.size(), 4U);
      EXPECT_LE((path.d_displacement[3] - 2.0 * path.d_displacement[2]).norm(), 1e-9 * path.d_displacement[2].norm());
      double best = 1.0, coarse = 0.0;
      for (const double h : {1e-2, 1e-3, 1e-4, 1e-5, 1e-6}) {
        const auto at = [&](double by) {
          Bar moved(type, driven, power);
          moved.change_section(by);
          return moved.pull(power.parameters);
        };
        const Path plus = at(h), minus = at(-h);
        if (plus.status.increments != path.status.increments || minus.status.increments != path.status.increments)
          continue;
        const auto error_of = [&](const Eigen::VectorXd& above, const Eigen::VectorXd& below,
                                  const Eigen::VectorXd& derivative) {
          return ((above - below) / (2.0 * h) - derivative).norm() / derivative.norm();
        };
        double error = error_of(plus.displacement, minus.displacement, path.d_displacement[2]);
        if (driven == Driven::by_displacement)
          error = std::max(error, error_of(plus.reaction, minus.reaction, path.d_reaction[2]));
        best = std::min(best, error), coarse = std::max(coarse, error);
      }
      EXPECT_LE(best, 1e-6) << mesh::name(type);
      EXPECT_GT(coarse, 10.0 * best);
    }
}

/// In more directions than are solved for at once: each is what it is among few.
TEST(Sensitivities, InManyDirectionsOfTheForces) {
  constexpr int many = 70;
  for (const auto type : {mesh::CellType::hex8, mesh::CellType::quad4})
    for (const Driven driven : {Driven::by_displacement, Driven::by_force, Driven::by_images}) {
      Bar bar(type, driven, power);
      const Path few = bar.pull(power.parameters, {2}, 0.0, 2), more = bar.pull(power.parameters, {2}, 0.0, many);
      ASSERT_EQ(few.status.frames, 4) << few.status.message;
      ASSERT_EQ(more.status.frames, 4) << more.status.message;
      ASSERT_EQ(more.d_displacement.size(), 1U + many);
      const auto& increments = more.status.increments;
      if (driven != Driven::by_images) {
        EXPECT_LE(more.status.derivative_corrections, std::accumulate(increments.begin(), increments.end(), 0))
            << "with the converged tangent's factor each takes one solution";
      }
      const auto expect_same = [](const std::vector<Eigen::VectorXd>& one, const std::vector<Eigen::VectorXd>& other) {
        EXPECT_LE((other[0] - one[0]).norm(), 1e-9 * one[0].norm()) << "by the parameter";
        const Eigen::VectorXd across = one[1], along = (one[2] - std::cos(Bar::turn) * across) / std::sin(Bar::turn);
        ASSERT_GT(along.norm(), 0.1 * across.norm());
        for (int k = 0; k < many; ++k) {
          const Eigen::VectorXd expected = std::cos(Bar::turn * k) * across + std::sin(Bar::turn * k) * along;
          EXPECT_LE((other[static_cast<std::size_t>(k) + 1] - expected).norm(), 1e-9 * (across.norm() + along.norm()))
              << "direction " << k;
        }
      };
      expect_same(few.d_displacement, more.d_displacement);
      if (driven == Driven::by_displacement) expect_same(few.d_reaction, more.d_reaction);
    }
}

TEST(Sensitivities, OfEveryLawUnderPrescribedDisplacement) {
  for (const LawCase& law : laws) expect_derivatives({mesh::CellType::hex8, Driven::by_displacement, law});
}
TEST(Sensitivities, OfQuadraticHexahedra) {
  expect_derivatives({mesh::CellType::hex20, Driven::by_displacement, power});
  expect_derivatives({mesh::CellType::hex20, Driven::by_force, power});
}
TEST(Sensitivities, InPlaneStress) {
  for (const auto type : {mesh::CellType::quad4, mesh::CellType::quad8}) {
    expect_derivatives({type, Driven::by_displacement, power});
    expect_derivatives({type, Driven::by_force, kinematic});
  }
}
TEST(Sensitivities, UnderForces) {
  for (const LawCase& law : {power, all}) expect_derivatives({mesh::CellType::hex8, Driven::by_force, law});
}
TEST(Sensitivities, UnderForcesAndImages) {
  expect_derivatives({mesh::CellType::hex8, Driven::by_images, power});
  expect_derivatives({mesh::CellType::quad4, Driven::by_images, power});
}

/// The first series of a solver: the images couple nodes of this rank with those of others.
TEST(Sensitivities, ImagesSeeNodesOfOtherRanks) {
  Bar bar(mesh::CellType::hex8, Driven::by_images, power);
  const Path path = bar.pull(power.parameters);
  EXPECT_EQ(path.status.frames, 4) << path.status.message;
  EXPECT_GT(path.plastic_strain.maxCoeff(), 1e-3);
}

/// Two grids, the corners solved by MUMPS (an option) or by GAMG (where there is no memory), or GAMG alone (linear
/// elements): the same path and derivatives as by MUMPS alone.
TEST(Sensitivities, WithAnIterativeSolver) {
  const LawCase pressure{
      "pressure dependence", {.hardening = "linear", .effects = {"pressure"}}, {198e3, 0.25, 284, 4900, 0.05, 0.02}};
  for (const auto type : {mesh::CellType::hex20, mesh::CellType::quad8, mesh::CellType::hex8})
    for (const LawCase& law : {power, pressure})
      for (const Driven driven : {Driven::by_displacement, Driven::by_force})
        for (const bool by_option : {false, true}) {
          const bool quadratic = type != mesh::CellType::hex8;
          if ((by_option && !quadratic) || (mesh::dimension(type) == 2 && law.name == pressure.name)) continue;
          if (Communicator{}.size() > 1 &&
              (type != mesh::CellType::hex20 || law.name == pressure.name || driven == Driven::by_force))
            continue;
          // Hundreds of unknowns on more ranks than processors: minutes of waiting, if something else runs, too.
          const bool crowded = Communicator{}.size() > 2;
          if (crowded && !by_option) continue;
          const std::vector<int> free = crowded ? std::vector<int>{} : std::vector<int>{2};
          const std::string of = mesh::name(type) + ", " + law.name +
                                 (driven == Driven::by_force ? ", under forces" : "") + (by_option ? ", option" : "");
          Bar bar(type, driven, law);
          const Path direct = bar.pull(law.parameters, free);
          bar.solve_within(by_option ? 0.0 : 1.0);
          if (by_option) (void)PetscOptionsSetValue(nullptr, "-mechanics_pc_type", "mg");
          const Path iterative = bar.pull(law.parameters, free);
          (void)PetscOptionsClearValue(nullptr, "-mechanics_pc_type");
          ASSERT_EQ(direct.status.frames, 4) << of << direct.status.message;
          ASSERT_EQ(iterative.status.frames, 4) << of << iterative.status.message;
          ASSERT_EQ(iterative.status.increments, direct.status.increments) << of;
          EXPECT_LT(iterative.status.work.factorisations, iterative.status.work.solutions)
              << of << ": a preconditioner serves again";
          EXPECT_NE(iterative.displacement, direct.displacement) << of << ": the other solver was asked for";
          EXPECT_LE((iterative.displacement - direct.displacement).norm(), 1e-9 * direct.displacement.norm()) << of;
          for (std::size_t k = 0; k < free.size(); ++k)
            EXPECT_LE((iterative.d_displacement[k] - direct.d_displacement[k]).norm(),
                      1e-8 * direct.d_displacement[k].norm())
                << of;
        }
}

TEST(Sensitivities, NotOfAStepThatIsSolvedAgainWithOtherModuli) {
  mesh::Mesh mesh = bar(mesh::CellType::hex8);
  mesh.integration = mesh::Integration::one_point_stabilised;
  const mesh::Partition partition = mesh::partition(mesh, {});
  Equilibrium equilibrium(partition, mesh, material::make_law(power.choice), {0, 1, 2}, {});
  const std::vector<int> free = {0};
  EXPECT_THROW(equilibrium.run({}, power.parameters, 0.0, {}, {}, {}, nullptr, free), std::invalid_argument);
}

}  // namespace test_sensitivities
}  // namespace imic3d::mechanics
