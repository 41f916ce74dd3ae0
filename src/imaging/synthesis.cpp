#include "imic3d/imaging/synthesis.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <random>
#include <set>
#include <utility>

namespace imic3d::imaging {

namespace {

using Eigen::Vector2d;

constexpr double beyond = 1e-9;  // a point this far out of a quad (parent coordinates) still belongs to it

/// Uniform in [0, 1), the same on every platform.
double uniform(std::mt19937_64& random) { return static_cast<double>(random() >> 11U) * 0x1.0p-53; }

/// Mixes numbers into a seed (the finaliser of SplitMix64).
std::uint64_t mixed(std::uint64_t value) {
  value += 0x9E3779B97F4A7C15ULL;
  value = (value ^ (value >> 30U)) * 0xBF58476D1CE4E5B9ULL;
  value = (value ^ (value >> 27U)) * 0x94D049BB133111EBULL;
  return value ^ (value >> 31U);
}

/// A sorted list of members for each bucket of a grid, from (bucket, member) pairs in ascending order of the members.
void fill_buckets(const std::vector<std::pair<int, int>>& pairs, std::size_t buckets, std::vector<int>& first,
                  std::vector<int>& members) {
  first.assign(buckets + 1, 0);
  for (const auto& [bucket, member] : pairs) ++first[static_cast<std::size_t>(bucket) + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  members.resize(pairs.size());
  std::vector<int> next(first.begin(), first.end() - 1);
  for (const auto& [bucket, member] : pairs)
    members[static_cast<std::size_t>(next[static_cast<std::size_t>(bucket)]++)] = member;
}

}  // namespace

// ---------------------------------------------------------------------------------------------------------------------

InverseMapping::InverseMapping(const PixelPoints& reference, const PixelPoints& deformed, const Quads& quads)
    : InverseMapping(reference, deformed, quads, 1e-6) {}

InverseMapping::InverseMapping(const PixelPoints& reference, const PixelPoints& deformed, const Quads& quads,
                               double margin) {
  if (reference.rows() != deformed.rows() || quads.cols() != 4 || quads.rows() == 0 || quads.minCoeff() < 0 ||
      quads.maxCoeff() >= reference.rows())
    throw InputError(
        "inverse mapping",
        fmt::format("{} and {} nodes, {} x {} quads", reference.rows(), deformed.rows(), quads.rows(), quads.cols()),
        "nodes of the same mesh and quadrilaterals between them");
  if (!deformed.allFinite() || !reference.allFinite())
    throw InputError("inverse mapping", "a node whose position is not a number", "finite positions");
  const auto count = static_cast<std::size_t>(quads.rows());
  const auto bilinear = [&](const PixelPoints& nodes, Eigen::Index q) {
    const auto at = [&](Eigen::Index k) -> Vector2d { return nodes.row(quads(q, k)).transpose(); };
    return Bilinear{0.25 * (at(0) + at(1) + at(2) + at(3)), 0.25 * (-at(0) + at(1) + at(2) - at(3)),
                    0.25 * (-at(0) - at(1) + at(2) + at(3)), 0.25 * (at(0) - at(1) + at(2) - at(3))};
  };
  double turn = 0.0;  // all quads must run the same way round
  for (std::size_t q = 0; q < count; ++q) {
    const auto row = static_cast<Eigen::Index>(q);
    reference_.push_back(bilinear(reference, row));
    deformed_.push_back(bilinear(deformed, row));
    for (Eigen::Index k = 0; k < 4; ++k) {
      const Vector2d at = deformed.row(quads(row, k)), next = deformed.row(quads(row, (k + 1) % 4));
      const Vector2d last = deformed.row(quads(row, (k + 3) % 4));
      const double area = (next - at).x() * (last - at).y() - (next - at).y() * (last - at).x();
      if (turn == 0.0) turn = area;
      if (!(area * turn > 0.0))
        throw InputError(fmt::format("quadrilateral {} at pixel ({:.1f}, {:.1f})", q, at.x(), at.y()),
                         "turned over or not convex after the displacement",
                         "a displacement that keeps every element convex");
    }
  }

  std::set<std::pair<int, int>> seen, twice;
  for (Eigen::Index q = 0; q < quads.rows(); ++q)
    for (Eigen::Index k = 0; k < 4; ++k) {
      const auto edge = std::minmax({quads(q, k), quads(q, (k + 1) % 4)});
      if (!seen.insert(edge).second) twice.insert(edge);
    }
  for (const auto& edge : seen)
    if (!twice.contains(edge)) boundary_.emplace_back(deformed.row(edge.first), deformed.row(edge.second));

  low_ = Vector2d(deformed.colwise().minCoeff()).array() - margin;
  const Vector2d extent = Vector2d(deformed.colwise().maxCoeff()).array() + margin - low_.array();
  bucket_ = std::max(std::sqrt(extent.prod() / static_cast<double>(count)), 1e-6 * extent.maxCoeff());
  columns_ = static_cast<int>(extent.x() / bucket_) + 1;
  rows_ = static_cast<int>(extent.y() / bucket_) + 1;
  std::vector<std::pair<int, int>> pairs;
  for (std::size_t q = 0; q < count; ++q) {
    Vector2d least = Vector2d::Constant(std::numeric_limits<double>::infinity()), most = -least;
    for (Eigen::Index k = 0; k < 4; ++k) {
      const Vector2d at = deformed.row(quads(static_cast<Eigen::Index>(q), k));
      least = least.cwiseMin(at);
      most = most.cwiseMax(at);
    }
    const auto bucket = [&](double place, int last) { return std::clamp(static_cast<int>(place / bucket_), 0, last); };
    for (int j = bucket(least.y() - low_.y() - margin, rows_ - 1); j <= bucket(most.y() - low_.y() + margin, rows_ - 1);
         ++j)
      for (int i = bucket(least.x() - low_.x() - margin, columns_ - 1);
           i <= bucket(most.x() - low_.x() + margin, columns_ - 1); ++i)
        pairs.emplace_back(j * columns_ + i, static_cast<int>(q));
  }
  fill_buckets(pairs, static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_), first_, members_);
}

namespace {

PixelPoints projections(const Camera& camera, const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>& points) {
  PixelPoints pixels(points.rows(), 2);
  for (Eigen::Index i = 0; i < points.rows(); ++i)
    pixels.row(i) = camera.project(points.row(i).transpose()).transpose();
  return pixels;
}

}  // namespace

InverseMapping::InverseMapping(const Camera& camera, const PixelPoints& reference,
                               const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>& deformed,
                               const Quads& quads)
    : InverseMapping(reference, projections(camera, deformed), quads, camera.affine() ? 1e-6 : 0.5) {
  if (camera.affine()) return;  // what is bilinear in space is bilinear in the image
  camera_ = &camera;
  Eigen::Matrix4d shapes;  // of the corners' values: constant, along xi, along eta, twist
  shapes << 1, -1, -1, 1, 1, 1, -1, -1, 1, 1, 1, 1, 1, -1, 1, -1;
  for (Eigen::Index q = 0; q < quads.rows(); ++q) {
    Eigen::Matrix<double, 3, 4> corners;
    for (int k = 0; k < 4; ++k) corners.col(k) = deformed.row(quads(q, k)).transpose();
    space_.emplace_back(0.25 * corners * shapes);
  }
}

bool InverseMapping::solve(int quad, const Vector2d& deformed, Vector2d& parent) const {
  const Bilinear& map = deformed_[static_cast<std::size_t>(quad)];
  for (int iteration = 0; iteration < 30; ++iteration) {
    Vector2d residual, a, b;
    if (camera_ != nullptr) {
      const auto& space = space_[static_cast<std::size_t>(quad)];
      const Eigen::Vector3d point = space * Eigen::Vector4d(1.0, parent.x(), parent.y(), parent.x() * parent.y());
      const Eigen::Matrix<double, 2, 3> J = camera_->jacobian(point);
      residual = deformed - camera_->project(point);
      a = J * (space.col(1) + space.col(3) * parent.y()), b = J * (space.col(2) + space.col(3) * parent.x());
    } else {
      residual = deformed - map(parent);
      a = map.xi + map.twist * parent.y(), b = map.eta + map.twist * parent.x();
    }
    const double determinant = a.x() * b.y() - a.y() * b.x();
    const Vector2d step((b.y() * residual.x() - b.x() * residual.y()) / determinant,
                        (a.x() * residual.y() - a.y() * residual.x()) / determinant);
    parent += step;
    if (!(parent.cwiseAbs().maxCoeff() < 50.0)) return false;  // far away, or a NaN
    if (step.cwiseAbs().maxCoeff() < 1e-7)                     // the next step would be its square
      return parent.cwiseAbs().maxCoeff() <= 1.0 + beyond;
  }
  return false;  // far outside, the equation may have no real solution
}

bool InverseMapping::locate(const Vector2d& deformed, Location& at) const {
  if (at.quad >= 0 && solve(at.quad, deformed, at.parent)) return true;
  const Vector2d place = (deformed - low_) / bucket_;
  if (!(place.x() >= -1e-3 && place.y() >= -1e-3 && place.x() <= columns_ + 1e-3 && place.y() <= rows_ + 1e-3)) {
    at.quad = -1;
    return false;
  }
  const int column = std::clamp(static_cast<int>(place.x()), 0, columns_ - 1),
            row = std::clamp(static_cast<int>(place.y()), 0, rows_ - 1);
  const auto bucket =
      static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
  for (int m = first_[bucket]; m < first_[bucket + 1]; ++m) {
    at.quad = members_[static_cast<std::size_t>(m)];
    at.parent.setZero();
    if (solve(at.quad, deformed, at.parent)) return true;
  }
  at.quad = -1;
  return false;
}

Vector2d InverseMapping::reference(const Location& at) const {
  return reference_[static_cast<std::size_t>(at.quad)](at.parent);
}

// ---------------------------------------------------------------------------------------------------------------------

Speckle::Speckle(const Vector2d& low, const Vector2d& high, const SpeckleOptions& options) : options_(options) {
  if (!(options.diameter > 0.5))
    throw InputError("speckle diameter", fmt::format("{}", options.diameter), "more than 0.5 px");
  if (!(options.coverage > 0.0 && options.coverage < 0.99))
    throw InputError("speckle coverage", fmt::format("{}", options.coverage), "more than 0, less than 0.99");
  if (!(options.edge >= 0.0)) throw InputError("speckle edge", fmt::format("{}", options.edge), "0 px or more");
  constexpr double spread = 0.3;
  const double largest = 0.5 * options.diameter * (1.0 + spread) + 0.5 * options.edge;
  low_ = low.array() - largest;
  const Vector2d extent = high.array() + largest - low_.array();
  // Disks placed independently leave the part exp(-number x mean area / total area) uncovered.
  const double radius = 0.5 * options.diameter,
               mean_area = std::numbers::pi * radius * radius * (1.0 + spread * spread / 3.0);
  const auto number = std::lround(-std::log(1.0 - options.coverage) * extent.prod() / mean_area);
  if (number > 50'000'000)
    throw InputError("speckle", fmt::format("{} disks", number), "a smaller area or larger disks");

  bucket_ = std::max(options.diameter, 1.0);
  columns_ = static_cast<int>(extent.x() / bucket_) + 1;
  rows_ = static_cast<int>(extent.y() / bucket_) + 1;
  std::mt19937_64 random(mixed(options.seed));
  std::vector<Disk> disks;
  std::vector<std::pair<int, int>> pairs;
  for (long n = 0; n < number; ++n) {
    const double x = extent.x() * uniform(random), y = extent.y() * uniform(random);
    const double r = radius * (1.0 + spread * (2.0 * uniform(random) - 1.0));
    const double outer = r + 0.5 * options.edge;
    disks.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(r - 0.5 * options.edge),
                     static_cast<float>(outer)});
    const auto bucket = [&](double place, int last) { return std::clamp(static_cast<int>(place / bucket_), 0, last); };
    for (int j = bucket(y - outer, rows_ - 1); j <= bucket(y + outer, rows_ - 1); ++j)
      for (int i = bucket(x - outer, columns_ - 1); i <= bucket(x + outer, columns_ - 1); ++i)
        pairs.emplace_back(j * columns_ + i, static_cast<int>(n));
  }
  std::vector<int> members;
  fill_buckets(pairs, static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_), first_, members);
  disks_.reserve(members.size());
  for (int member : members) disks_.push_back(disks[static_cast<std::size_t>(member)]);
}

double Speckle::grey(const Vector2d& position) const {
  const auto x = static_cast<float>(position.x() - low_.x()), y = static_cast<float>(position.y() - low_.y());
  const int column = static_cast<int>(std::floor(x / bucket_)), row = static_cast<int>(std::floor(y / bucket_));
  if (column < 0 || row < 0 || column >= columns_ || row >= rows_) return options_.paint;
  const auto bucket =
      static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
  float bare = 1.0F;  // the part that shines through all disks
  for (int d = first_[bucket]; d < first_[bucket + 1]; ++d) {
    const Disk& disk = disks_[static_cast<std::size_t>(d)];
    const float dx = x - disk.x, dy = y - disk.y, squared = dx * dx + dy * dy;
    if (squared >= disk.outer * disk.outer) continue;
    const float distance = std::sqrt(squared);
    if (distance <= disk.inner) return options_.disk;
    const float t = (distance - disk.inner) / (disk.outer - disk.inner);
    bare *= t * t * t * (10.0F + t * (6.0F * t - 15.0F));  // twice continuously differentiable
  }
  return options_.disk + (options_.paint - options_.disk) * static_cast<double>(bare);
}

// ---------------------------------------------------------------------------------------------------------------------

namespace {

/// The pixels that the specimen's edges may cross.
std::vector<char> edge_pixels(const InverseMapping& mapping, int width, int height) {
  std::vector<char> crossed(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 0);
  for (const auto& [from, to] : mapping.boundary()) {
    const double length = (to - from).norm();
    const int pieces = std::max(1, static_cast<int>(std::ceil(2.0 * length)));
    for (int k = 0; k <= pieces; ++k) {  // a point every half pixel, and the pixels around it
      const Vector2d at = from + (to - from) * (static_cast<double>(k) / pieces);
      if (!(at.x() > -2.0 && at.y() > -2.0 && at.x() < width + 1.0 && at.y() < height + 1.0)) continue;
      const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
      for (int j = std::max(0, y - 1); j <= std::min(height - 1, y + 1); ++j)
        for (int i = std::max(0, x - 1); i <= std::min(width - 1, x + 1); ++i)
          crossed[static_cast<std::size_t>(j) * static_cast<std::size_t>(width) + static_cast<std::size_t>(i)] = 1;
    }
  }
  return crossed;
}

/// Places within a pixel in one direction, from -1/2 to 1/2, and their weights.
struct PixelRule {
  std::vector<double> places, weights;
};

PixelRule even_rule(int n) {
  PixelRule rule;
  for (int k = 0; k < n; ++k) {
    rule.places.push_back((k + 0.5) / n - 0.5);
    rule.weights.push_back(1.0 / n);
  }
  return rule;
}

/// Gauss-Legendre points: the roots of the Legendre polynomial of degree n by Newton's method.
PixelRule gauss_rule(int n) {
  PixelRule rule;
  for (int k = 0; k < n; ++k) {
    double x = -std::cos(std::numbers::pi * (k + 0.75) / (n + 0.5)), slope = 1.0;
    for (int iteration = 0; iteration < 100; ++iteration) {
      double last = 1.0, value = x;
      for (int d = 2; d <= n; ++d) last = std::exchange(value, ((2 * d - 1) * x * value - (d - 1) * last) / d);
      slope = n * (x * value - last) / (x * x - 1.0);
      const double step = value / slope;
      x -= step;
      if (std::abs(step) < 1e-15) break;
    }
    rule.places.push_back(0.5 * x);
    rule.weights.push_back(1.0 / ((1.0 - x * x) * slope * slope));
  }
  return rule;
}

void check_options(const SynthesisOptions& options) {
  if (options.width < 1 || options.height < 1)
    throw InputError("virtual image", fmt::format("{} x {} px", options.width, options.height), "1 x 1 px or more");
  if (options.depth != 8 && options.depth != 16)
    throw InputError("virtual image", fmt::format("{} bits per pixel", options.depth), "8 or 16");
  if (options.supersampling < 1 || options.supersampling > 64)
    throw InputError("virtual image", fmt::format("supersampling {}", options.supersampling), "1 to 64");
  if (!(options.noise >= 0.0 && options.noise < 1.0))
    throw InputError("virtual image", fmt::format("noise {}", options.noise), "0 to 1, of the dynamic");
}

}  // namespace

Image render(const InverseMapping& mapping, const Texture& specimen, const Texture& background,
             const SynthesisOptions& options) {
  check_options(options);
  Image image(options.width, options.height, options.depth);
  const std::vector<char> crossed = edge_pixels(mapping, options.width, options.height);
  const PixelRule inner = gauss_rule(options.supersampling), edges = even_rule(std::max(8, options.supersampling));
  const auto mean = [](const PixelRule& rule, const auto& grey) {
    double sum = 0.0;
    for (std::size_t j = 0; j < rule.places.size(); ++j)
      for (std::size_t i = 0; i < rule.places.size(); ++i)
        sum += rule.weights[j] * rule.weights[i] * grey(Vector2d(rule.places[i], rule.places[j]));
    return sum;
  };

#pragma omp parallel for schedule(dynamic, 8)
  for (int row = 0; row < options.height; ++row) {
    InverseMapping::Location at;
    for (int column = 0; column < options.width; ++column) {
      const Vector2d centre(column, row);
      const auto behind = [&](const Vector2d& shift) { return background.grey(centre + shift); };
      const auto seen = [&](const Vector2d& shift) {
        return mapping.locate(centre + shift, at) ? specimen.grey(mapping.reference(at)) : behind(shift);
      };
      const bool edge = crossed[static_cast<std::size_t>(row) * static_cast<std::size_t>(options.width) +
                                static_cast<std::size_t>(column)] != 0;
      double grey = 0.0;
      if (edge)
        grey = mean(edges, seen);
      else if (!mapping.locate(centre, at))
        grey = background.integrate() ? mean(inner, behind) : behind(Vector2d::Zero());
      else
        grey = specimen.integrate() ? mean(inner, seen) : specimen.grey(mapping.reference(at));
      image(column, row) = static_cast<float>(grey);
    }
  }
  return image;
}

Image record(const Image& clean, int frame, const SynthesisOptions& options) {
  check_options(options);
  Image image = clean;
  image.depth = options.depth;
  image.path.clear();
  const double dynamic = image.dynamic(), deviation = options.noise * dynamic;
  const std::uint64_t of_frame = mixed(mixed(options.seed) + static_cast<std::uint64_t>(frame));
#pragma omp parallel for schedule(static)
  for (int row = 0; row < image.height; ++row) {
    std::mt19937_64 random(mixed(of_frame + static_cast<std::uint64_t>(row)));
    for (int column = 0; column < image.width; column += 2) {
      // Two normal numbers from two uniform ones (Box and Muller).
      const double length = deviation * std::sqrt(-2.0 * std::log(1.0 - uniform(random)));
      const double angle = 2.0 * std::numbers::pi * uniform(random);
      const std::array<double, 2> noise{length * std::cos(angle), length * std::sin(angle)};
      for (int k = 0; k < 2 && column + k < image.width; ++k) {
        float& grey = image(column + k, row);
        grey = static_cast<float>(
            std::clamp(std::round(static_cast<double>(grey) + noise[static_cast<std::size_t>(k)]), 0.0, dynamic));
      }
    }
  }
  return image;
}

Image without(const Image& image, const InverseMapping& specimen, int margin) {
  cv::Mat covered(image.height, image.width, CV_8U, cv::Scalar(0)), near, distance, nearest;
  InverseMapping::Location at;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      if (specimen.locate({x, y}, at)) covered.at<std::uint8_t>(y, x) = 255;
  cv::dilate(covered, near, cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * margin + 1, 2 * margin + 1}));
  if (cv::countNonZero(near) == image.width * image.height) return image;
  cv::distanceTransform(near, distance, nearest, cv::DIST_L2, cv::DIST_MASK_5, cv::DIST_LABEL_PIXEL);
  std::vector<float> grey(static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height) + 1);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      if (near.at<std::uint8_t>(y, x) == 0) grey[static_cast<std::size_t>(nearest.at<int>(y, x))] = image(x, y);
  Image result = image;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      if (covered.at<std::uint8_t>(y, x) != 0) result(x, y) = grey[static_cast<std::size_t>(nearest.at<int>(y, x))];
  return result;
}

Speckle dark_background(const SynthesisOptions& options) {
  const double dynamic = options.depth == 16 ? 65535.0 : 255.0;
  return Speckle(Vector2d(-1, -1), Vector2d(options.width, options.height),
                 {.diameter = 12.0,
                  .coverage = 0.5,
                  .edge = 6.0,
                  .paint = 0.07 * dynamic,
                  .disk = 0.1 * dynamic,
                  .seed = options.seed + 1});
}

}  // namespace imic3d::imaging
