#include "virtual_light.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace imic3d::app {

namespace {

using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// Between 0 and 1, of the square of side `side` that a point lies in; another one for each `kind`.
double of_flake(const Eigen::Vector2d& point, double side, std::uint64_t kind = 0) {
  std::uint64_t h = 0x9E3779B97F4A7C15U * (2 * kind + 1);
  for (int k = 0; k < 2; ++k) {
    h ^= static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(point[k] / side)));
    h = (h ^ (h >> 30U)) * 0xBF58476D1CE4E5B9U;
    h = (h ^ (h >> 27U)) * 0x94D049BB133111EBU;
    h ^= h >> 31U;
  }
  return static_cast<double>(h >> 11U) * 0x1.0p-53;
}

/// A random number for each point, linear between the corners of squares of side `side`; unit variance.
double wave(const Eigen::Vector2d& point, double side, std::uint64_t kind) {
  const Eigen::Vector2d corner = side * (point / side).array().floor(), at = (point - corner) / side;
  double sum = 0.0, square = 0.0;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector2d to(i % 2, i / 2);
    const double weight = (to - at).unaryExpr([](double x) { return 1.0 - std::abs(x); }).prod();
    sum += weight * std::sqrt(3.0) * (2.0 * of_flake(corner + side * (to.array() + 0.5).matrix(), side, kind) - 1.0),
        square += weight * weight;
  }
  return sum / std::sqrt(square);
}

/// Detail of unit variance that pixels do not resolve: waves of 0.65 per pixel along x and along y, each of an
/// amplitude and a phase that change over `side` [length]. `pixel`: where the point is in the reference.
double beyond_nyquist(const Eigen::Vector2d& point, const Eigen::Vector2d& pixel, double side) {
  double sum = 0.0;
  for (std::uint64_t axis = 0; axis < 2; ++axis) {
    const double phase = 2.0 * M_PI * 0.65 * pixel[static_cast<Eigen::Index>(axis)];
    sum += std::sqrt(0.5) *
           (wave(point, side, 1 + 2 * axis) * std::cos(phase) + wave(point, side, 2 + 2 * axis) * std::sin(phase));
  }
  return sum;
}

}  // namespace

VirtualLight::VirtualLight(const PlantedEffects& planted, std::string name,
                           std::shared_ptr<const imaging::Camera> camera, const mesh::Mesh& surface,
                           const imaging::Image& reference, std::shared_ptr<const imaging::Texture> other)
    : planted_(planted),
      name_(std::move(name)),
      camera_(std::move(camera)),
      surface_(surface),
      other_(std::move(other)),
      in_plane_(surface.nodes.leftCols<2>()) {
  const imaging::InverseMapping mapping(*camera_, in_plane_, Points(surface.nodes), surface.cells);
  imaging::InverseMapping::Location at;
  std::vector<float> levels;
  for (int y = 0; y < reference.height; ++y)
    for (int x = 0; x < reference.width; ++x)
      if (mapping.locate({x, y}, at))
        levels.push_back(reference(x, y)), mean_ += reference(x, y),
            variance_ += std::pow(static_cast<double>(reference(x, y)), 2);
  if (levels.empty()) return;
  mean_ /= static_cast<double>(levels.size());
  variance_ = variance_ / static_cast<double>(levels.size()) - mean_ * mean_;
  flake_ = 8.0 * std::sqrt((surface.nodes.col(0).maxCoeff() - surface.nodes.col(0).minCoeff()) *
                           (surface.nodes.col(1).maxCoeff() - surface.nodes.col(1).minCoeff()) /
                           static_cast<double>(levels.size()));
  const Eigen::Vector2d middle = surface.nodes.colwise().mean().head<2>().transpose();
  const double share = planted.light(name_, -1, middle, middle).saturated;
  if (share <= 0.0) return;
  if (share > 0.5) throw InputError("effects.saturation.saturated", fmt::format("{:.4g}", share), "a share up to 0.5");
  const auto place = levels.begin() + static_cast<std::ptrdiff_t>((1.0 - share) * static_cast<double>(levels.size()));
  std::nth_element(levels.begin(), place, levels.end());
  exposure_ = (static_cast<double>(reference.dynamic()) - 0.5) / static_cast<double>(*place);
}

double VirtualLight::operator()(int frame, const Points& moved, imaging::Image& image) const {
  const imaging::InverseMapping mapping(*camera_, in_plane_, moved, surface_.cells);
  const Eigen::Vector2d middle = surface_.nodes.colwise().mean().head<2>().transpose();
  const loop::Light beside = planted_.light(name_, frame, middle, middle);
  imaging::InverseMapping::Location at;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      float& grey = image(x, y);
      double level = grey;
      if (mapping.locate({x, y}, at)) {
        const Eigen::Vector4d N =
            0.25 * Eigen::Vector4d((1 - at.parent.x()) * (1 - at.parent.y()), (1 + at.parent.x()) * (1 - at.parent.y()),
                                   (1 + at.parent.x()) * (1 + at.parent.y()),
                                   (1 - at.parent.x()) * (1 + at.parent.y()));
        Eigen::Vector2d now = Eigen::Vector2d::Zero();
        for (int i = 0; i < 4; ++i) now += N[i] * moved.row(surface_.cells(at.quad, i)).head<2>().transpose();
        const Eigen::Vector2d point = mapping.reference(at);
        const loop::Light light = planted_.light(name_, frame, point, now);
        if (light.aliased > 0.0) {
          const Eigen::Vector2d pixel =
              camera_->project({point[0], point[1], surface_.nodes(surface_.cells(at.quad, 0), 2)});
          level += std::sqrt(light.aliased * variance_) * beyond_nyquist(point, pixel, 0.5 * flake_);
        }
        level = of_flake(point, flake_) < light.foreign
                    ? mean_ + light.beneath + light.contrast * (other_->grey({x, y}) - mean_)
                    : light.gain * level + light.offset;
      } else {
        level = beside.gain * level + beside.offset;
      }
      grey = static_cast<float>(exposure_ * level);
    }
  return beside.noise;
}

}  // namespace imic3d::app
