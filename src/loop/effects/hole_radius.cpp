// The hole is larger or smaller than drawn.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class HoleRadius final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    return {.name = "hole radius",
            .link = Link::geometry,
            .quantities = {{.name = "hole_radius_error",
                            .unit = "length",
                            .description = "of the specimen beyond that of the mesh",
                            .step = 2e-3 * scene.radius,
                            .size = 0.02 * scene.radius,
                            .lower = -0.2 * scene.radius,
                            .upper = 0.2 * scene.radius}},
            .sentence = "the hole is larger than in the mesh",
            .confused_with = "force zero, coarse mesh, soft region",
            .separated_by = "the hole's edge in the image, a gauge"};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.has_hole; }
  void place(Values values, const Scene& scene, Eigen::Vector2d& point) const override {
    const Eigen::Vector2d from = point - scene.hole;
    point += values[0] * near_hole(scene, from.norm()) * from.normalized();
  }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> hole_radius() { return std::make_shared<HoleRadius>(); }

}  // namespace imic3d::loop
