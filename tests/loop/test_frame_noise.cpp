// Frames of different noise: what is whitened, and what is drawn.

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "strip.hpp"

namespace imic3d::loop {
namespace test_frame_noise {

using testing::declared, testing::Strip;

const Eigen::Vector4d levels(1.0, 0.5, 3.0, 2.0);

/// Whitened residuals of one motion of the surface in all frames [numbers of a frame, the force last x frames].
Eigen::MatrixXd of_motion(const Eigen::VectorXd& frame_noise, const Eigen::RowVector4d& course) {
  Strip strip(0.0);
  strip.data.faces.front().frame_noise = frame_noise;
  const auto nodes = strip.data.faces.front().surface.nodes;
  for (Eigen::Index t = 0; t < 4; ++t)
    for (Eigen::Index i = 0; i < nodes.rows(); ++i)
      strip.data.displacement(2 * i, t) += 1e-3 * course[t] * std::sin(nodes(i, 1));
  FieldExperiment experiment = strip.experiment();
  const Eigen::VectorXd r = experiment.residuals({declared(experiment)}).front();
  return r.reshaped(r.size() / 4, 4);
}

/// S^2 + 11^T/references, to whose inverse squares of residuals are taken, whatever root whitens.
TEST(FrameNoise, ResidualsCountByTheNoiseOfTheirFrame) {
  const Eigen::RowVector4d course(0.3, -1.0, 2.0, 0.7);
  const auto squares = [&](const Eigen::VectorXd& noise) {
    return of_motion(noise, course).topRows(of_motion(noise, course).rows() - 1).squaredNorm();
  };
  const auto expected = [&](const Eigen::Vector4d& noise) {
    const Eigen::Matrix4d covariance = Eigen::Matrix4d(noise.cwiseAbs2().asDiagonal()) + Eigen::Matrix4d::Ones();
    return double(course * covariance.inverse() * course.transpose());
  };
  const double alike = squares({});
  EXPECT_NEAR(squares(Eigen::Vector4d::Ones()) / alike, 1.0, 1e-12);
  EXPECT_NEAR(squares(levels) / alike, expected(levels) / expected(Eigen::Vector4d::Ones()), 1e-9);
}

/// Of each frame as much is drawn as whitening expects: variances as those of frames alike.
TEST(FrameNoise, DrawsAreThoseThatAreWhitened) {
  const auto variances = [](const Eigen::VectorXd& noise) -> Eigen::Vector4d {
    Strip strip(0.0);
    strip.data.faces.front().frame_noise = noise;
    FieldExperiment experiment = strip.experiment();
    const Eigen::MatrixXd draws = experiment.noise(declared(experiment), 400);
    const Eigen::Index per_frame = draws.rows() / 4;
    Eigen::Vector4d mean;
    for (Eigen::Index t = 0; t < 4; ++t)
      mean[t] = draws.middleRows(t * per_frame, per_frame - 1).array().square().mean();
    return mean;
  };
  const Eigen::Vector4d alike = variances({}), different = variances(levels);
  for (Eigen::Index t = 0; t < 4; ++t)
    EXPECT_NEAR(different[t] / alike[t], 1.0, 0.1) << "frame " << t << ": " << alike[t];
}

}  // namespace test_frame_noise
}  // namespace imic3d::loop
