#include "imic3d/imaging/target.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "imic3d/core/linear.hpp"
#include "imic3d/core/median.hpp"

namespace imic3d::imaging {

std::vector<Eigen::Vector3d> Target::points() const {
  std::vector<Eigen::Vector3d> found;
  const bool staggered = type == TargetType::asymmetric_circles;
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) found.emplace_back(spacing * (staggered ? 2 * j + i % 2 : j), spacing * i, 0.0);
  return found;
}

std::vector<std::vector<int>> Target::orders() const {
  const auto all = points();
  Eigen::Vector3d lower = all.front(), upper = all.front();
  for (const auto& point : all) lower = lower.cwiseMin(point), upper = upper.cwiseMax(point);
  const Eigen::Vector3d centre = 0.5 * (lower + upper);
  std::vector<std::vector<int>> orders;
  for (int quarter = 0; quarter < 4; ++quarter) {
    const int cosine[] = {1, 0, -1, 0}, sine[] = {0, 1, 0, -1};
    std::vector<int> order;
    for (const auto& point : all) {
      const Eigen::Vector3d at = point - centre;
      const Eigen::Vector3d turned(cosine[quarter] * at[0] - sine[quarter] * at[1],
                                   sine[quarter] * at[0] + cosine[quarter] * at[1], 0.0);
      const auto same = std::find_if(
          all.begin(), all.end(), [&](const auto& other) { return (other - centre - turned).norm() < 1e-6 * spacing; });
      if (same == all.end()) break;
      order.push_back(static_cast<int>(same - all.begin()));
    }
    if (order.size() == all.size()) orders.push_back(order);
  }
  return orders;
}

namespace {

/// As 8 bits: images of 16 bits are stretched over their range.
cv::Mat as_bytes(const Image& image) {
  const cv::Mat grey(image.height, image.width, CV_32F, const_cast<float*>(image.grey.data()));
  cv::Mat bytes;
  if (image.depth == 8)
    grey.convertTo(bytes, CV_8U);
  else
    cv::normalize(grey, bytes, 0, 255, cv::NORM_MINMAX, CV_8U);
  return bytes;
}

std::vector<cv::Point2f> chessboard(const Target& target, const cv::Mat& bytes) {
  std::vector<cv::Point2f> corners;
  for (const int flags : {int{cv::CALIB_CB_ACCURACY}, cv::CALIB_CB_ACCURACY | cv::CALIB_CB_EXHAUSTIVE})
    if (cv::findChessboardCornersSB(bytes, {target.columns, target.rows}, corners, flags)) return corners;
  return {};
}

std::vector<cv::Point2f> circles(const Target& target, const cv::Mat& bytes) {
  cv::SimpleBlobDetector::Params blobs;
  blobs.minArea = 12.0F;
  blobs.maxArea = static_cast<float>(bytes.total()) / static_cast<float>(target.rows * target.columns);
  blobs.minDistBetweenBlobs = 4.0F;
  blobs.minConvexity = 0.8F;
  const int kind = target.type == TargetType::circles ? cv::CALIB_CB_SYMMETRIC_GRID : cv::CALIB_CB_ASYMMETRIC_GRID;
  std::vector<cv::Point2f> centres;
  for (const bool bright : {false, true}) {
    blobs.blobColor = bright ? 255 : 0;
    for (const int how : {0, static_cast<int>(cv::CALIB_CB_CLUSTERING)})
      if (cv::findCirclesGrid(bytes, {target.columns, target.rows}, centres, kind | how,
                              cv::SimpleBlobDetector::create(blobs)))
        return centres;
  }
  return {};
}

/// Centroid of a blob, weighted by how far the grey level has gone from the surrounding's to the blob's (nothing below
/// a quarter of the way, all above three quarters, so that noise on either side has no weight). reach: half the
/// distance to the next blob [px].
Eigen::Vector2d centroid(const Image& image, Eigen::Vector2d centre, double reach) {
  for (int pass = 0; pass < 3; ++pass) {
    std::vector<float> inside, around;
    const auto for_all = [&](auto action) {
      for (int y = std::max(0, static_cast<int>(std::floor(centre[1] - reach)));
           y <= std::min(image.height - 1, static_cast<int>(std::ceil(centre[1] + reach))); ++y)
        for (int x = std::max(0, static_cast<int>(std::floor(centre[0] - reach)));
             x <= std::min(image.width - 1, static_cast<int>(std::ceil(centre[0] + reach))); ++x)
          if (const double r = std::hypot(x - centre[0], y - centre[1]); r <= reach) action(x, y, r);
    };
    for_all([&](int x, int y, double r) {
      if (r < std::max(1.0, 0.2 * reach)) inside.push_back(image(x, y));
      if (r > 0.85 * reach) around.push_back(image(x, y));
    });
    if (inside.empty() || around.empty()) return centre;
    const double blob = static_cast<double>(median(inside)), surrounding = static_cast<double>(median(around));
    if (blob == surrounding) return centre;
    double weights = 0.0;
    Eigen::Vector2d sum(0.0, 0.0);
    for_all([&](int x, int y, double) {
      const double way = (image(x, y) - surrounding) / (blob - surrounding),
                   weight = std::clamp(2.0 * way - 0.5, 0.0, 1.0);
      weights += weight, sum += weight * Eigen::Vector2d(x, y);
    });
    centre = sum / weights;
  }
  return centre;
}

/// The crossing of two edges, fitted to the grey levels about it by Gauss-Newton:
///   level(x) = m + g . (x - c) + h erf(d1(x)/w) erf(d2(x)/w), d1 and d2 the distances from two lines through the
///   corner c.
/// The model and a corner are the same upside down, so that blur, noise and the camera's response do not move c. along,
/// down: ways to the next corners [px]; the window ends before their edges.
struct Crossing {
  Eigen::Vector2d corner;
  double contrast;  ///< h / m; 0: no crossing could be fitted
};

Crossing crossing(const Image& image, const Eigen::Vector2d& start, const Eigen::Vector2d& along,
                  const Eigen::Vector2d& down) {
  constexpr double window = 0.42;   // of the way to the next corner
  constexpr double sharpest = 0.4;  // [px], about what the pixel's own width makes of a sharp edge: sqrt(2/12)
  using Vector9 = Eigen::Vector<double, 9>;
  const Eigen::Matrix2d to_grid = (Eigen::Matrix2d() << along, down).finished().inverse();
  std::vector<Eigen::Vector2d> pixels;
  std::vector<double> levels;
  const double reach = window * (along.cwiseAbs() + down.cwiseAbs()).maxCoeff();
  double mean = 0.0, sign = 0.0;
  for (int y = std::max(0, static_cast<int>(start[1] - reach));
       y <= std::min(image.height - 1, static_cast<int>(start[1] + reach) + 1); ++y)
    for (int x = std::max(0, static_cast<int>(start[0] - reach));
         x <= std::min(image.width - 1, static_cast<int>(start[0] + reach) + 1); ++x) {
      const Eigen::Vector2d pixel(x, y), at = to_grid * (pixel - start);
      if (at.cwiseAbs().maxCoeff() > window) continue;
      pixels.push_back(pixel), levels.push_back(image(x, y));
      mean += image(x, y);
    }
  if (pixels.size() < 16) return {start, 0.0};
  mean /= static_cast<double>(pixels.size());
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const Eigen::Vector2d at = to_grid * (pixels[i] - start);
    sign += (at[0] * at[1] > 0.0 ? 1.0 : -1.0) * (levels[i] - mean) / static_cast<double>(pixels.size());
  }
  // cx cy, directions of the two edges, m, gx gy, h, w
  Vector9 p;
  p << start, std::atan2(along[1], along[0]), std::atan2(down[1], down[0]), mean, 0.0, 0.0, -sign, 1.0;
  for (int iteration = 0; iteration < 50; ++iteration) {
    Eigen::Matrix<double, 9, 9> H = Eigen::Matrix<double, 9, 9>::Zero();
    Vector9 g = Vector9::Zero();
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const Eigen::Vector2d way = pixels[i] - p.head<2>();
      const double w = p[8], s1 = std::sin(p[2]), c1 = std::cos(p[2]), s2 = std::sin(p[3]), c2 = std::cos(p[3]);
      const double d1 = c1 * way[1] - s1 * way[0], d2 = c2 * way[1] - s2 * way[0];
      const double e1 = std::erf(d1 / w), e2 = std::erf(d2 / w);
      const double slope = 2.0 / std::sqrt(std::numbers::pi);
      const double f1 = p[7] * e2 * slope * std::exp(-d1 * d1 / (w * w)) / w,
                   f2 = p[7] * e1 * slope * std::exp(-d2 * d2 / (w * w)) / w;
      Vector9 J;
      J << f1 * s1 + f2 * s2 - p[5], -f1 * c1 - f2 * c2 - p[6], f1 * (-s1 * way[1] - c1 * way[0]),
          f2 * (-s2 * way[1] - c2 * way[0]), 1.0, way, e1 * e2, -(f1 * d1 + f2 * d2) / w;
      const double r = levels[i] - (p[4] + p[5] * way[0] + p[6] * way[1] + p[7] * e1 * e2);
      H += J * J.transpose(), g += J * r;
    }
    H.diagonal() *= 1.0 + 1e-6;
    const Vector9 step = solve_symmetric(H, g);
    if (!step.allFinite()) return {start, 0.0};
    p += step.cwiseMax(-1.0 * Vector9(1, 1, 0.2, 0.2, 1e9, 1e9, 1e9, 1e9, 0.5))
             .cwiseMin(Vector9(1, 1, 0.2, 0.2, 1e9, 1e9, 1e9, 1e9, 0.5));
    p[8] = std::clamp(p[8], sharpest, reach);
    if ((p.head<2>() - start).norm() > 0.5 * window * std::min(along.norm(), down.norm())) return {start, 0.0};
    if (step.head<2>().norm() < 1e-4) return {p.head<2>(), p[7] / p[4]};
  }
  return {start, 0.0};
}

/// All corners of a chessboard refined (the ways to the neighbours from the corners as found). Empty if that is no
/// chessboard: from corner to corner the contrast must change its sign, and nowhere be below 0.6 of the median; at the
/// rim, where a board of another size may be taken for this one, it is less.
std::vector<Eigen::Vector2d> refined(const Target& target, const Image& image,
                                     const std::vector<Eigen::Vector2d>& corners) {
  std::vector<Eigen::Vector2d> all;
  std::vector<double> contrasts;
  const auto at = [&](int row, int column) { return corners[static_cast<std::size_t>(row * target.columns + column)]; };
  for (int i = 0; i < target.rows; ++i)
    for (int j = 0; j < target.columns; ++j) {
      const int before = std::max(j - 1, 0), after = std::min(j + 1, target.columns - 1), above = std::max(i - 1, 0),
                below = std::min(i + 1, target.rows - 1);
      const auto found = crossing(image, at(i, j), (at(i, after) - at(i, before)) / (after - before),
                                  (at(below, j) - at(above, j)) / (below - above));
      all.push_back(found.corner);
      contrasts.push_back((i + j) % 2 == 0 ? found.contrast : -found.contrast);
    }
  std::vector<double> sorted = contrasts;
  std::sort(sorted.begin(), sorted.end());
  const double median = sorted[sorted.size() / 2];
  const bool alike =
      std::all_of(contrasts.begin(), contrasts.end(), [&](double contrast) { return contrast / median > 0.6; });
  return alike ? all : std::vector<Eigen::Vector2d>{};
}

}  // namespace

std::vector<Eigen::Vector2d> find_target(const Target& target, const Image& image) {
  const cv::Mat bytes = as_bytes(image);
  const auto points = target.type == TargetType::chessboard ? chessboard(target, bytes) : circles(target, bytes);
  if (points.size() != static_cast<std::size_t>(target.rows * target.columns)) return {};
  std::vector<Eigen::Vector2d> pixels;
  for (const auto& point : points) pixels.emplace_back(point.x, point.y);
  const std::size_t columns = static_cast<std::size_t>(target.columns);
  const Eigen::Vector2d along = pixels[columns - 1] - pixels[0], down = pixels[pixels.size() - columns] - pixels[0];
  if (along[0] * down[1] - along[1] * down[0] < 0.0) {  // a mirrored numbering: every row the other way round
    if (target.type == TargetType::asymmetric_circles) return {};
    for (auto row = pixels.begin(); row != pixels.end(); row += target.columns) std::reverse(row, row + target.columns);
  }
  if (target.type == TargetType::chessboard) return refined(target, image, pixels);
  std::vector<Eigen::Vector2d> centres;
  for (std::size_t k = 0; k < pixels.size(); ++k) {
    double nearest = 1e9;
    for (std::size_t other = 0; other < pixels.size(); ++other)
      if (other != k) nearest = std::min(nearest, (pixels[other] - pixels[k]).norm());
    centres.push_back(centroid(image, pixels[k], 0.5 * nearest));
  }
  return centres;
}

}  // namespace imic3d::imaging
