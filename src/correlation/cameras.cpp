#include "imic3d/correlation/cameras.hpp"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/correlation/smoothing.hpp"

namespace imic3d::correlation {

Cameras::Cameras(std::vector<std::shared_ptr<const Correlation>> cameras, const std::vector<double>& noise)
    : cameras_(std::move(cameras)), weights_(cameras_.size(), 1.0) {
  if (!noise.empty()) {
    double inverse = 0.0;
    for (const double sigma : noise) inverse += 1.0 / (sigma * sigma * static_cast<double>(noise.size()));
    for (std::size_t c = 0; c < weights_.size(); ++c) weights_[c] = 1.0 / (noise.at(c) * noise.at(c) * inverse);
  }
  for (const auto& camera : cameras_) {
    if (camera->nodes() != nodes() || camera->dofs_per_node() != dofs_per_node())
      throw InputError("cameras", fmt::format("{} nodes with {} unknowns", camera->nodes(), camera->dofs_per_node()),
                       fmt::format("the mesh of the first: {} nodes with {} unknowns", nodes(), dofs_per_node()));
    auto& sees = sees_.emplace_back(static_cast<std::size_t>(nodes()), cameras_.size() == 1);
    for (int e = 0; e < elements(); ++e)
      if (camera->quadrature().pixels_of(e) > 0)
        for (int i = 0; i < 4; ++i) sees[static_cast<std::size_t>(surface().cells(e, i))] = 1;
  }
}

void Cameras::find_epipolar_modes(const std::function<Eigen::MatrixXd(const Eigen::MatrixXd&)>& solve) {
  if (size() < 2 || dofs_per_node() < 3) return;
  const Eigen::Index rows = 2 * size(), across = rows - 3;
  Eigen::VectorXd root(rows);  // of the weights: the images' motions are compared in these
  for (int c = 0; c < size(); ++c) root.segment<2>(2 * c).setConstant(std::sqrt(weight(c)));
  const auto jacobian = [&](const Eigen::Vector3d& point) {
    Eigen::MatrixXd J(rows, 3);
    for (int c = 0; c < size(); ++c) J.middleRows<2>(2 * c) = root[2 * c] * (*this)[c].camera().jacobian(point);
    return J;
  };
  const Eigen::RowVector3d middle = 0.5 * (surface().nodes.colwise().minCoeff() + surface().nodes.colwise().maxCoeff());
  const Eigen::RowVector3d half = 0.5 * (surface().nodes.colwise().maxCoeff() - surface().nodes.colwise().minCoeff());
  // What no motion of the surface makes, in the middle; elsewhere what is left of that, in the images that see the
  // place: smooth, whatever the basis.
  const Eigen::MatrixXd J = jacobian(middle.transpose());
  const Eigen::MatrixXd off =
      symmetric_eigen(Eigen::MatrixXd::Identity(rows, rows) - J * pseudo_inverse(J)).vectors.rightCols(across);
  constexpr Eigen::Index degree = 6;  // 1 x y x^2 xy y^2
  modes_.assign(static_cast<std::size_t>(size()), Eigen::MatrixXd::Zero(2 * nodes(), degree * across));
  for (int node = 0; node < nodes(); ++node) {
    const Eigen::RowVector3d at = (surface().nodes.row(node) - middle) / half.head<2>().maxCoeff();
    Eigen::RowVector<double, degree> polynomial;
    polynomial << 1.0, at[0], at[1], at[0] * at[0], at[0] * at[1], at[1] * at[1];
    Eigen::MatrixXd here = jacobian(surface().nodes.row(node).transpose()), seen = off;
    for (int c = 0; c < size(); ++c)
      if (sees_[static_cast<std::size_t>(c)][static_cast<std::size_t>(node)] == 0)
        here.middleRows<2>(2 * c).setZero(), seen.middleRows<2>(2 * c).setZero();
    const Eigen::MatrixXd still_off = seen - here * (pseudo_inverse(here) * seen);
    for (int c = 0; c < size(); ++c)
      for (Eigen::Index k = 0; k < across; ++k)
        modes_[static_cast<std::size_t>(c)].block<2, degree>(2 * node, degree * k) =
            still_off.block<2, 1>(2 * c, k) * polynomial / root[2 * c];
  }
  Eigen::MatrixXd square = Eigen::MatrixXd::Zero(degree * across, degree * across),
                  force = Eigen::MatrixXd::Zero(unknowns(), degree * across);
  for (std::size_t c = 0; c < modes_.size(); ++c) {
    const Eigen::MatrixXd in_image = weights_[c] * cameras_[c]->M_in_image(modes_[c]);
    square += modes_[c].transpose() * in_image, force += cameras_[c]->projected(in_image);
  }
  const SymmetricEigen own = symmetric_eigen(square);
  constexpr double nothing = 1e-9, much = 0.5;
  const auto rank = static_cast<Eigen::Index>((own.values.array() > nothing * own.values.maxCoeff()).count());
  if (rank == 0) return modes_.clear();
  Eigen::MatrixXd orthogonal =
      own.vectors.rightCols(rank) * own.values.tail(rank).cwiseSqrt().cwiseInverse().asDiagonal();
  const Eigen::MatrixXd as_motion = force * orthogonal;
  const SymmetricEigen made_up = symmetric_eigen(as_motion.transpose() * solve(as_motion));
  const auto kept = static_cast<Eigen::Index>((made_up.values.array() < much).count());
  orthogonal = (orthogonal * made_up.vectors.leftCols(kept)).eval();
  for (auto& of_camera : modes_) of_camera = (of_camera * orthogonal).eval();
}

InImage Cameras::off_epipolar(int c, const Eigen::VectorXd& epipolar) const {
  if (epipolar.size() == 0) return {};
  return (modes_[static_cast<std::size_t>(c)] * epipolar).reshaped<Eigen::RowMajor>(nodes(), 2);
}

std::vector<InImage> Cameras::off_epipolar(const Eigen::VectorXd& epipolar) const {
  std::vector<InImage> all;
  for (int c = 0; c < size(); ++c) all.push_back(off_epipolar(c, epipolar));
  return all;
}

std::vector<double> Cameras::rms_off_epipolar(const Eigen::VectorXd& epipolar) const {
  std::vector<double> rms;
  for (const InImage& off : off_epipolar(epipolar)) rms.push_back(off.norm() / std::sqrt(static_cast<double>(nodes())));
  return rms;
}

Eigen::VectorXd Cameras::epipolar_of(const std::vector<InImage>& off) const {
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(epipolar_modes(), epipolar_modes());
  Eigen::VectorXd products = Eigen::VectorXd::Zero(epipolar_modes());
  for (std::size_t c = 0; c < modes_.size(); ++c)
    squares += modes_[c].transpose() * modes_[c],
        products += modes_[c].transpose() * off[c].reshaped<Eigen::RowMajor>();
  return solve_symmetric(squares, products);
}

std::size_t Cameras::pixels_of(int element) const {
  std::size_t pixels = 0;
  for (const auto& camera : cameras_) pixels += camera->quadrature().pixels_of(element);
  return pixels;
}

Eigen::SparseMatrix<double> Cameras::M() const { return sum_of_M(weights_); }

Eigen::SparseMatrix<double> Cameras::sum_of_M(std::span<const double> factors) const {
  Eigen::SparseMatrix<double> sum = factors[0] * cameras_[0]->M();
  for (std::size_t c = 1; c < cameras_.size(); ++c) sum += factors[c] * cameras_[c]->M();
  return sum;
}

Eigen::SparseMatrix<double> Cameras::M(const Eigen::VectorXd& U, const std::vector<Eigen::VectorXd>& shares) const {
  Eigen::SparseMatrix<double> sum = weights_[0] * cameras_[0]->M(U, shares[0]);
  for (std::size_t c = 1; c < cameras_.size(); ++c) sum += weights_[c] * cameras_[c]->M(U, shares[c]);
  return sum;
}

Eigen::SparseMatrix<double> Cameras::sum_of_gradient_noise(std::span<const double> factors) const {
  Eigen::SparseMatrix<double> sum = factors[0] * cameras_[0]->gradient_noise();
  for (std::size_t c = 1; c < cameras_.size(); ++c) sum += factors[c] * cameras_[c]->gradient_noise();
  return sum;
}

JointEvaluation Cameras::evaluate(std::span<const imaging::BSpline> g, const Eigen::VectorXd& U,
                                  const Communicator& group, Gradient gradient, const std::vector<InImage>& off) const {
  JointEvaluation all;
  all.b = Eigen::VectorXd::Zero(unknowns()), all.b_epipolar = Eigen::VectorXd::Zero(epipolar_modes());
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(elements()), pixels = squares;
  all.least = 1.0;
  for (std::size_t c = 0; c < cameras_.size(); ++c) {
    Evaluation seen =
        cameras_[c]->evaluate(g[c], U, group, gradient, Precision::single, off.empty() ? InImage{} : off[c]);
    all.b += weights_[c] * seen.b;
    if (!modes_.empty())
      all.b_epipolar += weights_[c] * modes_[c].transpose() * seen.in_image.reshaped<Eigen::RowMajor>();
    all.pixels += seen.pixels, all.dropped += seen.dropped;
    all.coefficient += seen.pixels * seen.coefficient;
    if (seen.pixels + seen.dropped > 0.0) all.least = std::min(all.least, seen.coefficient);
    squares += weights_[c] * seen.element_squares, pixels += seen.element_pixels;
    all.cameras.push_back(std::move(seen));
  }
  all.coefficient /= std::max(1.0, all.pixels);
  all.rms = std::sqrt(squares.sum() / std::max(1.0, all.pixels));
  all.element_rms = (squares.array() / pixels.array().max(1.0)).sqrt();
  return all;
}

std::vector<Eigen::Matrix2d> Cameras::deformation_gradient(const Eigen::VectorXd& U) const {
  std::vector<Eigen::Matrix2d> all;
  for (const auto& camera : cameras_) {
    const auto F = camera->deformation_gradient(U);
    for (int e = 0; e < elements(); ++e)
      all.push_back(cameras_.size() == 1 || camera->quadrature().pixels_of(e) > 0 ? F[static_cast<std::size_t>(e)]
                                                                                  : Eigen::Matrix2d::Identity());
  }
  return all;
}

Eigen::VectorXd Cameras::steps(const Eigen::VectorXd& U, const Eigen::VectorXd& update) const {
  Eigen::VectorXd longest = Eigen::VectorXd::Zero(nodes());
  for (std::size_t c = 0; c < cameras_.size(); ++c) {
    const InImage step = cameras_[c]->pixel_displacement(U + update) - cameras_[c]->pixel_displacement(U);
    for (int node = 0; node < nodes(); ++node)
      if (sees_[c][static_cast<std::size_t>(node)] != 0) {
        const double length = step.row(node).norm();
        if (!(length <= longest[node])) longest[node] = length;  // NaN too
      }
  }
  return longest;
}

Eigen::VectorXd Cameras::displacement(const std::vector<std::optional<InImage>>& moved,
                                      const Eigen::VectorXd& U) const {
  const int dofs = dofs_per_node();
  Eigen::VectorXd result = U;
  const auto cameras = static_cast<Eigen::Index>(cameras_.size());
  for (int node = 0; node < nodes(); ++node) {
    const Eigen::Vector3d X = surface().nodes.row(node).transpose();
    auto u = result.segment(static_cast<Eigen::Index>(node) * dofs, dofs);
    for (int iteration = 0; iteration < 5; ++iteration) {
      Eigen::MatrixXd J = Eigen::MatrixXd::Zero(2 * cameras, dofs);
      Eigen::VectorXd miss = Eigen::VectorXd::Zero(2 * cameras);
      Eigen::Vector3d x = X;
      for (int a = 0; a < dofs; ++a) x[a] += u[a];
      for (Eigen::Index c = 0; c < cameras; ++c) {
        const auto& target = moved[static_cast<std::size_t>(c)];
        if (!target) continue;
        const Correlation& camera = *cameras_[static_cast<std::size_t>(c)];
        miss.segment<2>(2 * c) =
            (camera.positions().row(node) + target->row(node)).transpose() - camera.camera().project(x);
        J.middleRows<2>(2 * c) = camera.camera().jacobian(x).leftCols(dofs);
      }
      if (!miss.allFinite()) break;
      const Eigen::VectorXd step = least_squares(J, miss, 1e-6);
      u += step;
      if ((J * step).norm() < 1e-6) break;
    }
  }
  return result;
}

double Cameras::smoothing_weight(double cut_off) const {
  double pixels = 0.0, weight = 0.0;
  for (const auto& camera : cameras_) pixels = std::max(pixels, static_cast<double>(camera->quadrature().pixels()));
  for (std::size_t c = 0; c < cameras_.size(); ++c)  // by the part of the mesh that the camera sees
    weight +=
        weights_[c] * correlation::smoothing_weight(*cameras_[c], cut_off) *
        (cameras_.size() == 1 ? 1.0 : static_cast<double>(cameras_[c]->quadrature().pixels()) / std::max(1.0, pixels));
  return weight;
}

std::vector<int> Cameras::hardly_seen(const Eigen::SparseMatrix<double>& M) const {
  const int dofs = dofs_per_node();
  std::vector<double> ratio, largest;  // of the eigenvalues of the node's block: the least to the largest
  for (int node = 0; node < nodes(); ++node) {
    const Eigen::Index first = static_cast<Eigen::Index>(node) * dofs;
    const Eigen::VectorXd values = symmetric_eigen(M.block(first, first, dofs, dofs)).values;
    largest.push_back(values[dofs - 1]);
    ratio.push_back(values[dofs - 1] > 0.0 ? values[0] / values[dofs - 1] : 0.0);
  }
  const auto usual = [](std::vector<double> values) {
    std::sort(values.begin(), values.end());
    return values[values.size() * 9 / 10];
  };
  const double usual_ratio = usual(ratio), usual_size = usual(largest);
  std::vector<int> result;
  for (int node = 0; node < nodes(); ++node) {
    const auto k = static_cast<std::size_t>(node);
    if (!(ratio[k] > 0.1 * usual_ratio) || largest[k] < 1e-6 * usual_size) result.push_back(node);
  }
  return result;
}

}  // namespace imic3d::correlation
