#pragma once
// Images of a size at will whose motion is known exactly: plane waves moved by an affine map, evaluated at the inverted
// map.

#include <Eigen/Core>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <memory>

#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::benchmarks {

/// x -> x + u(x) with u = shift + slope (x - centre) [px].
struct Motion {
  Eigen::Matrix2d slope = Eigen::Matrix2d::Zero();
  Eigen::Vector2d shift = Eigen::Vector2d::Zero(), centre = Eigen::Vector2d::Zero();
  [[nodiscard]] Eigen::Vector2d operator()(const Eigen::Vector2d& x) const { return shift + slope * (x - centre); }
};

/// 8 bits: twelve waves 6 to 14 px long in all directions, never the same within the image, rounded to grey levels.
inline imaging::Image waves(int width, int height, const Motion& motion = {}) {
  imaging::Image image(width, height);
  const Eigen::Matrix2d inverse = (Eigen::Matrix2d::Identity() + motion.slope).inverse();
  std::array<Eigen::Vector2d, 12> k;
  for (int w = 0; w < 12; ++w) {
    const double length = 6.0 + 8.0 * std::fmod(0.618034 * w, 1.0), angle = 2.399963 * w;
    k[static_cast<std::size_t>(w)] = 2.0 * M_PI / length * Eigen::Vector2d(std::cos(angle), std::sin(angle));
  }
#pragma omp parallel for schedule(static)
  for (int y = 0; y < height; ++y) {
    // x(X) is affine, so that along a row each wave turns by the same angle from pixel to pixel.
    const Eigen::Vector2d start = motion.centre + inverse * (Eigen::Vector2d(0, y) - motion.centre - motion.shift),
                          step = inverse.col(0);
    std::array<double, 12> c, s, dc, ds;
    for (std::size_t w = 0; w < 12; ++w)
      c[w] = std::cos(k[w].dot(start)), s[w] = std::sin(k[w].dot(start)), dc[w] = std::cos(k[w].dot(step)),
      ds[w] = std::sin(k[w].dot(step));
    for (int x = 0; x < width; ++x) {
      double sum = 0.0;
      for (std::size_t w = 0; w < 12; ++w) {
        sum += c[w];
        const double turned = c[w] * dc[w] - s[w] * ds[w];
        s[w] = s[w] * dc[w] + c[w] * ds[w], c[w] = turned;
      }
      image(x, y) = static_cast<float>(std::round(std::min(255.0, std::max(0.0, 127.5 + 28.0 * sum))));
    }
  }
  return image;
}

/// nx x ny quadrilaterals over an image but for `margin` pixels at its edges; one unit of length is one pixel.
inline mesh::Mesh sheet(int width, int height, int nx, int ny, double margin) {
  mesh::Mesh quads;
  quads.nodes.resize((nx + 1) * (ny + 1), 3);
  quads.cells.resize(nx * ny, 4);
  for (int j = 0; j <= ny; ++j)
    for (int i = 0; i <= nx; ++i)
      quads.nodes.row(j * (nx + 1) + i) << margin + (width - 1 - 2 * margin) * i / nx,
          margin + (height - 1 - 2 * margin) * j / ny, 0.0;
  for (int j = 0; j < ny; ++j)
    for (int i = 0; i < nx; ++i) {
      const int n = j * (nx + 1) + i;
      quads.cells.row(j * nx + i) << n, n + 1, n + nx + 2, n + nx + 1;
    }
  return quads;
}

inline std::shared_ptr<imaging::TelecentricCamera> one_to_one() {
  auto camera = std::make_shared<imaging::TelecentricCamera>();
  camera->linear << 1.0, 0.0, 0.0, 0.0, 1.0, 0.0;
  camera->offset << 0.0, 0.0;
  return camera;
}

inline Eigen::VectorXd nodal(const mesh::Mesh& quads, const Motion& motion) {
  Eigen::VectorXd U(quads.nodes.rows() * 2);
  for (Eigen::Index node = 0; node < quads.nodes.rows(); ++node)
    U.segment<2>(2 * node) = motion(quads.nodes.row(node).head<2>().transpose());
  return U;
}

}  // namespace imic3d::benchmarks
