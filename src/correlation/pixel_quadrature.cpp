#include "imic3d/correlation/pixel_quadrature.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>

#include "bilinear.hpp"

namespace imic3d::correlation {
namespace {

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
    // What is still missed [px]: the map has no other second derivative than this.
    if (std::abs(step.x() * step.y()) * std::max(std::abs(x[3]), std::abs(y[3])) < 1e-9) break;
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

Corners corners_of(const mesh::Cells& cells, const InImage& positions, Eigen::Index element) {
  Corners corners;
  for (int i = 0; i < 4; ++i) corners.row(i) = positions.row(cells(element, i));
  return corners;
}

void check(const mesh::Cells& cells, const InImage& positions, const imaging::BSpline& reference,
           const QuadratureOptions& options) {
  if (options.mask != nullptr &&
      (options.mask->width != reference.width() || options.mask->height != reference.height()))
    throw InputError("mask of " + options.place,
                     fmt::format("{} x {} pixels", options.mask->width, options.mask->height),
                     fmt::format("{} x {} pixels like the reference image", reference.width(), reference.height()));
  if (!positions.allFinite())
    throw InputError(options.place, "nodes that the camera cannot see", "nodes in front of it");
  int left = 0, right = 0, above = 0, below = 0, outside = 0;
  std::vector<Eigen::Index> folded;
  const double width = reference.width() - 0.5, height = reference.height() - 0.5;
  for (Eigen::Index e = 0; e < cells.rows(); ++e) {
    const Corners corners = corners_of(cells, positions, e);
    const Eigen::Vector2d low = corners.colwise().minCoeff(), high = corners.colwise().maxCoeff();
    if ((high - low).maxCoeff() > largest_element)
      throw InputError(options.place, fmt::format("an element of {:.0f} pixels", (high - low).maxCoeff()),
                       fmt::format("elements of at most {:.0f} pixels", largest_element));
    const bool l = low.x()<-0.5, r = high.x()> width, a = low.y()<-0.5, b = high.y()> height;
    left += l, right += r, above += a, below += b, outside += l || r || a || b;
    const bool touches = high.x() >= -0.5 && low.x() <= width && high.y() >= -0.5 && low.y() <= height;
    if (touches && !Outline(corners).convex()) folded.push_back(e);
  }
  if (outside > 0 && !options.clip)
    throw InputError(
        options.place,
        fmt::format("{} of {} elements reach beyond the reference image ({} left, {} right, {} above, {} below): "
                    "columns {:.1f} to {:.1f}, rows {:.1f} to {:.1f}",
                    outside, cells.rows(), left, right, above, below, positions.col(0).minCoeff(),
                    positions.col(0).maxCoeff(), positions.col(1).minCoeff(), positions.col(1).maxCoeff()),
        fmt::format("a mesh that lies on the image, columns 0 to {} and rows 0 to {}", reference.width() - 1,
                    reference.height() - 1));
  if (!folded.empty())
    throw InputError(options.place,
                     fmt::format("{} elements that are not convex in the image, the first is number {}", folded.size(),
                                 folded.front()),
                     "elements with four convex corners");
}

/// The mask with the pixels near the contour, the edges that belong to one element only, set to 0.
imaging::Image without_border(const mesh::Cells& cells, const InImage& positions, const imaging::BSpline& reference,
                              const QuadratureOptions& options) {
  imaging::Image mask(reference.width(), reference.height());
  if (options.mask != nullptr)
    mask = *options.mask;
  else
    std::fill(mask.grey.begin(), mask.grey.end(), 255.0F);
  const auto is_cut = [&](int node) {
    return std::find(options.cut_nodes.begin(), options.cut_nodes.end(), node) != options.cut_nodes.end();
  };
  std::map<std::pair<int, int>, int> times;
  const auto edge = [&](Eigen::Index e, int i) { return std::minmax(cells(e, i), cells(e, (i + 1) % 4)); };
  for (Eigen::Index e = 0; e < cells.rows(); ++e)
    for (int i = 0; i < 4; ++i) ++times[edge(e, i)];
  for (const auto& [nodes, count] : times) {
    if (count != 1 || (is_cut(nodes.first) && is_cut(nodes.second))) continue;
    const Eigen::Vector2d a = positions.row(nodes.first).transpose(),
                          along = positions.row(nodes.second).transpose() - a;
    const Eigen::Vector2d low = a.cwiseMin(a + along).array() - options.border,
                          high = a.cwiseMax(a + along).array() + options.border;
    const int last_row = std::min(mask.height - 1, static_cast<int>(std::floor(high.y())));
    const int last_column = std::min(mask.width - 1, static_cast<int>(std::floor(high.x())));
    for (int row = std::max(0, static_cast<int>(std::ceil(low.y()))); row <= last_row; ++row)
      for (int column = std::max(0, static_cast<int>(std::ceil(low.x()))); column <= last_column; ++column) {
        const Eigen::Vector2d from = Eigen::Vector2d(column, row) - a;
        const double place = std::clamp(from.dot(along) / along.squaredNorm(), 0.0, 1.0);
        if ((from - place * along).norm() < options.border) mask(column, row) = 0.0F;
      }
  }
  return mask;
}

/// Calls `visit(row, column)` for the element's pixels, row by row.
template <class Visit>
void for_each_pixel(const Corners& corners, const imaging::BSpline& reference, const imaging::Image* mask,
                    const Visit& visit) {
  const Outline outline(corners);
  const int first_column = std::max(0, static_cast<int>(std::floor(corners.col(0).minCoeff())));
  const int last_column = std::min(reference.width() - 1, static_cast<int>(std::ceil(corners.col(0).maxCoeff())));
  const int first_row = std::max(0, static_cast<int>(std::floor(corners.col(1).minCoeff())));
  const int last_row = std::min(reference.height() - 1, static_cast<int>(std::ceil(corners.col(1).maxCoeff())));
  for (int row = first_row; row <= last_row; ++row) {  // a row of a convex element is one run
    int begin = first_column, end = last_column + 1;
    while (begin < end && !outline.owns(begin, row)) ++begin;
    while (begin < end && !outline.owns(end - 1, row)) --end;
    for (int column = begin; column < end; ++column)
      if (mask == nullptr || (*mask)(column, row) != 0.0F) visit(row, column);
  }
}

}  // namespace

PixelQuadrature quadrature(const mesh::Cells& cells, const InImage& positions, const imaging::BSpline& reference,
                           const QuadratureOptions& options) {
  check(cells, positions, reference, options);
  imaging::Image inner;
  if (options.border > 0.0) inner = without_border(cells, positions, reference, options);
  const imaging::Image* const mask = options.border > 0.0 ? &inner : options.mask;
  const auto elements = static_cast<std::size_t>(cells.rows());
  PixelQuadrature q;
  q.first.assign(elements + 1, 0);
  q.first_row.assign(elements + 1, 0);
#pragma omp parallel for schedule(dynamic, 16)
  for (std::size_t e = 0; e < elements; ++e) {
    if (!options.left_out.empty() && options.left_out[e] != 0) continue;
    PixelRow row{-1, 0, 0};
    const auto count = [&](int y, int x) {
      if (y != row.row || x != row.column + row.count) row = {y, x, 0}, ++q.first_row[e + 1];
      ++row.count, ++q.first[e + 1];
    };
    for_each_pixel(corners_of(cells, positions, static_cast<Eigen::Index>(e)), reference, mask, count);
  }
  for (std::size_t e = 0; e < elements; ++e) q.first[e + 1] += q.first[e], q.first_row[e + 1] += q.first_row[e];
  q.rows.resize(q.first_row.back());
  for (auto* values : {&q.xi, &q.eta, &q.f, &q.fx, &q.fy}) values->resize(q.first.back());
#pragma omp parallel for schedule(dynamic, 16)
  for (std::size_t e = 0; e < elements; ++e) {
    const Corners corners = corners_of(cells, positions, static_cast<Eigen::Index>(e));
    const Eigen::Vector4d x = bilinear(corners.col(0)), y = bilinear(corners.col(1));
    std::size_t p = q.first[e], r = q.first_row[e];
    if (p == q.first[e + 1]) continue;
    PixelRow row{-1, 0, 0};
    Eigen::Vector2d local(0.0, 0.0);
    for_each_pixel(corners, reference, mask, [&](int at_row, int column) {
      if (at_row != row.row || column != row.column + row.count) row = {at_row, column, 0}, ++r;
      ++row.count;
      q.rows[r - 1] = row;
      local = local_coordinates(x, y, Eigen::Vector2d(column, at_row), local);
      const auto sample = reference.sample(column, at_row);
      q.xi[p] = static_cast<float>(local.x()), q.eta[p] = static_cast<float>(local.y());
      q.f[p] = sample.value, q.fx[p] = sample.slope.x(), q.fy[p] = sample.slope.y();
      ++p;
    });
  }
  return q;
}

Eigen::VectorXd variance_of_elements(const PixelQuadrature& q) {
  Eigen::VectorXd variance = Eigen::VectorXd::Zero(q.elements());
  for (int e = 0; e < q.elements(); ++e) {
    const auto count = static_cast<Eigen::Index>(q.pixels_of(e));
    if (count == 0) continue;
    const Eigen::ArrayXd f =
        Eigen::Map<const Eigen::ArrayXf>(q.f.data() + q.first[static_cast<std::size_t>(e)], count).cast<double>();
    variance[e] = (f - f.mean()).square().mean();
  }
  return variance;
}

imaging::Image footprint(const PixelQuadrature& quadrature, int width, int height) {
  imaging::Image image(width, height);
  for (const PixelRow& row : quadrature.rows)
    for (int i = 0; i < row.count; ++i) image(row.column + i, row.row) = 255.0F;
  return image;
}

}  // namespace imic3d::correlation
