// The hole lies off its place.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class HoleOffset final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const auto along = [&](const char* name, const char* axis) {
      return Quantity{.name = name,
                      .unit = "length",
                      .description = std::string("of the hole's centre along ") + axis,
                      .step = 2e-3 * scene.radius,
                      .size = 0.02 * scene.radius,
                      .lower = -0.3 * scene.radius,
                      .upper = 0.3 * scene.radius};
    };
    return {.name = "hole offset",
            .link = Link::geometry,
            .quantities = {along("hole_offset_x", "x"), along("hole_offset_y", "y")},
            .sentence = "the hole is not where the mesh has it",
            .confused_with = "taper, bending in the plane",
            .separated_by = "the hole's edge in the image"};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.has_hole; }
  void place(Values values, const Scene& scene, Eigen::Vector2d& point) const override {
    point += near_hole(scene, (point - scene.hole).norm()) * Eigen::Vector2d(values[0], values[1]);
  }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> hole_offset() { return std::make_shared<HoleOffset>(); }

}  // namespace imic3d::loop
