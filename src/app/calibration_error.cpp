#include "calibration_error.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <map>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/imaging/calibration.hpp"
#include "rig.hpp"

namespace imic3d::app {
namespace {

using Eigen::Index;
using imaging::camera_numbers;
using imaging::PinholeCamera;
using Cameras = std::vector<std::shared_ptr<const imaging::Camera>>;

Eigen::Matrix3d turn(const Eigen::Vector3d& r) {
  return r.norm() > 0.0 ? Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix()
                        : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
}

/// A telecentric camera that was taken to be `scale` times as large a pixel and turned by `angle` [rad], about the
/// pixel `fixed`.
imaging::TelecentricCamera disturbed(const imaging::Camera& camera, const Eigen::Vector3d& middle, double scale,
                                     double angle) {
  imaging::TelecentricCamera wrong;
  wrong.linear = Eigen::Rotation2Dd(angle).toRotationMatrix() * camera.jacobian(middle) / scale;
  wrong.offset = camera.project(middle) - wrong.linear * middle;
  return wrong;
}

/// A pinhole camera in the specimen's frame with errors of its numbers; `centre` is its translation in the frame of the
/// rig, in which the errors are counted.
PinholeCamera disturbed(const PinholeCamera& camera, const Eigen::Vector3d& centre, const Eigen::VectorXd& error) {
  imaging::Intrinsics lens = camera.intrinsics();
  lens.fx += error[0], lens.fy += error[1], lens.cx += error[2], lens.cy += error[3], lens.skew += error[4];
  for (std::size_t k = 0; k < lens.distortion.size(); ++k) lens.distortion[k] += error[5 + static_cast<Index>(k)];
  const Eigen::Matrix3d turned = turn(error.segment<3>(17));
  return {lens,
          {turned * camera.pose().rotation, turned * (camera.pose().translation - centre) + centre + error.tail<3>()}};
}

/// Standard deviations of the numbers of a face's cameras as the columns of a square root of their covariance [numbers
/// x uncertain].
struct Uncertainty {
  std::vector<Index> first;  // of each view's numbers: 2 (pixel size, rotation) or 23
  std::vector<Eigen::Vector3d> centre;
  Eigen::MatrixXd root;
};

Uncertainty uncertainty(const io::Case& test, const Rig& rig) {
  Uncertainty result;
  Index size = 0;
  for (const int c : rig.cameras) {
    result.first.push_back(size);
    size += test.cameras[static_cast<std::size_t>(c)].model == "pinhole" ? camera_numbers : 2;
  }
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(size, size);
  for (std::size_t k = 0; k < rig.cameras.size(); ++k) {
    const auto& declared = test.cameras[static_cast<std::size_t>(rig.cameras[k])];
    const Index at = result.first[k];
    result.centre.emplace_back(Eigen::Vector3d::Zero());
    if (declared.model != "pinhole") {
      for (const auto& [name, value] : declared.calibration_sd) {
        if (name != "pixel_size" && name != "rotation")
          throw InputError("cameras." + declared.name + ".calibration_sd", name, "pixel_size, rotation");
        const Index row = at + (name == "rotation" ? 1 : 0);
        covariance(row, row) = std::pow(name == "rotation" ? value * M_PI / 180.0 : value, 2);
      }
      continue;
    }
    const auto calibrated = imaging::read_calibration(declared.calibration)[static_cast<std::size_t>(declared.index)];
    result.centre.back() = calibrated.pose.translation;
    if (!declared.calibration_sd.empty()) {
      covariance.diagonal().segment(at, camera_numbers) = calibration_deviations(declared).cwiseAbs2();
      continue;
    }
    if (calibrated.covariance.size() == 0) continue;
    for (std::size_t l = 0; l < rig.cameras.size(); ++l) {
      const auto& other = test.cameras[static_cast<std::size_t>(rig.cameras[l])];
      if (other.calibration == declared.calibration && other.calibration_sd.empty())
        covariance.block(at, result.first[l], camera_numbers, camera_numbers) =
            calibrated.covariance.middleCols(camera_numbers * other.index, camera_numbers);
    }
  }
  // Numbers of such different size are scaled to a correlation before the decomposition.
  const Eigen::VectorXd scale = covariance.diagonal().cwiseSqrt().unaryExpr([](double s) { return s > 0.0 ? s : 1.0; });
  const Eigen::MatrixXd correlation =
      scale.cwiseInverse().asDiagonal() * covariance * scale.cwiseInverse().asDiagonal();
  const SymmetricEigen axes = symmetric_eigen(0.5 * (correlation + correlation.transpose()));
  const Index uncertain = (axes.values.array() > 1e-12).count();  // the last ones: ascending
  result.root =
      scale.asDiagonal() * axes.vectors.rightCols(uncertain) * axes.values.tail(uncertain).cwiseSqrt().asDiagonal();
  return result;
}

/// The cameras with wrong numbers, moved together so that the nodes project nearest to where they do in truth.
Cameras placed(const mesh::Mesh& surface, const Cameras& truth, Cameras wrong, const std::vector<bool>& movable) {
  const Eigen::Vector3d middle = surface.nodes.colwise().mean();
  for (int iteration = 0; iteration < 10; ++iteration) {
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(6, 6);
    Eigen::VectorXd b = Eigen::VectorXd::Zero(6);
    for (std::size_t c = 0; c < wrong.size(); ++c)
      for (Index i = 0; movable[c] && i < surface.nodes.rows(); ++i) {
        const Eigen::Vector3d X = surface.nodes.row(i).transpose(), arm = X - middle;
        const Eigen::Matrix<double, 2, 3> J = wrong[c]->jacobian(X);
        Eigen::Matrix<double, 2, 6> slope;  // of a rotation about the middle and a translation
        for (int k = 0; k < 3; ++k) slope.col(k) = J * Eigen::Vector3d::Unit(k).cross(arm);
        slope.rightCols<3>() = J;
        H += slope.transpose() * slope, b += slope.transpose() * (truth[c]->project(X) - wrong[c]->project(X));
      }
    const Eigen::VectorXd step = least_squares(H, b);
    const Eigen::Matrix3d turned = turn(step.head<3>());
    const imaging::Pose motion{turned, middle - turned * middle + step.tail<3>()};
    for (std::size_t c = 0; c < wrong.size(); ++c)
      if (movable[c]) {
        const auto& camera = dynamic_cast<const PinholeCamera&>(*wrong[c]);
        wrong[c] = std::make_shared<PinholeCamera>(camera.intrinsics(), camera.pose() * motion);
      }
    if (step.head<3>().norm() < 1e-10) break;
  }
  return wrong;
}

/// dU/d(x, y) at the nodes, the mean of the elements around, weighted by their areas [nodes][components x 2].
std::vector<Eigen::MatrixXd> slopes(const mesh::Mesh& surface, const Eigen::VectorXd& U, int components) {
  std::vector<Eigen::MatrixXd> sum(static_cast<std::size_t>(surface.nodes.rows()),
                                   Eigen::MatrixXd::Zero(components, 2));
  Eigen::VectorXd area = Eigen::VectorXd::Zero(surface.nodes.rows());
  Eigen::Matrix<double, 4, 2> central;
  central << -0.25, -0.25, 0.25, -0.25, 0.25, 0.25, -0.25, 0.25;
  for (Index e = 0; e < surface.cells.rows(); ++e) {
    Eigen::Matrix<double, 2, 4> x;
    Eigen::MatrixXd u(components, 4);
    for (int k = 0; k < 4; ++k) {
      x.col(k) = surface.nodes.row(surface.cells(e, k)).head<2>().transpose();
      u.col(k) = U.segment(components * surface.cells(e, k), components);
    }
    const Eigen::Matrix2d J = x * central;
    for (int k = 0; k < 4; ++k) {
      const int node = surface.cells(e, k);
      sum[static_cast<std::size_t>(node)] += std::abs(J.determinant()) * u * central * J.inverse();
      area[node] += std::abs(J.determinant());
    }
  }
  for (std::size_t i = 0; i < sum.size(); ++i) sum[i] /= area[static_cast<Index>(i)];
  return sum;
}

/// What cameras `wrong` take for the displacement U that cameras `truth` have recorded, less U.
Eigen::VectorXd error_of(const mesh::Mesh& surface, const Cameras& truth, const Cameras& wrong,
                         const Eigen::VectorXd& U, int components) {
  const auto gradient = slopes(surface, U, components);
  Eigen::VectorXd error = Eigen::VectorXd::Zero(U.size());
  const auto count = static_cast<Index>(truth.size());
  for (Index i = 0; i < surface.nodes.rows(); ++i) {
    const Eigen::Vector3d X = surface.nodes.row(i).transpose();
    const Eigen::VectorXd u = U.segment(components * i, components);
    Eigen::VectorXd seen(2 * count), found = u;
    for (Index c = 0; c < count; ++c) {
      const auto& camera = *truth[static_cast<std::size_t>(c)];
      // The point that is in truth where the node is taken to be, and where its image goes.
      const Eigen::Vector2d away = camera.jacobian(X).leftCols<2>().inverse() *
                                   (wrong[static_cast<std::size_t>(c)]->project(X) - camera.project(X));
      Eigen::Vector3d x = X;
      x.head<2>() += away;
      const Eigen::VectorXd there = u + gradient[static_cast<std::size_t>(i)] * away;
      for (int a = 0; a < components; ++a) x[a] += there[a];
      seen.segment<2>(2 * c) = camera.project(x);
    }
    for (int iteration = 0; iteration < 5; ++iteration) {
      Eigen::MatrixXd J(2 * count, components);
      Eigen::VectorXd miss(2 * count);
      Eigen::Vector3d x = X;
      for (int a = 0; a < components; ++a) x[a] += found[a];
      for (Index c = 0; c < count; ++c) {
        J.middleRows<2>(2 * c) = wrong[static_cast<std::size_t>(c)]->jacobian(x).leftCols(components);
        miss.segment<2>(2 * c) = seen.segment<2>(2 * c) - wrong[static_cast<std::size_t>(c)]->project(x);
      }
      found += least_squares(J, miss);
    }
    error.segment(components * i, components) = found - u;
  }
  return error;
}

}  // namespace

Eigen::VectorXd calibration_deviations(const io::CameraCase& declared) {
  const auto& names = imaging::camera_number_names;
  Eigen::VectorXd deviations = Eigen::VectorXd::Zero(camera_numbers);
  for (const auto& [name, value] : declared.calibration_sd) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end())
      throw InputError("cameras." + declared.name + ".calibration_sd", name, fmt::format("{}", fmt::join(names, ", ")));
    deviations[found - names.begin()] = value;
  }
  return deviations;
}

std::vector<Eigen::MatrixXd> calibration_errors(const Observation& observation, const io::Case& test,
                                                const identification::Specimen& specimen, const Eigen::MatrixXd& U,
                                                int draws, unsigned seed) {
  std::vector<Uncertainty> of_face;
  Index uncertain = 0;
  for (const auto& face : observation.faces) {
    of_face.push_back(uncertainty(test, *face.rig));
    uncertain += of_face.back().root.cols();
  }
  if (uncertain == 0 || draws == 0) return {};
  // With as many draws as uncertain numbers their sample covariance is made exact: the share is then that of a linear
  // answer.
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd white(draws, uncertain);
  for (double& value : white.reshaped()) value = normal(random);
  if (draws >= uncertain) white = std::sqrt(draws) * orthonormal(white);
  std::vector<Eigen::MatrixXd> errors(static_cast<std::size_t>(draws), Eigen::MatrixXd::Zero(U.rows(), U.cols()));
  Index column = 0;
  for (std::size_t k = 0; k < observation.faces.size(); ++k) {
    const Rig& rig = *observation.faces[k].rig;
    const auto& face = specimen.faces[k];
    const Uncertainty& numbers = of_face[k];
    if (numbers.root.cols() == 0) continue;
    Cameras truth;
    std::vector<bool> movable;
    for (std::size_t c = 0; c < rig.views.size(); ++c) {
      truth.push_back(rig.views[c].camera);
      const auto& declared = test.cameras[static_cast<std::size_t>(rig.cameras[c])];
      movable.push_back(declared.model == "pinhole" && declared.frame == "rig");
    }
    const Eigen::Vector3d middle = rig.surface.nodes.colwise().mean();
    for (std::size_t d = 0; d < errors.size(); ++d) {
      const Eigen::VectorXd drawn =
          numbers.root * white.row(static_cast<Index>(d)).segment(column, numbers.root.cols()).transpose();
      Cameras wrong;
      for (std::size_t c = 0; c < truth.size(); ++c) {
        const Index at = numbers.first[c];
        if (const auto* camera = dynamic_cast<const PinholeCamera*>(truth[c].get()))
          wrong.push_back(std::make_shared<PinholeCamera>(
              disturbed(*camera, numbers.centre[c], drawn.segment(at, camera_numbers))));
        else
          wrong.push_back(std::make_shared<imaging::TelecentricCamera>(
              disturbed(*truth[c], middle, 1.0 + drawn[at], drawn[at + 1])));
      }
      wrong = placed(rig.surface, truth, std::move(wrong), movable);
      for (Index t = 0; t < U.cols(); ++t)
        errors[d].col(t).segment(face.first_unknown, face.unknowns()) =
            error_of(rig.surface, truth, wrong, U.col(t).segment(face.first_unknown, face.unknowns()), face.components);
    }
    column += numbers.root.cols();
  }
  return errors;
}

}  // namespace imic3d::app
