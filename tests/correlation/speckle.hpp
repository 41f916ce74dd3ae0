#pragma once
// Generated images whose motion is known exactly: an analytic texture is evaluated at the inverted mapping and
// integrated over every pixel; no image is interpolated.

#include <Eigen/Core>
#include <Eigen/LU>
#include <cmath>
#include <functional>
#include <memory>
#include <random>
#include <vector>

#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation::test {

/// A sum of Gaussian blobs in reference pixel coordinates, squashed to stay between black and white.
class Speckle {
 public:
  Speckle(int width, int height, double radius = 1.7, unsigned seed = 1)
      : reach_(4.5 * radius), inverse_(0.5 / (radius * radius)), columns_(static_cast<int>((width + 80) / reach_) + 1) {
    const int rows = static_cast<int>((height + 80) / reach_) + 1;
    cells_.resize(static_cast<std::size_t>(columns_ * rows));
    std::mt19937 generator(seed);
    std::uniform_real_distribution<double> x(-40.0, width + 40.0), y(-40.0, height + 40.0), sign(-1.0, 1.0);
    const int blobs = static_cast<int>((width + 80) * (height + 80) / (3.2 * radius * radius));
    for (int k = 0; k < blobs; ++k) {
      const Eigen::Vector3d blob(x(generator), y(generator), sign(generator) > 0.0 ? 1.0 : -1.0);
      cells_[cell(blob.x(), blob.y())].push_back(blob);
    }
  }

  /// Between -1 and 1.
  [[nodiscard]] double texture(const Eigen::Vector2d& at) const {
    const int column = static_cast<int>((at.x() + 40.0) / reach_), row = static_cast<int>((at.y() + 40.0) / reach_);
    double sum = 0.0;
    for (int j = row - 1; j <= row + 1; ++j)
      for (int i = column - 1; i <= column + 1; ++i) {
        const int k = j * columns_ + i;
        if (i < 0 || i >= columns_ || k < 0 || k >= static_cast<int>(cells_.size())) continue;
        for (const Eigen::Vector3d& blob : cells_[static_cast<std::size_t>(k)]) {
          const double r2 = (blob.head<2>() - at).squaredNorm();
          if (r2 < reach_ * reach_) sum += blob.z() * std::exp(-r2 * inverse_);
        }
      }
    return sum / std::sqrt(1.0 + sum * sum);
  }

 private:
  [[nodiscard]] std::size_t cell(double x, double y) const {
    return static_cast<std::size_t>(static_cast<int>((y + 40.0) / reach_) * columns_ +
                                    static_cast<int>((x + 40.0) / reach_));
  }
  double reach_, inverse_;
  int columns_;
  std::vector<std::vector<Eigen::Vector3d>> cells_;
};

/// Displacement in the image of a reference position [px].
using Motion = std::function<Eigen::Vector2d(const Eigen::Vector2d&)>;

inline const Motion at_rest = [](const Eigen::Vector2d&) { return Eigen::Vector2d(0.0, 0.0); };

/// Reference position of the point that is now at `place`: Newton with a differenced tangent, from `guess`.
inline Eigen::Vector2d inverted(const Motion& motion, const Eigen::Vector2d& place, Eigen::Vector2d guess) {
  constexpr double h = 1e-4;
  for (int iteration = 0; iteration < 50; ++iteration) {
    const Eigen::Vector2d miss = place - guess - motion(guess);
    if (miss.norm() < 1e-9) break;
    Eigen::Matrix2d tangent;
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d step = h * Eigen::Vector2d::Unit(k);
      tangent.col(k) = Eigen::Vector2d::Unit(k) + (motion(guess + step) - motion(guess - step)) / (2 * h);
    }
    guess += tangent.inverse() * miss;
  }
  return guess;
}

/// Image (16 bit range) of the moved texture, 3 x 3 Gauss points a pixel.
inline imaging::Image photograph(const Speckle& speckle, int width, int height, const Motion& motion = at_rest) {
  imaging::Image image(width, height, 16);
  const double points[3] = {-0.5 * std::sqrt(0.6), 0.0, 0.5 * std::sqrt(0.6)},
               weights[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  for (int y = 0; y < height; ++y) {
    Eigen::Vector2d guess(-motion(Eigen::Vector2d(0, y)).x(), y);
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector2d centre = guess = inverted(motion, Eigen::Vector2d(x, y), guess);
      // The mapping is affine over a pixel to far below what matters.
      const Eigen::Vector2d right = inverted(motion, Eigen::Vector2d(x + 0.5, y), centre) - centre,
                            down = inverted(motion, Eigen::Vector2d(x, y + 0.5), centre) - centre;
      double sum = 0.0;
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i)
          sum += weights[i] * weights[j] * speckle.texture(centre + 2.0 * (points[i] * right + points[j] * down));
      image(x, y) = static_cast<float>(32768.0 + 28000.0 * sum);
      guess += 2.0 * right;
    }
  }
  return image;
}

/// A rectangle of nx x ny quadrilaterals from (x0, y0) to (x1, y1); nodes row by row.
inline mesh::Mesh rectangle(double x0, double y0, double x1, double y1, int nx, int ny) {
  mesh::Mesh quads;
  quads.nodes.resize((nx + 1) * (ny + 1), 3);
  quads.cells.resize(nx * ny, 4);
  for (int j = 0; j <= ny; ++j)
    for (int i = 0; i <= nx; ++i)
      quads.nodes.row(j * (nx + 1) + i) << x0 + (x1 - x0) * i / nx, y0 + (y1 - y0) * j / ny, 0.0;
  for (int j = 0; j < ny; ++j)
    for (int i = 0; i < nx; ++i) {
      const int n = j * (nx + 1) + i;
      quads.cells.row(j * nx + i) << n, n + 1, n + nx + 2, n + nx + 1;
    }
  return quads;
}

/// Telecentric camera with the image's axes along the specimen's x and, downwards or upwards, y.
inline std::shared_ptr<imaging::TelecentricCamera> camera(double pixels_per_length = 1.0, double column = 0.0,
                                                          double row = 0.0, bool y_up = false, double angle = 0.0) {
  auto camera = std::make_shared<imaging::TelecentricCamera>();
  const double c = pixels_per_length * std::cos(angle), s = pixels_per_length * std::sin(angle), up = y_up ? -1.0 : 1.0;
  camera->linear << c, -s, 0.0, up * s, up * c, 0.0;
  camera->offset << column, row;
  return camera;
}

/// U [nodes * 2] of a motion given in pixels, for a telecentric camera.
inline Eigen::VectorXd nodal(const mesh::Mesh& quads, const imaging::TelecentricCamera& camera, const Motion& motion) {
  Eigen::VectorXd U(quads.nodes.rows() * 2);
  const Eigen::Matrix2d inverse = camera.linear.leftCols<2>().inverse();
  for (Eigen::Index node = 0; node < quads.nodes.rows(); ++node)
    U.segment<2>(2 * node) = inverse * motion(camera.project(quads.nodes.row(node).transpose()));
  return U;
}

inline void add_noise(imaging::Image& image, double sigma, std::mt19937& generator) {
  std::normal_distribution<float> noise(0.0F, static_cast<float>(sigma));
  for (float& g : image.grey) g += noise(generator);
}

}  // namespace imic3d::correlation::test
