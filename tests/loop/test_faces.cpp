// Cameras on both faces: rigid motions of a rig leave no trace, bending is seen, and what a camera adds is told from
// what the other one shows.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/fit.hpp"
#include "strip.hpp"

namespace imic3d::loop {
namespace test_faces {

using testing::declared;
using testing::is_candidate;
using testing::place_of;

/// The whole thickness of the strip of identification/plate.hpp with its front, or both faces, seen.
struct Faces {
  FieldData data;
  DeclaredModel model;
  std::vector<identification::Face> faces;

  explicit Faces(std::vector<identification::SeenFace> seen) {
    const auto make = [seen] {
      return identification::make_specimen(mesh::extrude(identification::testing::strip(), 1.0, 2), "bottom", "top", 1,
                                           false, "specimen", seen);
    };
    const identification::testing::Plate plate({0.002, 0.004, 0.02, 0.05}, make());
    faces = plate.specimen.faces;
    for (const auto& face : faces)
      data.faces.push_back(
          {.name = face.back ? "back" : "front",
           .surface = face.surface.mesh,
           .components = face.components,
           .M = plate.images.M.block(face.first_unknown, face.first_unknown, face.unknowns(), face.unknowns())});
    data.displacement = data.driving = plate.record.surface_displacement;
    data.smooth = [](Eigen::MatrixXd field) { return field; };
    data.frames = plate.record.frames, data.time = plate.record.time;
    data.force = plate.record.force;
    data.force_noise = 5.0;
    model.law = plate.law, model.information = plate.law->parameters(), model.values = plate.truth;
    model.priors.assign(plate.truth.size(), 0.0), model.free.assign(plate.truth.size(), 0);
    model.free[0] = model.free[2] = 1;
    model.specimen = [make](const MeshChange&) { return make(); };
  }
  [[nodiscard]] FieldExperiment experiment() const { return {Communicator{}, data, model, {.modes = 12}}; }
};

const identification::SeenFace front{}, back{.back = true}, stereo_back{.back = true, .components = 3};

/// What E and S_y leave of the mark of a parameter, and the mark.
std::pair<double, Eigen::VectorXd> visibility(FieldExperiment& experiment, const std::string& name) {
  const auto values = declared(experiment);
  const int j = place_of(experiment, name);
  const auto column = [&](int k) {
    const auto moved = [&] {
      auto there = values;
      there[static_cast<std::size_t>(k)] += experiment.parameters()[static_cast<std::size_t>(k)].step;
      return there;
    }();
    const auto residuals = experiment.residuals({values, moved});
    return Eigen::VectorXd((residuals[0] - residuals[1]) / experiment.parameters()[static_cast<std::size_t>(k)].step);
  };
  Eigen::MatrixXd S(static_cast<Eigen::Index>(experiment.data().size()), 2);
  S << column(0), column(2);
  const Eigen::VectorXd s = column(j);
  return {(s - S * least_squares(S, s)).norm() / s.norm(), s};
}

TEST(BothFaces, BendingIsSeen) {
  FieldExperiment one = Faces({front}).experiment(), both = Faces({front, back}).experiment();
  const auto [part, mark_alone] = visibility(one, "bending_share");
  const auto [seen, mark] = visibility(both, "bending_share");
  EXPECT_GT(seen, 0.9);
  // Seen as well with a size five times smaller.
  EXPECT_GT(seen * mark.norm(), 5.0 * part * mark_alone.norm());
  // By far most of it on the faces, in opposite directions: nothing in the middle, and so nearly nothing in the force.
  double squares[2] = {0.0, 0.0}, force = 0.0;
  for (Eigen::Index i = 0; i < mark.size(); ++i) {
    const int channel = both.data()[static_cast<std::size_t>(i)].channel;
    (channel < 0 ? force : squares[channel]) += mark[i] * mark[i];
  }
  EXPECT_NEAR(squares[1] / squares[0], 1.0, 0.4);  // the nodes' weights differ
  EXPECT_LT(force, 0.02 * squares[0]);
}

TEST(BothFaces, RigidMotionsOfARigLeaveNoTrace) {
  for (const auto& other : {back, stereo_back}) {
    Faces with({front, other});
    FieldExperiment experiment = with.experiment();
    const Eigen::VectorXd before = experiment.residuals({declared(experiment)}).front();
    EXPECT_LT(before.norm(), 1e-4);  // its own simulation
    const auto& face = with.faces[1];
    Eigen::MatrixXd moved = with.data.displacement;
    for (Eigen::Index i = 0; i < face.nodes(); ++i) {
      const Eigen::Vector3d X = face.surface.mesh.nodes.row(i);
      Eigen::Vector3d u = Eigen::Vector3d(1e-5, -2e-5, 3e-5) + Eigen::Vector3d(1e-6, 2e-6, 3e-6).cross(X);
      if (face.components == 2) u = Eigen::Vector3d(1e-5, -2e-5, 0.0) + Eigen::Vector3d(0.0, 0.0, 3e-6).cross(X);
      for (int k = 0; k < face.components; ++k) moved.row(face.first_unknown + face.components * i + k).array() += u[k];
    }
    Faces shifted = with, stretched = with;
    shifted.data.displacement = moved;  // what drives the ends as it was
    FieldExperiment at = shifted.experiment();
    EXPECT_LT((at.residuals({declared(at)}).front() - before).norm(), 1e-4);
    for (Eigen::Index i = 0; i < face.nodes(); ++i)
      for (auto column : stretched.data.displacement.colwise())
        column[face.first_unknown + face.components * i + 1] += 1e-5 * face.surface.mesh.nodes(i, 1);
    FieldExperiment on = stretched.experiment();
    EXPECT_GT((on.residuals({declared(on)}).front() - before).norm(), 0.1);
  }
}

TEST(BothFaces, EachRigHasItsOwnCameraEffects) {
  const Faces with({front, back});
  FieldExperiment experiment = with.experiment();
  EXPECT_TRUE(is_candidate(experiment, "front magnification drift"));
  EXPECT_TRUE(is_candidate(experiment, "back magnification drift"));
  EXPECT_FALSE(is_candidate(experiment, "magnification drift"));
  EXPECT_TRUE(is_candidate(experiment, "preload"));
  // The rear camera's drift is (X + u) times the clock on its face, and nothing on the other but for the ends, which it
  // drives by half.
  auto values = declared(experiment);
  const double drift = 1e-4;
  values[static_cast<std::size_t>(place_of(experiment, "back_magnification_drift"))] = drift;
  const auto [U, F] = experiment.unwhitened(values);
  const auto& face = with.faces[1];
  const Eigen::Index last = U.cols() - 1;
  double difference = 0.0;
  for (Eigen::Index i = 0; i < face.nodes(); ++i)
    for (int k = 0; k < 2; ++k) {
      const Eigen::Index there = face.first_unknown + 2 * i + k, here = 2 * i + k;  // one place on both faces
      const double expected = drift * (face.surface.mesh.nodes(i, k) + with.data.displacement(there, last));
      difference = std::max(difference, std::abs(U(here, last) - U(there, last) - expected));
    }
  EXPECT_LT(difference, 0.01 * drift * 8.0);
}

TEST(BothFaces, BendingIsNotLearnedAsBias) {
  Faces with({front, back});
  with.data.correlate =
      [&with](const identification::Specimen& made,
              const Eigen::MatrixXd& U) {  // the nodes of the declared mesh are among those of a finer one
        Eigen::MatrixXd seen(with.data.displacement.rows(), U.cols());
        for (std::size_t k = 0; k < with.faces.size(); ++k) {
          const auto &face = with.faces[k], &own = made.faces[k];
          seen.middleRows(face.first_unknown, face.unknowns()) =
              identification::of_components(
                  identification::interpolation(own.surface.mesh, face.surface.mesh.nodes.leftCols<2>())) *
              U.middleRows(own.first_unknown, own.unknowns());
        }
        return seen;
      };
  FieldExperiment experiment = with.experiment();
  auto values = declared(experiment);
  const auto straight = experiment.residuals({values}).front();
  experiment.learn_bias(values);  // of the increments
  const Eigen::VectorXd before = experiment.bias();
  values[static_cast<std::size_t>(place_of(experiment, "bending_share"))] = 0.02;
  experiment.learn_bias(values);
  const double bending = (experiment.residuals({values}).front() - straight + experiment.bias()).norm();
  EXPECT_LT((experiment.bias() - before).norm(), 0.05 * bending);
  EXPECT_GT(bending, 10.0);
  FieldExperiment other = with.experiment();
  other.learn_again(values, experiment.learned_numbers());
  EXPECT_EQ(other.bias(), experiment.bias());
  EXPECT_EQ(other.learned()->at, values);
}

/// Ends that are cut from a longer specimen move at depth as no camera on one face sees: a shape of the null, learned
/// as a derivative, is what the model changes by when its ends do so.
TEST(OneFace, EndsMayMoveUnevenlyAtDepth) {
  Faces with({front});
  with.data.correlate = [](const identification::Specimen&, const Eigen::MatrixXd& U) { return U; };
  FieldExperiment experiment = with.experiment();
  const auto values = declared(experiment);
  experiment.learn_bias(values);
  const Eigen::MatrixXd doubt = experiment.doubt().whole;

  const identification::testing::Plate plate({0.002, 0.004, 0.02, 0.05}, with.model.specimen({}));
  const auto& specimen = plate.specimen;
  const auto frames = plate.record.force.size();
  const Eigen::MatrixXd nodes = specimen.volume.nodes;
  const double front_z = nodes.col(2).maxCoeff(), half_width = nodes.col(0).maxCoeff();
  const Eigen::RowVectorXd elongation = Eigen::RowVector4d(0.002, 0.004, 0.02, 0.05);
  identification::ForwardModel model(Communicator{}, specimen, plate.law, plate.record, {.with_fields = false}, 1, 1);
  constexpr double part = 1e-3;  // of what is learned: at first yield the model is not linear
  const auto moved = [&](const std::function<double(double x)>& profile, const std::vector<int>& end) {
    Eigen::MatrixXd beyond =
        Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(specimen.displacement_dofs.size()), frames);
    for (std::size_t i = 0; i < specimen.displacement_dofs.size(); ++i) {
      const int node = specimen.displacement_dofs[i] / 3;
      if (specimen.displacement_dofs[i] % 3 == 1 && std::find(end.begin(), end.end(), node) != end.end() &&
          std::abs(front_z - nodes(node, 2) - 0.5) < 1e-9)
        beyond.row(static_cast<Eigen::Index>(i)) = part * 0.01 * profile(nodes(node, 0) / half_width) * elongation;
    }
    EXPECT_GT(beyond.norm(), 0.0);
    const auto there = model
                           .simulate(identification::Control::displacement,
                                     {{.parameters = plate.truth, .driving = &with.data.driving, .beyond = &beyond}},
                                     static_cast<int>(frames))
                           .front();
    Faces other({front});
    other.data.displacement = there.surface, other.data.force = there.reaction;
    FieldExperiment seen = other.experiment();
    return Eigen::VectorXd((seen.residuals({values}).front() - with.experiment().residuals({values}).front()) / part);
  };
  // The columns of the shapes are the last ones: ends, then along the axis, across and through the thickness, then
  // degrees.
  ASSERT_GE(doubt.cols(), 30);
  const auto shape = [&](int k) { return Eigen::VectorXd(doubt.col(doubt.cols() - 30 + k)); };
  // By the square of the thickness over the width, of which plates 0.4 of their width thick have all.
  const double share = std::pow(std::min(1.0, experiment.scene().thickness / (2.0 * half_width) / 0.4), 2);
  EXPECT_LT(share, 0.9);
  for (const auto& [column, change] :
       {std::pair(shape(0), moved([](double) { return 1.0; }, specimen.loaded)),
        std::pair(shape(1), moved([](double) { return 1.0; }, specimen.held)),
        std::pair(shape(12), moved([](double x) { return 1.5 * x * x - 0.5; }, specimen.loaded))}) {
    EXPECT_GT(change.norm(), 1.0);
    EXPECT_LT((column - share * change).norm(), 0.01 * share * change.norm());
  }
  FieldExperiment both = Faces({front, back}).experiment();
  EXPECT_EQ(both.doubt().whole.cols(), 1);  // with both faces seen nothing of this is assumed
}

TEST(BothFaces, ADeclaredEffectNamesItsCamera) {
  Faces with({front, back});
  with.model.effects = {{.effect = "back_magnification_drift",
                         .quantity = "magnification_drift",
                         .value = 1e-4,
                         .lower = {},
                         .upper = {}}};
  FieldExperiment experiment = with.experiment();
  EXPECT_FALSE(is_candidate(experiment, "back magnification drift"));
  EXPECT_TRUE(is_candidate(experiment, "front magnification drift"));
  EXPECT_EQ(experiment.parameters()[static_cast<std::size_t>(place_of(experiment, "back_magnification_drift"))].value,
            1e-4);
  with.model.effects.front().effect = "magnification_drift";
  EXPECT_THROW((void)with.experiment(), InputError);
}

TEST(BothFaces, AStereoRigHasNoEffectsOfASingleCamera) {
  FieldExperiment experiment = Faces({front, stereo_back}).experiment();
  EXPECT_TRUE(is_candidate(experiment, "back magnification drift"));
  EXPECT_TRUE(is_candidate(experiment, "front parallax"));
  for (const char* name : {"back parallax", "back camera bump", "back lens distortion", "back sub-pixel interpolation"})
    EXPECT_FALSE(is_candidate(experiment, name)) << name;
}

}  // namespace test_faces
}  // namespace imic3d::loop
