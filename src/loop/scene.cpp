// What the effects are told of the specimen's shape.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/effect.hpp"

namespace imic3d::loop {

namespace {

/// Circle through the nodes of the largest hole: centre and radius by least squares (Kasa).
bool find_hole(const mesh::Mesh& quads, Eigen::Vector2d& centre, double& radius) {
  const auto contours = mesh::contours(quads);
  const std::vector<int>* largest = nullptr;
  for (std::size_t k = 1; k < contours.size(); ++k)
    if (largest == nullptr || contours[k].size() > largest->size()) largest = &contours[k];
  if (largest == nullptr) return false;
  Eigen::MatrixXd A(largest->size(), 3);
  Eigen::VectorXd b(largest->size());
  for (std::size_t i = 0; i < largest->size(); ++i) {
    const Eigen::Vector2d X = quads.nodes.row((*largest)[i]).head<2>();
    A.row(static_cast<Eigen::Index>(i)) << 2.0 * X[0], 2.0 * X[1], 1.0;
    b[static_cast<Eigen::Index>(i)] = X.squaredNorm();
  }
  const Eigen::Vector3d c = least_squares(A, b);
  centre = c.head<2>();
  radius = std::sqrt(std::max(0.0, c[2] + centre.squaredNorm()));
  return radius > 0.0;
}

}  // namespace

void measure(Scene& scene, const mesh::Mesh& surface) {
  scene.low = surface.nodes.leftCols<2>().colwise().minCoeff();
  scene.high = surface.nodes.leftCols<2>().colwise().maxCoeff();
  scene.element =
      (surface.nodes.row(surface.cells(0, 0)) - surface.nodes.row(surface.cells(0, 2))).norm() / std::sqrt(2.0);
  scene.has_hole = find_hole(surface, scene.hole, scene.radius);
}

Places::Places(const Scene& scene) : low(scene.low) {
  double best = INFINITY;
  for (const int n : {1, 2, 3, 4, 6, 12}) {
    const double off = std::abs(std::log((scene.span(0) / n) / (scene.span(1) * n / 12.0)));
    if (off < best - 1e-6) best = off, columns = n, rows = 12 / n;  // of equals the first
  }
  size = {scene.span(0) / columns, scene.span(1) / rows};
}

int Places::of(const Eigen::Vector2d& point) const {
  const Eigen::Vector2d at = (point - low).cwiseQuotient(size);
  return std::clamp(static_cast<int>(std::floor(at[0])), 0, columns - 1) +
         columns * std::clamp(static_cast<int>(std::floor(at[1])), 0, rows - 1);
}

Eigen::Vector2d Places::middle(int place) const {
  return low + size.cwiseProduct(Eigen::Vector2d(place % columns + 0.5, place / columns + 0.5));
}

std::string in_group(const std::string& effect, const std::string& group) { return effect + " of " + group; }

std::string key_of(std::string name) {
  std::replace_if(
      name.begin(), name.end(), [](char c) { return c == ' ' || c == '-'; }, '_');
  return name;
}

}  // namespace imic3d::loop
