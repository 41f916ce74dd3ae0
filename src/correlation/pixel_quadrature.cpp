#include "imic3d/correlation/pixel_quadrature.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

namespace imic3d::correlation {
namespace {

using Corners = Eigen::Matrix<double, 4, 2>;

const Eigen::Vector4d corner_xi(-1.0, 1.0, 1.0, -1.0), corner_eta(-1.0, -1.0, 1.0, 1.0);

double total(const Eigen::VectorXd& values) { return std::accumulate(values.begin(), values.end(), 0.0); }

/// A nodal field of one element as c0 + c1 xi + c2 eta + c3 xi eta.
Eigen::Vector4d bilinear(const Eigen::Vector4d& nodal) {
  return 0.25 * Eigen::Vector4d(nodal.sum(), corner_xi.dot(nodal), corner_eta.dot(nodal),
                                corner_xi.cwiseProduct(corner_eta).dot(nodal));
}

/// Local coordinates of a point of the element whose corners have the bilinear coefficients x, y; Newton from `start`.
Eigen::Vector2d local_coordinates(const Eigen::Vector4d& x, const Eigen::Vector4d& y, const Eigen::Vector2d& point,
                                  Eigen::Vector2d start) {
  for (int iteration = 0; iteration < 30; ++iteration) {
    const double xi = start.x(), eta = start.y();
    const Eigen::Vector2d miss(point.x() - (x[0] + x[1] * xi + x[2] * eta + x[3] * xi * eta),
                               point.y() - (y[0] + y[1] * xi + y[2] * eta + y[3] * xi * eta));
    Eigen::Matrix2d jacobian;
    jacobian << x[1] + x[3] * eta, x[2] + x[3] * xi, y[1] + y[3] * eta, y[2] + y[3] * xi;
    const Eigen::Vector2d step = jacobian.inverse() * miss;
    start += step;
    if (step.cwiseAbs().maxCoeff() < 1e-10) break;
  }
  return start.cwiseMax(-1.001).cwiseMin(1.001);
}

/// A polygon's edges on a fine integer grid, so that which side a pixel lies on is exact and neighbours never disagree:
/// the pixels on an edge belong to the element on its upper left (the rule of rasterisation).
class Outline {
 public:
  static constexpr std::int64_t grid = 1 << 16;  // points per pixel
  explicit Outline(const Corners& corners) {
    for (int i = 0; i < 4; ++i)
      for (int k = 0; k < 2; ++k)
        corner_[static_cast<std::size_t>(i)][static_cast<std::size_t>(k)] = std::llround(corners(i, k) * grid);
    const auto& c = corner_;
    const std::int64_t twice_area =
        (c[2][0] - c[0][0]) * (c[3][1] - c[1][1]) - (c[3][0] - c[1][0]) * (c[2][1] - c[0][1]);
    if (twice_area < 0) std::reverse(corner_.begin(), corner_.end());
  }
  [[nodiscard]] bool convex() const {
    for (std::size_t i = 0; i < 4; ++i)
      if (side(i, corner_[(i + 2) % 4][0], corner_[(i + 2) % 4][1]) <= 0) return false;
    return true;
  }
  [[nodiscard]] bool owns(int column, int row) const {
    for (std::size_t i = 0; i < 4; ++i) {
      const std::int64_t s = side(i, column * grid, row * grid);
      if (s < 0) return false;
      if (s == 0) {
        const auto& a = corner_[i];
        const auto& b = corner_[(i + 1) % 4];
        if (!(b[1] < a[1] || (b[1] == a[1] && b[0] > a[0]))) return false;
      }
    }
    return true;
  }

 private:
  // Positive on the inner side of edge i.
  [[nodiscard]] std::int64_t side(std::size_t i, std::int64_t x, std::int64_t y) const {
    const auto& a = corner_[i];
    const auto& b = corner_[(i + 1) % 4];
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
  }
  std::array<std::array<std::int64_t, 2>, 4> corner_{};
};

constexpr double largest_element = 16000.0;  // [px]; Outline's products stay within 64 bits

double quad_area(const Corners& c) {
  return 0.5 * std::abs((c(2, 0) - c(0, 0)) * (c(3, 1) - c(1, 1)) - (c(3, 0) - c(1, 0)) * (c(2, 1) - c(0, 1)));
}

}  // namespace

PixelQuadrature::PixelQuadrature(const mesh::Mesh& quads, std::shared_ptr<const imaging::Camera> camera,
                                 const imaging::BSpline& reference, const Communicator& communicator,
                                 const QuadratureOptions& options)
    : communicator_(communicator),
      camera_(std::move(camera)),
      dofs_(options.dofs_per_node),
      points_(quads.nodes),
      cells_(quads.cells) {
  if (quads.type != mesh::CellType::quad4 || cells_.cols() != 4 || cells_.rows() == 0)
    throw InputError(options.name, "no quadrilaterals", "a surface mesh of 4-node quadrilaterals");
  if (dofs_ != 2 && dofs_ != 3) throw InputError(options.name, fmt::format("{} unknowns per node", dofs_), "2 or 3");
  place(reference, options);
  split();
  for (int element = first_, last = first_ + local_elements(); element < last; ++element)
    collect_pixels(element, reference, options.mask);
  pixels_of_elements_ = Eigen::VectorXd::Zero(elements());
  for (int k = 0; k < local_elements(); ++k)
    pixels_of_elements_[first_ + k] = static_cast<double>(local_begin(k + 1) - local_begin(k));
  communicator_.sum(std::span(pixels_of_elements_.data(), static_cast<std::size_t>(elements())));
  pixels_ = total(pixels_of_elements_);
  sum_gram();
  make_pattern();
}

void PixelQuadrature::place(const imaging::BSpline& reference, const QuadratureOptions& options) {
  if (options.mask != nullptr &&
      (options.mask->width != reference.width() || options.mask->height != reference.height()))
    throw InputError("mask of " + options.name,
                     fmt::format("{} x {} pixels", options.mask->width, options.mask->height),
                     fmt::format("{} x {} pixels like the reference image", reference.width(), reference.height()));
  positions_.resize(points_.rows(), 2);
  for (int node = 0; node < nodes(); ++node)
    positions_.row(node) = camera_->project(points_.row(node).transpose()).transpose();
  if (!positions_.allFinite())
    throw InputError(options.name, "nodes that the camera cannot see", "nodes in front of it");
  int left = 0, right = 0, above = 0, below = 0, outside = 0;
  std::vector<int> folded;
  const double width = reference.width() - 0.5, height = reference.height() - 0.5;
  for (int e = 0; e < elements(); ++e) {
    const Corners corners = of_element(positions_, e);
    const Eigen::Vector2d low = corners.colwise().minCoeff(), high = corners.colwise().maxCoeff();
    if ((high - low).maxCoeff() > largest_element)
      throw InputError(options.name, fmt::format("an element of {:.0f} pixels", (high - low).maxCoeff()),
                       fmt::format("elements of at most {:.0f} pixels", largest_element));
    const bool l = low.x()<-0.5, r = high.x()> width, a = low.y()<-0.5, b = high.y()> height;
    left += l, right += r, above += a, below += b, outside += l || r || a || b;
    if (!Outline(corners).convex()) folded.push_back(e);
  }
  if (outside > 0 && !options.clip)
    throw InputError(
        options.name,
        fmt::format("{} of {} elements reach beyond the reference image ({} left, {} right, {} above, {} below): "
                    "columns {:.1f} to {:.1f}, rows {:.1f} to {:.1f}",
                    outside, elements(), left, right, above, below, positions_.col(0).minCoeff(),
                    positions_.col(0).maxCoeff(), positions_.col(1).minCoeff(), positions_.col(1).maxCoeff()),
        fmt::format("a mesh that lies on the image, columns 0 to {} and rows 0 to {}", reference.width() - 1,
                    reference.height() - 1));
  if (!folded.empty())
    throw InputError(options.name,
                     fmt::format("{} elements that are not convex in the image, the first is number {}", folded.size(),
                                 folded.front()),
                     "elements with four convex corners");
}

Eigen::Matrix<double, 4, 2> PixelQuadrature::of_element(const InImage& values, int element) const {
  Corners corners;
  for (int i = 0; i < 4; ++i) corners.row(i) = values.row(cells_(element, i));
  return corners;
}

// Contiguous blocks of about equal area in the image.
void PixelQuadrature::split() {
  std::vector<double> area_before(static_cast<std::size_t>(elements()) + 1, 0.0);
  for (int e = 0; e < elements(); ++e)
    area_before[static_cast<std::size_t>(e) + 1] =
        area_before[static_cast<std::size_t>(e)] + quad_area(of_element(positions_, e));
  const auto bound = [&](int rank) {
    if (rank == communicator_.size()) return elements();
    const double share = area_before.back() * rank / communicator_.size();
    return static_cast<int>(std::lower_bound(area_before.begin(), area_before.end(), share) - area_before.begin());
  };
  first_ = bound(communicator_.rank());
  const int last = std::max(first_, bound(communicator_.rank() + 1));
  pixel_begin_.assign(static_cast<std::size_t>(last - first_) + 1, 0);
  run_begin_ = pixel_begin_;
}

void PixelQuadrature::collect_pixels(int element, const imaging::BSpline& reference, const imaging::Image* mask) {
  const Corners corners = of_element(positions_, element);
  const Outline outline(corners);
  const Eigen::Vector4d x = bilinear(corners.col(0)), y = bilinear(corners.col(1));
  const int first_column = std::max(0, static_cast<int>(std::floor(corners.col(0).minCoeff())));
  const int last_column = std::min(reference.width() - 1, static_cast<int>(std::ceil(corners.col(0).maxCoeff())));
  const int first_row = std::max(0, static_cast<int>(std::floor(corners.col(1).minCoeff())));
  const int last_row = std::min(reference.height() - 1, static_cast<int>(std::ceil(corners.col(1).maxCoeff())));
  Eigen::Vector2d local(0.0, 0.0);
  for (int row = first_row; row <= last_row; ++row) {
    bool in_run = false;
    for (int column = first_column; column <= last_column; ++column) {
      if (!outline.owns(column, row) || (mask != nullptr && (*mask)(column, row) == 0.0F)) {
        in_run = false;
        continue;
      }
      if (!in_run) runs_.push_back({row, column, 0});
      in_run = true;
      ++runs_.back().count;
      local = local_coordinates(x, y, Eigen::Vector2d(column, row), local);
      const auto sample = reference.sample(column, row);
      xi_.push_back(static_cast<float>(local.x()));
      eta_.push_back(static_cast<float>(local.y()));
      grey_.push_back(sample.value);
      slope_x_.push_back(sample.slope.x());
      slope_y_.push_back(sample.slope.y());
    }
  }
  pixel_begin_[static_cast<std::size_t>(element - first_) + 1] = grey_.size();
  run_begin_[static_cast<std::size_t>(element - first_) + 1] = runs_.size();
}

void PixelQuadrature::sum_gram() {
  gram_.resize(static_cast<std::size_t>(local_elements()));
#pragma omp parallel for schedule(static)
  for (int k = 0; k < local_elements(); ++k) {
    Gram& gram = gram_[static_cast<std::size_t>(k)];
    for (auto& sums : gram) sums.fill(0.0);
    for (std::size_t p = local_begin(k); p < local_begin(k + 1); ++p) {
      const double xi = xi_[p], eta = eta_[p], fx = slope_x_[p], fy = slope_y_[p];
      const std::array<double, 4> N{0.25 * (1 - xi) * (1 - eta), 0.25 * (1 + xi) * (1 - eta),
                                    0.25 * (1 + xi) * (1 + eta), 0.25 * (1 - xi) * (1 + eta)};
      const double xx = fx * fx, xy = fx * fy, yy = fy * fy;
      std::size_t pair = 0;
      for (std::size_t i = 0; i < 4; ++i)
        for (std::size_t j = i; j < 4; ++j, ++pair) {
          const double NN = N[i] * N[j];
          gram[pair][0] += NN * xx, gram[pair][1] += NN * xy, gram[pair][2] += NN * yy;
        }
    }
  }
}

// The pattern of M and, for every entry of this rank's element matrices, its place among M's values.
void PixelQuadrature::make_pattern() {
  std::vector<std::vector<int>> neighbours(static_cast<std::size_t>(nodes()));
  for (int e = 0; e < elements(); ++e)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) neighbours[static_cast<std::size_t>(cells_(e, i))].push_back(cells_(e, j));
  pattern_.resize(unknowns(), unknowns());
  Eigen::VectorXi entries(unknowns());
  for (int node = 0; node < nodes(); ++node) {
    auto& list = neighbours[static_cast<std::size_t>(node)];
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    for (int a = 0; a < dofs_; ++a) entries[node * dofs_ + a] = static_cast<int>(list.size()) * dofs_;
  }
  pattern_.reserve(entries);
  for (int node = 0; node < nodes(); ++node)
    for (int a = 0; a < dofs_; ++a)
      for (const int other : neighbours[static_cast<std::size_t>(node)])
        for (int c = 0; c < dofs_; ++c) pattern_.insert(other * dofs_ + c, node * dofs_ + a) = 0.0;
  pattern_.makeCompressed();
  slots_.reserve(static_cast<std::size_t>(local_elements() * 16));
  for (int k = 0; k < local_elements(); ++k)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) {  // first entry of the block (row node i, column node j), column component 0
        const int row = cells_(first_ + k, i), column = cells_(first_ + k, j);
        const auto& list = neighbours[static_cast<std::size_t>(column)];
        const auto rank = static_cast<int>(std::lower_bound(list.begin(), list.end(), row) - list.begin());
        slots_.push_back(pattern_.outerIndexPtr()[column * dofs_] + rank * dofs_);
      }
}

Eigen::Vector3d PixelQuadrature::displaced(int node, const Eigen::VectorXd& U) const {
  Eigen::Vector3d point(points_(node, 0), points_(node, 1), points_(node, 2));
  for (int a = 0; a < dofs_; ++a) point[a] += U[static_cast<Eigen::Index>(node) * dofs_ + a];
  return point;
}

Eigen::SparseMatrix<double> PixelQuadrature::matrix() const { return assemble(nullptr, nullptr); }

Eigen::SparseMatrix<double> PixelQuadrature::matrix(const Eigen::VectorXd& U) const {
  std::vector<Eigen::Matrix2d> transport = deformation_gradient(U);
  for (Eigen::Matrix2d& F : transport) F = F.inverse().transpose().eval();
  return assemble(&transport, &U);
}

// Eq. (8): M = N^T grad F grad F^T N. The sums over the pixels were made once; a transported gradient T grad F with one
// T an element turns each block S into T S T^T, so no pixel is visited again.
Eigen::SparseMatrix<double> PixelQuadrature::assemble(const std::vector<Eigen::Matrix2d>* transport,
                                                      const Eigen::VectorXd* U) const {
  Eigen::SparseMatrix<double> M = pattern_;
  double* const values = M.valuePtr();
  std::fill(values, values + M.nonZeros(), 0.0);
  for (int k = 0; k < local_elements(); ++k) {
    const int e = first_ + k;
    std::array<Eigen::Matrix<double, 2, 3>, 4> J;  // d(pixel)/d(displacement) at the nodes
    for (int i = 0; i < 4; ++i)
      J[static_cast<std::size_t>(i)] = camera_->jacobian(
          U != nullptr ? displaced(cells_(e, i), *U) : Eigen::Vector3d(points_.row(cells_(e, i)).transpose()));
    const Gram& gram = gram_[static_cast<std::size_t>(k)];
    std::size_t pair = 0;
    for (int i = 0; i < 4; ++i)
      for (int j = i; j < 4; ++j, ++pair) {
        Eigen::Matrix2d S;
        S << gram[pair][0], gram[pair][1], gram[pair][1], gram[pair][2];
        if (transport != nullptr) {
          const Eigen::Matrix2d& T = (*transport)[static_cast<std::size_t>(e)];
          S = (T * S * T.transpose()).eval();
        }
        const Eigen::Matrix3d block = J[static_cast<std::size_t>(i)].transpose() * S * J[static_cast<std::size_t>(j)];
        const auto add = [&](int row, int column, const Eigen::Matrix3d& entries) {
          int slot = slots_[static_cast<std::size_t>(k * 16 + row * 4 + column)];
          const int stride =
              M.outerIndexPtr()[cells_(e, column) * dofs_ + 1] - M.outerIndexPtr()[cells_(e, column) * dofs_];
          for (int c = 0; c < dofs_; ++c, slot += stride)
            for (int a = 0; a < dofs_; ++a) values[slot + a] += entries(a, c);
        };
        add(i, j, block);
        if (i != j) add(j, i, block.transpose());
      }
  }
  communicator_.sum(std::span(values, static_cast<std::size_t>(M.nonZeros())));
  return M;
}

PixelQuadrature::InImage PixelQuadrature::pixel_displacement(const Eigen::VectorXd& U) const {
  if (U.size() != unknowns())
    throw InputError("displacement", fmt::format("{} values", U.size()),
                     fmt::format("{} ({} per node)", unknowns(), dofs_));
  InImage shift(nodes(), 2);
  for (int node = 0; node < nodes(); ++node)
    shift.row(node) = camera_->project(displaced(node, U)).transpose() - positions_.row(node);
  return shift;
}

std::vector<Eigen::Matrix2d> PixelQuadrature::deformation_gradient(const Eigen::VectorXd& U) const {
  const InImage shift = pixel_displacement(U);
  std::vector<Eigen::Matrix2d> F(static_cast<std::size_t>(elements()));
  Eigen::Matrix<double, 4, 2> slopes;  // dN/d(xi, eta) at the centre
  slopes << corner_xi / 4, corner_eta / 4;
  for (int e = 0; e < elements(); ++e) {
    const Eigen::Matrix2d reference = of_element(positions_, e).transpose() * slopes;
    F[static_cast<std::size_t>(e)] =
        Eigen::Matrix2d::Identity() + of_element(shift, e).transpose() * slopes * reference.inverse();
  }
  return F;
}

bool PixelQuadrature::interpolate(const imaging::BSpline& g, int k, const InImage& shift, float* values, float* slope_x,
                                  float* slope_y) const {
  const Corners u = of_element(shift, first_ + k);
  const Corners deformed = u + of_element(positions_, first_ + k);
  // The whole pixels of the displacement are taken out, so that single precision is enough for the rest.
  const int whole_x = static_cast<int>(std::floor(u.col(0).mean())),
            whole_y = static_cast<int>(std::floor(u.col(1).mean()));
  const Eigen::Vector4f ux = bilinear(u.col(0).array() - whole_x).cast<float>(),
                        uy = bilinear(u.col(1).array() - whole_y).cast<float>();
  // A pixel beyond an element's outline by rounding must not touch what lies outside: one pixel of margin.
  const bool inside = deformed.minCoeff() >= 1.0 && deformed.col(0).maxCoeff() <= g.width() - 2 &&
                      deformed.col(1).maxCoeff() <= g.height() - 2;
  bool all = true;
  std::size_t p = local_begin(k);
  for (const PixelRow& run : local_runs(k)) {
    const int column0 = run.column + whole_x, row0 = run.row + whole_y;
    for (int i = 0; i < run.count; ++i, ++p) {
      const float xi = xi_[p], eta = eta_[p];
      const float dx = ux[0] + ux[1] * xi + eta * (ux[2] + ux[3] * xi);
      const float dy = uy[0] + uy[1] * xi + eta * (uy[2] + uy[3] * xi);
      const float floor_x = std::floor(dx), floor_y = std::floor(dy);
      const int column = column0 + i + static_cast<int>(floor_x), row = row0 + static_cast<int>(floor_y);
      const float tx = dx - floor_x, ty = dy - floor_y;
      if (slope_x == nullptr && inside) {
        *values++ = g.value(column, row, tx, ty);
        continue;
      }
      const double x = column + static_cast<double>(tx), y = row + static_cast<double>(ty);
      const bool seen = g.contains(x, y);
      all = all && seen;
      const auto sample = seen ? g.sample(x, y) : imaging::BSpline::Sample{NAN, {NAN, NAN}};
      *values++ = sample.value;
      if (slope_x != nullptr) *slope_x++ = sample.slope.x(), *slope_y++ = sample.slope.y();
    }
  }
  return all;
}

namespace {

/// Sums of an element that give the gain and offset of the whole image by least squares.
struct BrightnessSums {
  double n = 0.0, f = 0.0, g = 0.0, fg = 0.0, gg = 0.0;
};

}  // namespace

Evaluation PixelQuadrature::evaluate(const imaging::BSpline& g, const Eigen::VectorXd& U,
                                     const EvaluationOptions& options) const {
  const InImage shift = pixel_displacement(U);
  const bool own_slopes = options.gradient == Gradient::deformed;
  const int mine = local_elements();
  Evaluation result;

  std::vector<float> level;  // g(x + u), kept for all pixels only if the brightness has to be known first
  if (options.brightness) {
    level.resize(local_pixels());
    std::vector<BrightnessSums> sums(static_cast<std::size_t>(mine));
#pragma omp parallel for schedule(static)
    for (int k = 0; k < mine; ++k) {
      const std::size_t begin = local_begin(k);
      interpolate(g, k, shift, level.data() + begin, nullptr, nullptr);
      BrightnessSums& s = sums[static_cast<std::size_t>(k)];
      for (std::size_t p = begin; p < local_begin(k + 1); ++p) {
        if (std::isnan(level[p])) continue;
        const double a = grey_[p], b = level[p];
        s.n += 1.0, s.f += a, s.g += b, s.fg += a * b, s.gg += b * b;
      }
    }
    std::array<double, 5> all{};
    for (const BrightnessSums& s : sums) all[0] += s.n, all[1] += s.f, all[2] += s.g, all[3] += s.fg, all[4] += s.gg;
    communicator_.sum(all);
    const auto [n, f_sum, g_sum, fg, gg] = all;
    const double variance = n * gg - g_sum * g_sum;
    if (n > 0.0 && variance > 1e-12 * n * gg) {
      result.gain = (n * fg - f_sum * g_sum) / variance;
      result.offset = (f_sum - result.gain * g_sum) / n;
    }
  }

  // Element sums: x and y of the four nodes in the image's frame, squares, pixels, dropped.
  constexpr int entries = 11;
  std::vector<double> sums(static_cast<std::size_t>(mine) * entries, 0.0);
  const auto gain = static_cast<float>(result.gain), offset = static_cast<float>(result.offset);
#pragma omp parallel
  {
    std::vector<float> values, dx, dy;
#pragma omp for schedule(static)
    for (int k = 0; k < mine; ++k) {
      const std::size_t begin = local_begin(k), count = local_begin(k + 1) - begin;
      const float* current = level.data() + begin;
      const float *gx = slope_x_.data() + begin, *gy = slope_y_.data() + begin;
      if (!options.brightness || own_slopes) {
        values.resize(count);
        if (own_slopes) dx.resize(count), dy.resize(count), gx = dx.data(), gy = dy.data();
        interpolate(g, k, shift, values.data(), own_slopes ? dx.data() : nullptr, own_slopes ? dy.data() : nullptr);
        current = values.data();
      }
      double* const sum = sums.data() + static_cast<std::ptrdiff_t>(k) * entries;
      std::size_t i = 0;
      for (const PixelRow& run : local_runs(k)) {
        Eigen::Array4f bx = Eigen::Array4f::Zero(), by = Eigen::Array4f::Zero();
        float squares = 0.0F;
        int seen = 0;
        for (int j = 0; j < run.count; ++j, ++i) {
          const float r = grey_[begin + i] - (gain * current[i] + offset);
          if (std::isnan(r)) continue;
          const float xi = xi_[begin + i], eta = eta_[begin + i];
          const float low = 0.25F - 0.25F * eta, high = 0.25F + 0.25F * eta;
          const Eigen::Array4f N(low - low * xi, low + low * xi, high + high * xi, high - high * xi);
          bx += N * (r * gx[i]);
          by += N * (r * gy[i]);
          squares += r * r;
          ++seen;
        }
        for (int a = 0; a < 4; ++a) sum[2 * a] += bx[a], sum[2 * a + 1] += by[a];
        sum[8] += squares;
        sum[9] += seen;
        sum[10] += run.count - seen;
      }
    }
  }

  std::vector<Eigen::Matrix2d> transport;
  if (options.gradient == Gradient::transported) {
    transport = deformation_gradient(U);
    for (Eigen::Matrix2d& F : transport) F = F.inverse().transpose().eval();
  }
  const double slope_scale = own_slopes ? result.gain : 1.0;
  // One message for everything: b, element squares, element pixels, dropped.
  std::vector<double> message(static_cast<std::size_t>(unknowns() + 2 * elements() + 1), 0.0);
  for (int k = 0; k < mine; ++k) {
    const int e = first_ + k;
    const double* const sum = sums.data() + static_cast<std::ptrdiff_t>(k) * entries;
    for (int i = 0; i < 4; ++i) {
      Eigen::Vector2d part(slope_scale * sum[2 * i], slope_scale * sum[2 * i + 1]);
      if (!transport.empty()) part = (transport[static_cast<std::size_t>(e)] * part).eval();
      const Eigen::Vector3d force = camera_->jacobian(displaced(cells_(e, i), U)).transpose() * part;
      for (int a = 0; a < dofs_; ++a) message[static_cast<std::size_t>(cells_(e, i) * dofs_ + a)] += force[a];
    }
    message[static_cast<std::size_t>(unknowns() + e)] = sum[8];
    message[static_cast<std::size_t>(unknowns() + elements() + e)] = sum[9];
    message.back() += sum[10];
  }
  communicator_.sum(message);
  result.b = Eigen::Map<Eigen::VectorXd>(message.data(), unknowns());
  result.element_squares = Eigen::Map<Eigen::VectorXd>(message.data() + unknowns(), elements());
  result.element_pixels = Eigen::Map<Eigen::VectorXd>(message.data() + unknowns() + elements(), elements());
  result.dropped = message.back();
  result.squares = total(result.element_squares);
  result.pixels = total(result.element_pixels);
  return result;
}

std::vector<float> PixelQuadrature::local_residuals(const imaging::BSpline& g, const Eigen::VectorXd& U, double gain,
                                                    double offset) const {
  const InImage shift = pixel_displacement(U);
  std::vector<float> residual(local_pixels());
#pragma omp parallel for schedule(static)
  for (int k = 0; k < local_elements(); ++k) {
    interpolate(g, k, shift, residual.data() + local_begin(k), nullptr, nullptr);
    for (std::size_t p = local_begin(k); p < local_begin(k + 1); ++p)
      residual[p] = grey_[p] - (static_cast<float>(gain) * residual[p] + static_cast<float>(offset));
  }
  return residual;
}

}  // namespace imic3d::correlation
