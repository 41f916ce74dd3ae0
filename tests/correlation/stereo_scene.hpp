#pragma once
// Images of perspective cameras whose motion is known exactly: an analytic texture on a surface that moves as a formula
// says. Each pixel's rays are met with the deformed surface; no image, mesh or correlation takes part in that.

#include <Eigen/Geometry>
#include <numbers>

#include "imic3d/imaging/pinhole.hpp"
#include "speckle.hpp"

namespace imic3d::correlation::test {

inline constexpr double scale = 15.0;  // [px/mm] about

/// Displacement of a point (x, y) of the plane z = 0 [mm].
using Displacement = std::function<Eigen::Vector3d(double x, double y)>;
inline const Displacement still = [](double, double) { return Eigen::Vector3d(0, 0, 0); };

inline Eigen::Vector3d on_surface(const Displacement& u, const Eigen::Vector2d& at) {
  return Eigen::Vector3d(at.x(), at.y(), 0.0) + u(at.x(), at.y());
}

/// A line of sight: a point and two directions across it.
struct Ray {
  Eigen::Vector3d from;
  Eigen::Matrix<double, 2, 3> across;
};

/// Reference position of the surface point on a ray: Newton with a differenced tangent.
inline Eigen::Vector2d met(const Ray& ray, const Displacement& u, Eigen::Vector2d guess) {
  constexpr double h = 1e-5;
  for (int iteration = 0; iteration < 50; ++iteration) {
    const Eigen::Vector2d miss = ray.across * (on_surface(u, guess) - ray.from);
    if (miss.norm() < 1e-11) break;
    Eigen::Matrix2d tangent;
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d step = h * Eigen::Vector2d::Unit(k);
      tangent.col(k) = ray.across * (on_surface(u, guess + step) - on_surface(u, guess - step)) / (2 * h);
    }
    guess -= tangent.inverse() * miss;
  }
  return guess;
}

using Sight = std::function<Ray(double column, double row)>;

inline Ray across(const Eigen::Vector3d& from, const Eigen::Vector3d& direction) {
  const Eigen::Vector3d first = direction.unitOrthogonal();
  Ray ray{from, {}};
  ray.across << first.transpose(), direction.cross(first).transpose();
  return ray;
}

inline Sight sight_of(const imaging::PinholeCamera& camera) {
  return [&camera](double column, double row) { return across(camera.centre(), camera.ray({column, row})); };
}

/// 16-bit range, 3 x 3 Gauss points a pixel; the texture is given on the plane, (0, 0) mm in its middle.
inline imaging::Image render(const Speckle& speckle, const Sight& sight, int width, int height,
                             const Displacement& u = still) {
  imaging::Image image(width, height, 16);
  const double points[3] = {-0.5 * std::sqrt(0.6), 0.0, 0.5 * std::sqrt(0.6)},
               weights[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  for (int y = 0; y < height; ++y) {
    Eigen::Vector2d guess(0.0, 0.0);
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector2d centre = guess = met(sight(x, y), u, guess);
      const Eigen::Vector2d right = met(sight(x + 0.5, y), u, centre) - centre,
                            down = met(sight(x, y + 0.5), u, centre) - centre;
      double sum = 0.0;
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i) {
          const Eigen::Vector2d at = centre + 2.0 * (points[i] * right + points[j] * down);
          sum += weights[i] * weights[j] * speckle.texture(scale * at + Eigen::Vector2d(120.0, 120.0));
        }
      image(x, y) = static_cast<float>(32768.0 + 28000.0 * sum);
    }
  }
  return image;
}

inline const Speckle& texture() {
  static const Speckle made(240, 240, 1.7, 3);
  return made;
}

/// A camera 100 mm away that looks at the origin from an angle [degree] about the vertical, y up in the image.
inline imaging::PinholeCamera looking_from(double angle, int width, int height, double shift = 0.0) {
  const imaging::Intrinsics lens{.fx = 1500.0,
                                 .fy = 1503.0,
                                 .cx = 0.5 * width + shift,
                                 .cy = 0.5 * height,
                                 .skew = 0.0,
                                 .distortion = {0.4, -3.0, 0.002, -0.001}};
  imaging::Pose pose;
  pose.rotation = Eigen::AngleAxisd(angle * std::numbers::pi / 180.0, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                  Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
  pose.translation = Eigen::Vector3d(0.1, -0.2, 100.0);
  return {lens, pose};
}

}  // namespace imic3d::correlation::test
