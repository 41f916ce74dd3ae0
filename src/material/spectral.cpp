#include "imic3d/material/spectral.hpp"

#include <algorithm>
#include <cmath>

namespace imic3d::material {
namespace {

/// Position of the second divided difference at eigenvalues a, b, c among the ten different ones.
constexpr int triple_index(int a, int b, int c) {
  constexpr int table[3][3][3] = {
      {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}}, {{1, 3, 4}, {3, 6, 7}, {4, 7, 8}}, {{2, 4, 5}, {4, 7, 8}, {5, 8, 9}}};
  return table[a][b][c];
}

/// The 6 x 6 matrix that takes the components of a symmetric tensor (not engineering shears) from the axes that are
/// the columns of Q to the global ones; its transpose takes engineering strains the other way.
Matrix6 component_rotation(const Tensor<double>& Q) {
  Matrix6 K;
  for (int column = 0; column < 6; ++column) {
    const int a = symmetric_row[column], b = symmetric_column[column];
    for (int row = 0; row < 6; ++row) {
      const int i = symmetric_row[row], j = symmetric_column[row];
      K(row, column) = a == b ? Q(i, a) * Q(j, a) : Q(i, a) * Q(j, b) + Q(i, b) * Q(j, a);
    }
  }
  return K;
}

Tensor<double> transposed(const Tensor<double>& A) {
  return {{A(0, 0), A(1, 0), A(2, 0), A(0, 1), A(1, 1), A(2, 1), A(0, 2), A(1, 2), A(2, 2)}};
}

/// Turns the plane (p, q) so that A(p, q) vanishes; r is the third axis.
void jacobi_rotation(SymmetricTensor<double>& A, Tensor<double>& V, int p, int q, int r) {
  const double off_diagonal = A(p, q);
  const double square = off_diagonal * off_diagonal;
  if (square == 0.0) return;
  const double half_gap = 0.5 * (A(q, q) - A(p, p));
  const double tangent = off_diagonal / (half_gap + std::copysign(std::sqrt(half_gap * half_gap + square), half_gap));
  const double cosine = 1.0 / std::sqrt(1.0 + tangent * tangent), sine = tangent * cosine;
  A(p, p) -= tangent * off_diagonal;
  A(q, q) += tangent * off_diagonal;
  A(p, q) = 0.0;
  const double rp = A(r, p), rq = A(r, q);
  A(r, p) = cosine * rp - sine * rq;
  A(r, q) = sine * rp + cosine * rq;
  for (int i = 0; i < 3; ++i) {
    const double vp = V(i, p), vq = V(i, q);
    V(i, p) = cosine * vp - sine * vq;
    V(i, q) = sine * vp + cosine * vq;
  }
}

}  // namespace

SpectralDecomposition spectral_decomposition(const SymmetricTensor<double>& A) noexcept {
  SymmetricTensor<double> D = A;
  Tensor<double> V{{1, 0, 0, 0, 1, 0, 0, 0, 1}};
  // What is left off the diagonal counts to second order only, relative to the gap; a unit in the last place of |A|
  // is harmless even without a gap.
  const double negligible = 1e-34 * double_dot(A, A);
  for (int sweep = 0; sweep < 12; ++sweep) {
    if (!(D[3] * D[3] + D[4] * D[4] + D[5] * D[5] > negligible)) break;
    jacobi_rotation(D, V, 0, 1, 2);
    jacobi_rotation(D, V, 0, 2, 1);
    jacobi_rotation(D, V, 1, 2, 0);
  }
  return {{D[0], D[1], D[2]}, V};
}

namespace divided_difference {

double logarithm(double x_a, double x_b) noexcept {
  const double r = (x_a - x_b) / x_b;
  if (r == 0.0) return 1.0 / x_b;
  return std::log1p(r) / (r * x_b);
}

double logarithm(double x_a, double x_b, double x_c) noexcept {
  const double low = std::min({x_a, x_b, x_c}), high = std::max({x_a, x_b, x_c});
  const double mean = (x_a + x_b + x_c) / 3.0;
  if (high - low > 0.02 * mean) {
    const double middle = std::max(std::min(x_a, x_b), std::min(std::max(x_a, x_b), x_c));
    return (logarithm(high, middle) - logarithm(middle, low)) / (high - low);
  }
  // ln[abc] = 1/m^2 sum_k (-1)^(k+1)/k h_(k-2)(u_a,u_b,u_c), u = x/m - 1, h_j the complete homogeneous symmetric
  // polynomials: h_j = e1 h_(j-1) - e2 h_(j-2) + e3 h_(j-3), and e1 = 0 about the mean.
  const double u_a = (x_a - mean) / mean, u_b = (x_b - mean) / mean, u_c = (x_c - mean) / mean;
  const double e2 = u_a * u_b + u_b * u_c + u_c * u_a, e3 = u_a * u_b * u_c;
  const double h2 = -e2, h3 = e3, h4 = e2 * e2, h5 = -2.0 * e2 * e3, h6 = -e2 * h4 + e3 * h3;
  const double sum = -1.0 / 2.0 - h2 / 4.0 + h3 / 5.0 - h4 / 6.0 + h5 / 7.0 - h6 / 8.0;
  return sum / (mean * mean);
}

double exponential(double z_a, double z_b) noexcept {
  const double half = 0.5 * (z_a - z_b);
  return std::exp(0.5 * (z_a + z_b)) * (half == 0.0 ? 1.0 : std::sinh(half) / half);
}

}  // namespace divided_difference

LogarithmicStrain::LogarithmicStrain(const SymmetricTensor<double>& B) noexcept : spectrum_(spectral_decomposition(B)) {
  const auto& y = spectrum_.values;
  valid_ = y[0] > -1.0 && y[1] > -1.0 && y[2] > -1.0 && std::isfinite(y[0] + y[1] + y[2]);
  if (!valid_) return;
  for (std::size_t a = 0; a < 3; ++a) principal_[a] = 0.5 * std::log1p(y[a]);
  for (int k = 0; k < 6; ++k) {
    const auto a = static_cast<std::size_t>(symmetric_row[k]), b = static_cast<std::size_t>(symmetric_column[k]);
    if (a == b) {
      first_[k] = 1.0 / (1.0 + y[a]);
    } else {
      const double x_b = 1.0 + y[b], r = (y[a] - y[b]) / x_b;
      first_[k] = r == 0.0 ? 1.0 / x_b : std::log1p(r) / (r * x_b);
    }
  }
}

SymmetricTensor<double> LogarithmicStrain::scaled_in_eigenbasis(const SymmetricTensor<double>& A,
                                                                double factor) const noexcept {
  SymmetricTensor<double> in_eigenbasis = pull_back(spectrum_.vectors, A);
  for (int k = 0; k < 6; ++k) in_eigenbasis[k] *= factor * first_[k];
  return push_forward(spectrum_.vectors, in_eigenbasis);
}

void LogarithmicStrain::second_differences(std::array<double, 10>& f) const noexcept {
  const double x[3] = {1.0 + spectrum_.values[0], 1.0 + spectrum_.values[1], 1.0 + spectrum_.values[2]};
  for (int a = 0; a < 3; ++a)
    for (int b = a; b < 3; ++b)
      for (int c = b; c < 3; ++c)
        f[static_cast<std::size_t>(triple_index(a, b, c))] = divided_difference::logarithm(x[a], x[b], x[c]);
}

// 2 T : d2E/dC2 : (dB, .), the part of dS that comes from the turning and stretching of the elastic strain's axes.
SymmetricTensor<double> LogarithmicStrain::curvature(const SymmetricTensor<double>& stress,
                                                     const SymmetricTensor<double>& dB) const noexcept {
  std::array<double, 10> f;
  second_differences(f);
  const SymmetricTensor<double> T = pull_back(spectrum_.vectors, stress), D = pull_back(spectrum_.vectors, dB);
  SymmetricTensor<double> result = SymmetricTensor<double>::zero();
  for (int c = 0; c < 3; ++c)
    for (int b = 0; b < 3; ++b)
      for (int a = 0; a < 3; ++a)
        result(c, b) += (b == c ? 2.0 : 1.0) * T(a, b) * f[static_cast<std::size_t>(triple_index(a, b, c))] * D(a, c);
  return push_forward(spectrum_.vectors, result);
}

Matrix6 LogarithmicStrain::spatial_tangent(const Tensor<double>& Fe, const SymmetricTensor<double>& stress,
                                           const Matrix6& material_tangent) const noexcept {
  std::array<double, 10> f;
  second_differences(f);
  // Spatial principal axes n_a = Fe N_a / lambda_a.
  const Tensor<double>& N = spectrum_.vectors;
  Tensor<double> n = Fe * N;
  double stretch[3];
  for (int a = 0; a < 3; ++a) {
    stretch[a] = std::sqrt(1.0 + spectrum_.values[static_cast<std::size_t>(a)]);
    for (int i = 0; i < 3; ++i) n(i, a) /= stretch[a];
  }
  // c[d1,d2] = (dE/dC : C1) : A : (dE/dC : C2) + T : d2E/dC2 : (C1, C2), with C_ab = 2 lambda_a lambda_b d_ab.
  Vector6 strain_per_deformation, c_per_deformation;
  for (int k = 0; k < 6; ++k) {
    const int a = symmetric_row[k], b = symmetric_column[k];
    strain_per_deformation[k] = stretch[a] * stretch[b] * first_[k];
    c_per_deformation[k] = (a == b ? 2.0 : 1.0) * stretch[a] * stretch[b];
  }
  const Matrix6 to_eigenbasis = component_rotation(transposed(N));
  Matrix6 half, tangent;
  half.noalias() = to_eigenbasis * material_tangent;
  tangent.noalias() = half * to_eigenbasis.transpose();
  tangent = strain_per_deformation.asDiagonal() * tangent * strain_per_deformation.asDiagonal();
  const SymmetricTensor<double> T = pull_back(N, stress);
  for (int c = 0; c < 3; ++c)
    for (int b = 0; b < 3; ++b)
      for (int a = 0; a < 3; ++a) {
        const int ac = symmetric_index[a][c], cb = symmetric_index[c][b];
        tangent(ac, cb) += T(a, b) * f[static_cast<std::size_t>(triple_index(a, b, c))] * c_per_deformation[ac] *
                           c_per_deformation[cb];
      }
  const Matrix6 to_space = component_rotation(n);
  half.noalias() = to_space * tangent;
  Matrix6 spatial;
  spatial.noalias() = half * to_space.transpose();
  return spatial;
}

namespace detail {

void exponential_minus_identity(const SymmetricTensor<double>& A, SymmetricTensor<double>& result,
                                SymmetricTensor<double>* directions, int count) noexcept {
  const SpectralDecomposition spectrum = spectral_decomposition(A);
  const auto& z = spectrum.values;
  result = push_forward(spectrum.vectors,
                        SymmetricTensor<double>{{std::expm1(z[0]), std::expm1(z[1]), std::expm1(z[2]), 0.0, 0.0, 0.0}});
  if (count == 0) return;
  SymmetricTensor<double> first;
  for (int k = 0; k < 6; ++k)
    first[k] = divided_difference::exponential(z[static_cast<std::size_t>(symmetric_row[k])],
                                               z[static_cast<std::size_t>(symmetric_column[k])]);
  for (int k = 0; k < count; ++k) {
    SymmetricTensor<double> d = pull_back(spectrum.vectors, directions[k]);
    for (int i = 0; i < 6; ++i) d[i] *= first[i];
    directions[k] = push_forward(spectrum.vectors, d);
  }
}

}  // namespace detail
}  // namespace imic3d::material
