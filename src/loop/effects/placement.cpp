// The mesh does not lie on the image where the specimen does.
#include <Eigen/LU>
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

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
            .confused_with = "hole offset, camera tilt, taper, Hill's axes",
            .separated_by = "edges and hole in the image, at a higher magnification"};
  }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  /// What lies at X on the mesh is the specimen's point X - d, d = shift + turn x (X - middle): R u(X - d) instead of
  /// u(X), to first order.
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    const auto& nodes = scene.surface->nodes;
    Points d(nodes.rows(), 2);
    for (Eigen::Index i = 0; i < nodes.rows(); ++i) {
      const Eigen::Vector2d X = nodes.row(i).head<2>().transpose() - scene.middle();
      d.row(i) << values[0] - values[2] * X.y(), values[1] + values[2] * X.x();
    }
    see_beside(d, scene, U, error);
    const Eigen::Index c = U.size() / nodes.rows();
    for (Eigen::Index i = 0; i < nodes.rows(); ++i)
      error.segment<2>(c * i) += values[2] * Eigen::Vector2d(-U[c * i + 1], U[c * i]);
  }
};

}  // namespace

std::shared_ptr<const Effect> placement() { return std::make_shared<Placement>(); }

}  // namespace imic3d::loop
