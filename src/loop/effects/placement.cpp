// The mesh does not lie on the image where the specimen does.
#include <Eigen/LU>
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

/// Gradient of a field [components * n] at the nodes, the mean of the cells about each: du/dX, a row for each
/// component.
std::vector<Eigen::Matrix<double, Eigen::Dynamic, 2>> gradients(const mesh::Mesh& surface, const Eigen::VectorXd& U) {
  const Eigen::Index nodes = surface.nodes.rows(), c = U.size() / nodes;
  std::vector<Eigen::Matrix<double, Eigen::Dynamic, 2>> sum(static_cast<std::size_t>(nodes),
                                                            Eigen::Matrix<double, Eigen::Dynamic, 2>::Zero(c, 2));
  Eigen::VectorXd count = Eigen::VectorXd::Zero(nodes);
  for (const auto cell : surface.cells.rowwise())
    for (int k = 0; k < 4; ++k) {
      const int node = cell[k];
      Eigen::Matrix2d edges;
      Eigen::Matrix<double, Eigen::Dynamic, 2> change(c, 2);
      for (const int side : {0, 1}) {
        const int other = cell[(k + (side == 0 ? 1 : 3)) % 4];
        edges.col(side) = (surface.nodes.row(other) - surface.nodes.row(node)).head<2>().transpose();
        change.col(side) = U.segment(c * other, c) - U.segment(c * node, c);
      }
      sum[static_cast<std::size_t>(node)] += change * edges.inverse();
      count[node] += 1.0;
    }
  for (Eigen::Index i = 0; i < nodes; ++i) sum[static_cast<std::size_t>(i)] /= std::max(1.0, count[i]);
  return sum;
}

class Placement final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double length = (scene.high - scene.low).norm(),
                 pixel = 1.0 / std::sqrt(std::abs(scene.pixels.determinant()));
    const auto shift = [&](const char* name, const char* direction) {
      return Quantity{.name = name,
                      .unit = "length",
                      .description = std::string("of the specimen against the mesh, along ") + direction,
                      .step = 1e-3 * scene.element,
                      .size = pixel,
                      .lower = -0.2 * length,
                      .upper = 0.2 * length};
    };
    return {.name = "placement",
            .link = Link::camera,
            .quantities = {shift("placement_x", "x"),
                           shift("placement_y", "y"),
                           {.name = "placement_turn",
                            .unit = "rad",
                            .description = "of the specimen against the mesh",
                            .step = 1e-4,
                            .size = 2.0 * pixel / length,
                            .lower = -0.1,
                            .upper = 0.1}},
            .sentence = "the mesh does not lie on the image where the specimen does",
            .confused_with = "hole offset, taper, Hill's axes",
            .separated_by = "edges and hole in the image, at a higher magnification"};
  }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  /// What lies at X on the mesh is the specimen's point X - d, d = shift + turn x (X - middle): R u(X - d) instead of
  /// u(X), to first order.
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    if (values[0] == 0.0 && values[1] == 0.0 && values[2] == 0.0) return;
    const auto slope = gradients(*scene.surface, U);
    const auto nodes = scene.surface->nodes.rows();
    const Eigen::Index c = U.size() / nodes;
    for (Eigen::Index i = 0; i < nodes; ++i) {
      const Eigen::Vector2d X = scene.surface->nodes.row(i).head<2>().transpose() - scene.middle(),
                            u = U.segment<2>(c * i);
      const Eigen::Vector2d d = Eigen::Vector2d(values[0], values[1]) + values[2] * Eigen::Vector2d(-X.y(), X.x());
      error.segment(c * i, c) -= slope[static_cast<std::size_t>(i)] * d;
      error.segment<2>(c * i) += values[2] * Eigen::Vector2d(-u.y(), u.x());
    }
  }
};

}  // namespace

std::shared_ptr<const Effect> placement() { return std::make_shared<Placement>(); }

}  // namespace imic3d::loop
