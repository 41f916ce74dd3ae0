#include "imic3d/correlation/correlation.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>

#include "imic3d/core/error.hpp"

namespace imic3d::correlation {

namespace {

using Corners = Eigen::Matrix<double, 2, 4>;

template <class T>
std::array<T, 4> shape(T xi, T eta) {
  const T a = T(1) - xi, b = T(1) + xi, c = T(1) - eta, d = T(1) + eta;
  return {T(0.25) * a * c, T(0.25) * b * c, T(0.25) * b * d, T(0.25) * a * d};
}

Eigen::Matrix<double, 4, 2> shape_gradient(double xi, double eta) {
  Eigen::Matrix<double, 4, 2> gradient;
  gradient << -(1 - eta), -(1 - xi), 1 - eta, -(1 + xi), 1 + eta, 1 + xi, -(1 + eta), 1 - xi;
  return 0.25 * gradient;
}

/// Local coordinates of a point of a bilinear quadrilateral, by Newton.
bool invert(const Corners& corners, const Eigen::Vector2d& point, Eigen::Vector2d& local) {
  for (int iteration = 0; iteration < 25; ++iteration) {
    const auto n = shape(local[0], local[1]);
    const Eigen::Vector2d gap = point - corners * Eigen::Map<const Eigen::Vector4d>(n.data());
    const Eigen::Matrix2d jacobian = corners * shape_gradient(local[0], local[1]);
    const Eigen::Vector2d step = jacobian.inverse() * gap;
    local += step;
    if (!local.allFinite() || local.cwiseAbs().maxCoeff() > 10.0) return false;
    if (step.cwiseAbs().maxCoeff() < 1e-12) return true;
  }
  return true;
}

}  // namespace

Correlation::Correlation(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera,
                         const imaging::BSpline& reference, bool brightness, const std::string& place)
    : surface_(surface), linear_(camera.linear.leftCols<2>()), brightness_(brightness) {
  const Eigen::Index elements = surface.cells.rows();
  std::vector<Eigen::Vector2d> projected;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) projected.push_back(camera.project(surface.nodes.row(i).transpose()));

  int outside = 0, worst = -1;
  for (Eigen::Index e = 0; e < elements; ++e)
    for (int a = 0; a < 4; ++a) {
      const auto& p = projected[static_cast<std::size_t>(surface.cells(e, a))];
      if (p[0] >= -0.5 && p[1] >= -0.5 && p[0] <= reference.width() - 0.5 && p[1] <= reference.height() - 0.5) continue;
      ++outside;
      worst = static_cast<int>(e);
      break;
    }
  if (outside > 0)
    throw InputError(place, fmt::format("{} of {} elements of the mesh do not lie on the image (the last: element {})", outside, elements, worst + 1),
                     fmt::format("a place that puts the whole mesh on the {} x {} pixels", reference.width(), reference.height()));

  // Each pixel belongs to the first element that contains its centre.
  std::vector<bool> taken(static_cast<std::size_t>(reference.width()) * static_cast<std::size_t>(reference.height()), false);
  auto& q = quadrature_;
  q.first.push_back(0);
  for (Eigen::Index e = 0; e < elements; ++e) {
    Corners corners;
    for (int a = 0; a < 4; ++a) corners.col(a) = projected[static_cast<std::size_t>(surface.cells(e, a))];
    const Eigen::Vector2d low = corners.rowwise().minCoeff(), high = corners.rowwise().maxCoeff();
    const int x0 = std::max(0, static_cast<int>(std::ceil(low[0]))), x1 = std::min(reference.width() - 1, static_cast<int>(std::floor(high[0])));
    const int y0 = std::max(0, static_cast<int>(std::ceil(low[1]))), y1 = std::min(reference.height() - 1, static_cast<int>(std::floor(high[1])));
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        const auto place_in_image = static_cast<std::size_t>(y) * static_cast<std::size_t>(reference.width()) + static_cast<std::size_t>(x);
        if (taken[place_in_image]) continue;
        Eigen::Vector2d local = Eigen::Vector2d::Zero();
        if (!invert(corners, Eigen::Vector2d(x, y), local) || local.cwiseAbs().maxCoeff() > 1.0 + 1e-9) continue;
        taken[place_in_image] = true;
        const auto sample = reference.sample(x, y);
        q.xi.push_back(static_cast<float>(local[0]));
        q.eta.push_back(static_cast<float>(local[1]));
        q.x.push_back(static_cast<float>(x));
        q.y.push_back(static_cast<float>(y));
        q.f.push_back(sample.value);
        q.fx.push_back(sample.slope[0]);
        q.fy.push_back(sample.slope[1]);
      }
    }
    q.first.push_back(q.x.size());
  }
}

Correlation::Gradient Correlation::deformed_gradient(const Eigen::VectorXd& U) const {
  const auto& q = quadrature_;
  Gradient gradient{std::vector<float>(q.pixels()), std::vector<float>(q.pixels())};
  const Eigen::Matrix2d inverse = linear_.inverse();
#pragma omp parallel for schedule(static)
  for (Eigen::Index e = 0; e < surface_.cells.rows(); ++e) {
    Corners corners, moved;
    for (int a = 0; a < 4; ++a) {
      const int node = surface_.cells(e, a);
      corners.col(a) = surface_.nodes.row(node).head<2>().transpose();
      moved.col(a) = corners.col(a) + U.segment<2>(2 * node);
    }
    for (std::size_t k = q.first[static_cast<std::size_t>(e)]; k < q.first[static_cast<std::size_t>(e) + 1]; ++k) {
      const auto dn = shape_gradient(q.xi[k], q.eta[k]);
      // Deformation gradient in pixels: A F A^-1.
      const Eigen::Matrix2d F = linear_ * (moved * dn) * (corners * dn).inverse() * inverse;
      const Eigen::Vector2d g = F.transpose().inverse() * Eigen::Vector2d(q.fx[k], q.fy[k]);
      gradient.x[k] = static_cast<float>(g[0]);
      gradient.y[k] = static_cast<float>(g[1]);
    }
  }
  return gradient;
}

Eigen::SparseMatrix<double> Correlation::M(const Gradient& gradient) const {
  const auto& q = quadrature_;
  const std::vector<float>&gx = gradient.x.empty() ? q.fx : gradient.x, &gy = gradient.y.empty() ? q.fy : gradient.y;
  const Eigen::Index elements = surface_.cells.rows();
  std::vector<Eigen::Matrix<double, 8, 8>> blocks(static_cast<std::size_t>(elements));
  const Eigen::Matrix2d transposed = linear_.transpose();
#pragma omp parallel for schedule(dynamic, 8)
  for (Eigen::Index e = 0; e < elements; ++e) {
    // Sums of N_a N_b g_i g_j: 10 products of shape functions times 3 of the gradient.
    std::array<std::array<double, 3>, 10> sums{};
    for (std::size_t k = q.first[static_cast<std::size_t>(e)]; k < q.first[static_cast<std::size_t>(e) + 1]; ++k) {
      const auto n = shape<double>(q.xi[k], q.eta[k]);
      const double xx = gx[k] * gx[k], xy = gx[k] * gy[k], yy = gy[k] * gy[k];
      std::size_t place = 0;
      for (std::size_t a = 0; a < 4; ++a)
        for (std::size_t b = a; b < 4; ++b, ++place) {
          const double nn = n[a] * n[b];
          sums[place][0] += nn * xx;
          sums[place][1] += nn * xy;
          sums[place][2] += nn * yy;
        }
    }
    auto& block = blocks[static_cast<std::size_t>(e)];
    std::size_t place = 0;
    for (int a = 0; a < 4; ++a)
      for (int b = a; b < 4; ++b, ++place) {
        Eigen::Matrix2d pixel;
        pixel << sums[place][0], sums[place][1], sums[place][1], sums[place][2];
        const Eigen::Matrix2d physical = transposed * pixel * linear_;
        block.block<2, 2>(2 * a, 2 * b) = physical;
        block.block<2, 2>(2 * b, 2 * a) = physical.transpose();
      }
  }
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<std::size_t>(elements) * 64);
  for (Eigen::Index e = 0; e < elements; ++e)
    for (int i = 0; i < 8; ++i)
      for (int j = 0; j < 8; ++j)
        entries.emplace_back(2 * surface_.cells(e, i / 2) + i % 2, 2 * surface_.cells(e, j / 2) + j % 2,
                             blocks[static_cast<std::size_t>(e)](i, j));
  const Eigen::Index size = 2 * surface_.nodes.rows();
  Eigen::SparseMatrix<double> matrix(size, size);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

Evaluation Correlation::evaluate(const imaging::BSpline& g, const Eigen::VectorXd& U, const Communicator& group,
                                 const Gradient& gradient) const {
  const auto& q = quadrature_;
  const std::vector<float>&gx = gradient.x.empty() ? q.fx : gradient.x, &gy = gradient.y.empty() ? q.fy : gradient.y;
  const Eigen::Index elements = surface_.cells.rows();
  const Eigen::Index begin = elements * group.rank() / group.size(), end = elements * (group.rank() + 1) / group.size();

  // Per element: sums of N_a g_i r, N_a g_i g(x+u), N_a g_i; r^2; pixels; and the moments that the light needs.
  constexpr int values = 8;
  struct Sums {
    std::array<double, values> with_f{}, with_g{}, with_one{};
    double n = 0, f = 0, g = 0, ff = 0, fg = 0, gg = 0;
  };
  std::vector<Sums> sums(static_cast<std::size_t>(elements));
#pragma omp parallel for schedule(dynamic, 8)
  for (Eigen::Index e = begin; e < end; ++e) {
    std::array<float, 4> ux, uy;
    for (int a = 0; a < 4; ++a) {
      const Eigen::Vector2d u = linear_ * U.segment<2>(2 * surface_.cells(e, a));
      ux[static_cast<std::size_t>(a)] = static_cast<float>(u[0]);
      uy[static_cast<std::size_t>(a)] = static_cast<float>(u[1]);
    }
    Sums& s = sums[static_cast<std::size_t>(e)];
    const std::size_t last = q.first[static_cast<std::size_t>(e) + 1];
    for (std::size_t k = q.first[static_cast<std::size_t>(e)]; k < last; ++k) {
      const auto n = shape(q.xi[k], q.eta[k]);
      const float x = q.x[k] + n[0] * ux[0] + n[1] * ux[1] + n[2] * ux[2] + n[3] * ux[3];
      const float y = q.y[k] + n[0] * uy[0] + n[1] * uy[1] + n[2] * uy[2] + n[3] * uy[3];
      if (!g.contains(x, y)) continue;
      const double f = q.f[k], v = g.value(x, y);
      s.n += 1.0;
      s.f += f;
      s.g += v;
      s.ff += f * f;
      s.fg += f * v;
      s.gg += v * v;
      for (std::size_t a = 0; a < 4; ++a) {
        const double bx = n[a] * gx[k], by = n[a] * gy[k];
        s.with_f[2 * a] += bx * f;
        s.with_f[2 * a + 1] += by * f;
        s.with_g[2 * a] += bx * v;
        s.with_g[2 * a + 1] += by * v;
        s.with_one[2 * a] += bx;
        s.with_one[2 * a + 1] += by;
      }
    }
  }

  // Light: least squares of f = gain g + offset over all pixels.
  Evaluation result;
  std::array<double, 6> total{};
  for (Eigen::Index e = begin; e < end; ++e) {
    const Sums& s = sums[static_cast<std::size_t>(e)];
    const std::array<double, 6> mine = {s.n, s.f, s.g, s.ff, s.fg, s.gg};
    for (std::size_t i = 0; i < 6; ++i) total[i] += mine[i];
  }
  if (group.size() > 1) group.sum(total);
  result.pixels = total[0];
  if (brightness_ && total[0] > 1.0) {
    const double variance = total[5] - total[2] * total[2] / total[0];
    result.gain = variance > 0.0 ? (total[4] - total[1] * total[2] / total[0]) / variance : 1.0;
    result.offset = (total[1] - result.gain * total[2]) / total[0];
  }

  const double gain = result.gain, offset = result.offset;
  const Eigen::Index unknowns = 2 * surface_.nodes.rows();
  Eigen::VectorXd all = Eigen::VectorXd::Zero(unknowns + elements + 1);
  for (Eigen::Index e = begin; e < end; ++e) {
    const Sums& s = sums[static_cast<std::size_t>(e)];
    const double squares = s.ff + gain * gain * s.gg + offset * offset * s.n - 2.0 * gain * s.fg - 2.0 * offset * s.f +
                           2.0 * gain * offset * s.g;
    all[unknowns + e] = s.n > 0.0 ? std::sqrt(std::max(0.0, squares) / s.n) : 0.0;
    all[unknowns + elements] += squares;
    for (int a = 0; a < 4; ++a) {
      Eigen::Vector2d b;
      for (int i = 0; i < 2; ++i) {
        const auto k = static_cast<std::size_t>(2 * a + i);
        b[i] = s.with_f[k] - gain * s.with_g[k] - offset * s.with_one[k];
      }
      all.segment<2>(2 * surface_.cells(e, a)) += linear_.transpose() * b;
    }
  }
  if (group.size() > 1) group.sum(std::span(all.data(), static_cast<std::size_t>(all.size())));
  result.b = all.head(unknowns);
  result.element_rms = all.segment(unknowns, elements);
  result.squares = all[unknowns + elements];
  return result;
}

std::vector<float> Correlation::residual(const imaging::BSpline& g, const Eigen::VectorXd& U) const {
  const auto& q = quadrature_;
  const Evaluation light = brightness_ ? evaluate(g, U, Communicator{MPI_COMM_SELF}) : Evaluation{};
  std::vector<float> residual(q.pixels(), std::numeric_limits<float>::quiet_NaN());
#pragma omp parallel for schedule(static)
  for (Eigen::Index e = 0; e < surface_.cells.rows(); ++e)
    for (std::size_t k = q.first[static_cast<std::size_t>(e)]; k < q.first[static_cast<std::size_t>(e) + 1]; ++k) {
      const auto n = shape<double>(q.xi[k], q.eta[k]);
      Eigen::Vector2d u = Eigen::Vector2d::Zero();
      for (int a = 0; a < 4; ++a) u += n[static_cast<std::size_t>(a)] * (linear_ * U.segment<2>(2 * surface_.cells(e, a)));
      const auto x = static_cast<float>(q.x[k] + u[0]), y = static_cast<float>(q.y[k] + u[1]);
      if (g.contains(x, y)) residual[k] = q.f[k] - static_cast<float>(light.gain * g.value(x, y) + light.offset);
    }
  return residual;
}

Eigen::SparseMatrix<double> Correlation::gradient_energy() const {
  std::vector<Eigen::Triplet<double>> entries;
  const double g = 1.0 / std::sqrt(3.0);
  for (Eigen::Index e = 0; e < surface_.cells.rows(); ++e) {
    Corners corners;
    for (int a = 0; a < 4; ++a) corners.col(a) = surface_.nodes.row(surface_.cells(e, a)).head<2>().transpose();
    Eigen::Matrix4d block = Eigen::Matrix4d::Zero();
    for (double xi : {-g, g})
      for (double eta : {-g, g}) {
        const auto dn = shape_gradient(xi, eta);
        const Eigen::Matrix2d jacobian = corners * dn;
        const Eigen::Matrix<double, 4, 2> gradient = dn * jacobian.inverse();
        block += jacobian.determinant() * gradient * gradient.transpose();
      }
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b)
        for (int i = 0; i < 2; ++i)
          entries.emplace_back(2 * surface_.cells(e, a) + i, 2 * surface_.cells(e, b) + i, block(a, b));
  }
  const Eigen::Index size = 2 * surface_.nodes.rows();
  Eigen::SparseMatrix<double> matrix(size, size);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

double Correlation::optical_density() const {
  const auto& q = quadrature_;
  double sum = 0.0;
  for (std::size_t k = 0; k < q.pixels(); ++k) sum += q.fx[k] * q.fx[k] + q.fy[k] * q.fy[k];
  const double scale = std::abs(linear_.determinant());  // pixels per area
  return 0.5 * sum / static_cast<double>(std::max<std::size_t>(1, q.pixels())) * scale * scale;
}

}  // namespace imic3d::correlation
