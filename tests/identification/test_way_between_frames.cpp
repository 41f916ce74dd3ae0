// How the driven ends move between two frames.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "imic3d/identification/way_between_frames.hpp"
#include "plate.hpp"

namespace imic3d::identification {
namespace test_way_between_frames {

double at(const Eigen::MatrixXd& u, const std::array<Eigen::MatrixXd, 2>& bend, Eigen::Index dof, Eigen::Index frame,
          double s) {
  const double from = frame > 0 ? u(dof, frame - 1) : 0.0, to = u(dof, frame);
  return from + s * (to - from) + s * (1 - s) * ((1 - s) * bend[0](dof, frame) - s * bend[1](dof, frame));
}

/// The first degree pulls, the second follows a curve of it: a cubic leaves a fifth of what straight ways leave at
/// most.
TEST(WayBetweenFrames, FollowsACurveAndNeverLeavesItsFrames) {
  const Eigen::VectorXd pulled{{0.3, 0.8, 1.0, 1.7, 2.2, 3.0}};
  const auto curve = [](double x) { return -0.1 * x * x; };
  Eigen::MatrixXd u(2, 6);
  for (Eigen::Index t = 0; t < 6; ++t) u.col(t) << pulled[t], curve(pulled[t]);
  const auto bend = bends(u);
  double straight = 0.0, bent = 0.0;
  for (Eigen::Index t = 0; t < 6; ++t)
    for (const double s : {0.1, 0.3, 0.5, 0.7, 0.9}) {
      const double x = at(u, bend, 0, t, s), from = t > 0 ? u(1, t - 1) : 0.0;
      bent = std::max(bent, std::abs(at(u, bend, 1, t, s) - curve(x)));
      straight = std::max(straight, std::abs(from + s * (u(1, t) - from) -
                                             curve(pulled[t] * s + (t > 0 ? pulled[t - 1] : 0.0) * (1 - s))));
      EXPECT_LE(at(u, bend, 1, t, s), from + 1e-12);
      EXPECT_GE(at(u, bend, 1, t, s), u(1, t) - 1e-12);
    }
  EXPECT_GT(straight, 0.01);
  EXPECT_LT(bent, 0.2 * straight);
}

TEST(WayBetweenFrames, IsStraightInProportionAndBeginsAnewWhereItTurnsBack) {
  Eigen::MatrixXd u(2, 5);
  u << 1.0, 3.0, 2.0, 2.0, 2.5, -0.3, -0.9, -0.6, -0.6, -0.75;  // pulls, unloads, stands, pulls
  const auto bend = bends(u);
  EXPECT_LT(bend[0].cwiseAbs().maxCoeff() + bend[1].cwiseAbs().maxCoeff(), 1e-12);
  u(1, 2) = -0.8;  // the turn is not smoothed: the first two frames know nothing of what follows
  const auto other = bends(u);
  for (int side = 0; side < 2; ++side)
    EXPECT_LT((other[static_cast<std::size_t>(side)] - bend[static_cast<std::size_t>(side)])
                  .leftCols(2)
                  .cwiseAbs()
                  .maxCoeff(),
              1e-12);
  EXPECT_EQ(bends(Eigen::MatrixXd::Zero(2, 3))[0].norm(), 0.0);
}

/// The plate is unloaded in a frame while it moves as a whole: it deforms on its way as it does where it stands.
TEST(WayBetweenFrames, RigidMotionLeavesTheDeformationAsItIs) {
  const Communicator world;
  const testing::Plate plate({0.01, 0.03, 0.02, 0.05, 0.08});  // mm
  const Specimen& specimen = plate.specimen;
  const auto& nodes = specimen.surface.mesh.nodes;
  const auto& dofs = specimen.displacement_dofs;
  const Eigen::Index frames = plate.record.driving.cols();
  const auto moved = [&](double by, double turn) {  // in each frame `by` [mm] and `turn` more
    Eigen::MatrixXd u = plate.record.driving;
    for (Eigen::Index t = 0; t < frames; ++t)
      for (Eigen::Index i = 0; i < nodes.rows(); ++i) {
        const Eigen::Vector2d X = nodes.row(i).head<2>().transpose(),
                              narrows(-2.0 * std::pow(plate.record.driving.col(t).maxCoeff(), 2) * X[0], 0.0);
        u.col(t).segment<2>(2 * i) =
            Eigen::Rotation2Dd(turn * static_cast<double>(t + 1)) * (X + u.col(t).segment<2>(2 * i) + narrows) - X +
            by * static_cast<double>(t + 1) * Eigen::Vector2d(1.0, -0.5);
      }
    return u;
  };
  /// Distances of the driven nodes from one another, on the way.
  const auto distances = [&](const Eigen::MatrixXd& driving, bool straight) {
    const Eigen::MatrixXd u = specimen.displacement_from_surface * driving;
    const auto bend = bends(u, dofs, specimen.volume.nodes, straight);
    std::vector<double> found;
    for (Eigen::Index t = 0; t < frames; ++t)
      for (const double s : {0.2, 0.5, 0.8}) {
        std::vector<Eigen::Vector2d> places;
        for (std::size_t i = 0; i + 1 < dofs.size(); ++i)
          if (dofs[i + 1] == dofs[i] + 1 && dofs[i] % 3 == 0)
            places.emplace_back(
                specimen.volume.nodes(dofs[i] / 3, 0) + at(u, bend, static_cast<Eigen::Index>(i), t, s),
                specimen.volume.nodes(dofs[i] / 3, 1) + at(u, bend, static_cast<Eigen::Index>(i) + 1, t, s));
        for (const auto& a : places)
          for (const auto& b : places) found.push_back((a - b).norm());
      }
    return Eigen::VectorXd(Eigen::Map<Eigen::VectorXd>(found.data(), static_cast<Eigen::Index>(found.size())));
  };
  const Eigen::VectorXd still = distances(moved(0.0, 0.0), false), all_straight = distances(moved(0.0, 0.0), true);
  EXPECT_GT((still - all_straight).cwiseAbs().maxCoeff(), 1e-4);
  EXPECT_LT((distances(moved(0.4, 0.0), false) - still).cwiseAbs().maxCoeff(), 1e-13);
  for (const double turn : {0.01, 0.1}) {  // on straight ways they would be turn^2 mm too short; 8 mm, up to 0.03 mm
                                           // longer in a frame, in a cubic
    const double of_arc = 10.0 * std::pow(turn, 4) / 384.0 + 0.1 * std::pow(turn, 3) / 96.0;
    EXPECT_LT((distances(moved(0.4, turn), true) - all_straight).cwiseAbs().maxCoeff(), of_arc) << turn;
    EXPECT_LT((distances(moved(0.4, turn), false) - still).cwiseAbs().maxCoeff(), of_arc + 2e-4 * turn) << turn;
  }

  const Eigen::MatrixXd upright = specimen.displacement_from_surface * moved(0.0, 0.0);
  Eigen::MatrixXd tilted = upright;  // as seen from both sides
  for (std::size_t i = 0; i < dofs.size(); ++i)
    for (Eigen::Index t = 0; t < frames && dofs[i] % 3 == 0; ++t)
      tilted(static_cast<Eigen::Index>(i), t) +=
          0.05 * static_cast<double>(t + 1) * specimen.volume.nodes(dofs[i] / 3, 2);
  EXPECT_LT((bends(tilted, dofs, specimen.volume.nodes)[0] - bends(upright, dofs, specimen.volume.nodes)[0])
                .cwiseAbs()
                .maxCoeff(),
            1e-13);

  // Of a plate that is its own mirror image the force goes with the axis.
  ForwardModel model(world, specimen, plate.law, plate.record,
                     {.increments = 4, .tolerance = 1e-12, .with_fields = false}, 1, 1);
  const auto force = [&](double by, double turn) {
    const Eigen::MatrixXd driving = moved(by, turn);
    Eigen::VectorXd reaction = model
                                   .simulate(Control::displacement, {{.parameters = plate.truth, .driving = &driving}},
                                             static_cast<int>(frames))
                                   .front()
                                   .reaction;
    for (Eigen::Index t = 0; t < frames; ++t) reaction[t] /= std::cos(turn * static_cast<double>(t + 1));
    return reaction;
  };
  const Eigen::VectorXd alone = force(0.0, 0.0);
  ASSERT_LT(alone[2], 0.5 * alone[1]) << "unloaded";
  EXPECT_LT((force(0.4, 0.0) - alone).norm(), 1e-8 * alone.norm());
  EXPECT_LT((force(0.4, 0.01) - alone).norm(), 1e-6 * alone.norm());

  const Eigen::MatrixXd turned = moved(0.4, 0.01);
  Eigen::MatrixXd direction = plate.record.driving;
  for (Eigen::Index i = 0; i < direction.size(); ++i) direction.data()[i] *= std::sin(static_cast<double>(i));
  const Path path = model
                        .simulate(Control::displacement,
                                  {{.parameters = plate.truth,
                                    .driving = &turned,
                                    .directions = {{.prescribed = specimen.displacement_from_surface * direction}}}},
                                  static_cast<int>(frames))
                        .front();
  const Eigen::MatrixXd more = turned + 1e-4 * direction, less = turned - 1e-4 * direction;
  const auto both =
      model.simulate(Control::displacement,
                     {{.parameters = plate.truth, .driving = &more}, {.parameters = plate.truth, .driving = &less}},
                     static_cast<int>(frames));
  EXPECT_LT(((both[0].reaction - both[1].reaction) / 2e-4 - path.d_reaction[0]).norm(),
            1e-5 * path.d_reaction[0].norm());
}

/// A series with every other frame follows the series with all of them, twice as well as with straight ways at least;
/// its derivatives as the ends move are those of this way.
TEST(WayBetweenFrames, DrivesTheSimulation) {
  const Communicator world;
  const testing::Plate plate({0.003, 0.006, 0.02, 0.04, 0.08, 0.12});
  Record bent = plate.record;
  for (Eigen::Index t = 0; t < bent.driving.cols(); ++t)
    for (const Face& face : plate.specimen.faces)
      for (Eigen::Index i = 0; i < face.nodes(); ++i)  // the ends narrow ever faster
        bent.driving(face.first_unknown + face.components * i, t) =
            -0.3 * std::pow(bent.driving.col(t).maxCoeff(), 2) * face.surface.mesh.nodes(i, 0);
  const mechanics::EquilibriumOptions tight{
      .increments = 3, .max_iterations = 40, .tolerance = 1e-13, .derivative_tolerance = 1e-11};
  ForwardModel model(world, plate.specimen, plate.law, bent, tight, 1, 1);
  Eigen::MatrixXd direction = bent.driving;
  for (Eigen::Index i = 0; i < direction.size(); ++i) direction.data()[i] *= std::sin(static_cast<double>(i));
  const Path path =
      model
          .simulate(Control::displacement,
                    {{.parameters = plate.truth,
                      .directions = {{.prescribed = plate.specimen.from_surface(Control::displacement) * direction}}}},
                    6)
          .front();
  ASSERT_EQ(path.frames, 6) << path.message;
  double best = 1.0;
  for (const double h : {1e-4, 1e-5, 1e-6}) {
    const Eigen::MatrixXd more = bent.driving + h * direction, less = bent.driving - h * direction;
    const auto both = model.simulate(
        Control::displacement,
        {{.parameters = plate.truth, .driving = &more}, {.parameters = plate.truth, .driving = &less}}, 6);
    best = std::min(best, ((both[0].reaction - both[1].reaction) / (2 * h) - path.d_reaction[0]).norm() /
                              path.d_reaction[0].norm());
  }
  EXPECT_LT(best, 1e-6);

  // Frames far from one another, in increments that begin and end where those of all frames do.
  const auto reaction_at = [&](const std::vector<Eigen::Index>& kept, bool straight, bool by_frames = true) {
    Record record = bent;
    const int between = 12 * (static_cast<int>(bent.driving.cols()) / static_cast<int>(kept.size())),
              ways = straight && by_frames ? between : 1;
    const auto count = static_cast<Eigen::Index>(kept.size()) * ways;
    record.time.resize(count), record.driving.resize(bent.driving.rows(), count);
    for (std::size_t k = 0; k < kept.size(); ++k)
      for (int part = 1; part <= ways; ++part) {
        const double s = static_cast<double>(part) / ways;
        const Eigen::Index t = static_cast<Eigen::Index>(k) * ways + part - 1;
        record.time[t] = s * bent.time[kept[k]] + (k > 0 ? (1 - s) * bent.time[kept[k - 1]] : 0.0);
        record.driving.col(t) = s * bent.driving.col(kept[k]);
        if (k > 0) record.driving.col(t) += (1 - s) * bent.driving.col(kept[k - 1]);
      }
    record.force.setZero(count), record.surface_displacement = record.driving;
    ForwardModel its(world, plate.specimen, plate.law, record, {.increments = between / ways, .with_fields = false}, 1,
                     1);
    const Eigen::VectorXd reaction =
        its.simulate(Control::displacement, {{.parameters = plate.truth, .straight = straight}},
                     static_cast<int>(count))
            .front()
            .reaction;
    return Eigen::VectorXd(reaction(Eigen::seq(ways - 1, count - 1, ways)));
  };
  const std::vector<Eigen::Index> kept = {1, 3, 5};
  const Eigen::VectorXd all = reaction_at({0, 1, 2, 3, 4, 5}, false)(kept);
  const double of_bent = (reaction_at(kept, false) - all).norm() / all.norm(),
               of_straight = (reaction_at(kept, true) - all).norm() / all.norm();
  EXPECT_GT(of_straight, 1e-3);
  EXPECT_LT(of_bent, 0.5 * of_straight) << of_straight;
  EXPECT_LT((reaction_at(kept, true, false) - reaction_at(kept, true)).norm(), 1e-8 * all.norm())
      << "straight where it is asked for";
}

}  // namespace test_way_between_frames
}  // namespace imic3d::identification
