#include "imic3d/identification/way_between_frames.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>

namespace imic3d::identification {

namespace {

/// Slope between two secants over lengths, of a monotone curve; symmetric.
double inner_slope(double before, double after, double length_before, double length_after) {
  if (before * after <= 0.0) return 0.0;
  const double a = length_before + 2.0 * length_after, b = 2.0 * length_before + length_after;
  return (a + b) / (a / before + b / after);
}

/// Slope at an end, of a parabola as long as that is monotone.
double outer_slope(double secant, double next, double length, double next_length) {
  const double slope = ((2.0 * length + next_length) * secant - length * next) / (length + next_length);
  if (slope * secant <= 0.0) return 0.0;
  return secant * next <= 0.0 && std::abs(slope) > 3.0 * std::abs(secant) ? 3.0 * secant : slope;
}

}  // namespace

std::array<Eigen::MatrixXd, 2> bends(const Eigen::MatrixXd& displacement) {
  const Eigen::Index frames = displacement.cols();
  std::array<Eigen::MatrixXd, 2> result{Eigen::MatrixXd::Zero(displacement.rows(), frames),
                                        Eigen::MatrixXd::Zero(displacement.rows(), frames)};
  if (frames < 2) return result;
  Eigen::MatrixXd way = displacement;
  way.rightCols(frames - 1) -= displacement.leftCols(frames - 1);
  const Eigen::VectorXd length =
      way.colwise().norm().transpose().cwiseMax(std::max(1e-300, 1e-12 * displacement.lpNorm<Eigen::Infinity>()));
  const Eigen::MatrixXd secant = way * length.cwiseInverse().asDiagonal();
  const auto goes_on = [&](Eigen::Index a, Eigen::Index b) {
    return std::min(a, b) >= 0 && std::max(a, b) < frames && way.col(a).dot(way.col(b)) > 0.0;
  };
  for (Eigen::Index t = 0; t < frames; ++t)
    for (const Eigen::Index side : {0, 1}) {
      // across this end of the way, and across the other one
      const Eigen::Index next = t - 1 + 2 * side, other = t + 1 - 2 * side;
      for (Eigen::Index i = 0; i < displacement.rows(); ++i) {
        double slope = secant(i, t);
        if (goes_on(t, next))
          slope = inner_slope(secant(i, t), secant(i, next), length[t], length[next]);
        else if (goes_on(t, other))
          slope = outer_slope(secant(i, t), secant(i, other), length[t], length[other]);
        result[static_cast<std::size_t>(side)](i, t) = (slope - secant(i, t)) * length[t];
      }
    }
  return result;
}

std::array<Eigen::MatrixXd, 2> bends(const Eigen::MatrixXd& displacement, const std::vector<int>& dofs,
                                     const mesh::Nodes& nodes, bool straight) {
  using Complex = std::complex<double>;  // x + i y
  const Eigen::Index frames = displacement.cols();
  std::array<Eigen::MatrixXd, 2> result{Eigen::MatrixXd::Zero(displacement.rows(), frames),
                                        Eigen::MatrixXd::Zero(displacement.rows(), frames)};
  std::vector<Eigen::Index> driven;  // x of a node, with y behind it
  for (std::size_t i = 0; i + 1 < dofs.size(); ++i)
    if (dofs[i] % 3 == 0 && dofs[i + 1] == dofs[i] + 1) driven.push_back(static_cast<Eigen::Index>(i));
  const auto count = static_cast<Eigen::Index>(driven.size());
  if (count == 0) return result;

  Eigen::VectorXcd X(count);
  Eigen::VectorXd Z(count);
  Eigen::MatrixXcd u = Eigen::MatrixXcd::Zero(count, frames + 1);  // from rest on
  for (Eigen::Index k = 0; k < count; ++k) {
    const Eigen::Index i = driven[static_cast<std::size_t>(k)];
    const int node = dofs[static_cast<std::size_t>(i)] / 3;
    X[k] = {nodes(node, 0), nodes(node, 1)}, Z[k] = nodes(node, 2);
    for (Eigen::Index t = 0; t < frames; ++t) u(k, t + 1) = {displacement(i, t), displacement(i + 1, t)};
  }
  X.array() -= X.mean(), Z.array() -= Z.mean();

  // u = its mean + rotation (X + left) - X; in differences from rest, so that small displacements are as exact as large
  // ones.
  u.rowwise() -= u.colwise().mean().eval();
  Eigen::VectorXd angle(frames + 1);
  Eigen::MatrixXcd left(count, frames + 1);
  for (Eigen::Index t = 0; t <= frames; ++t) {
    angle[t] = std::arg(X.squaredNorm() + X.dot(u.col(t)));
    const double sine = std::sin(0.5 * angle[t]);
    left.col(t) = std::polar(1.0, -angle[t]) * u.col(t) + Complex(-2.0 * sine * sine, -std::sin(angle[t])) * X;
  }
  Eigen::MatrixXcd deformation = left.rightCols(frames);
  if (Z.squaredNorm() > 1e-12 * X.squaredNorm()) {
    const Eigen::VectorXcd through = Z.normalized().cast<Complex>();
    deformation -= through * (through.transpose() * deformation).eval();
  }
  Eigen::MatrixXd components(2 * count, frames);
  components << deformation.real(), deformation.imag();
  const auto bend = straight ? std::array<Eigen::MatrixXd, 2>{0.0 * components, 0.0 * components} : bends(components);

  for (Eigen::Index t = 0; t < frames; ++t) {
    const double turn = std::remainder(angle[t + 1] - angle[t], 2.0 * std::numbers::pi);
    for (const Eigen::Index side : {0, 1}) {
      const Eigen::VectorXd its = bend[static_cast<std::size_t>(side)].col(t);
      const Eigen::VectorXcd changes =
          left.col(t + 1) - left.col(t) + its.head(count) + Complex(0.0, 1.0) * its.tail(count);
      const Eigen::VectorXcd rate = std::polar(1.0, angle[t + side]) * changes +
                                    Complex(0.0, turn) * (X + u.col(t + side)),
                             faster = rate - (u.col(t + 1) - u.col(t));
      for (Eigen::Index k = 0; k < count; ++k) {
        const Eigen::Index i = driven[static_cast<std::size_t>(k)];
        result[static_cast<std::size_t>(side)](i, t) = faster[k].real(),
                                                  result[static_cast<std::size_t>(side)](i + 1, t) = faster[k].imag();
      }
    }
  }
  return result;
}

}  // namespace imic3d::identification
