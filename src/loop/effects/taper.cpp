// The thickness is not the same everywhere; its mean is the declared one.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Taper final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const auto along = [&](const char* name, const char* axis, int direction) {
      return Quantity{.name = name,
                      .unit = "1/length",
                      .description = std::string("relative growth of the thickness along ") + axis,
                      .step = 1e-3 / scene.span(direction),
                      .size = 0.01 / scene.span(direction),
                      .lower = -0.5 / scene.span(direction),
                      .upper = 0.5 / scene.span(direction)};
    };
    return {.name = "taper",
            .link = Link::geometry,
            .quantities = {along("taper_x", "x", 0), along("taper_y", "y", 1)},
            .sentence = "the thickness changes along the specimen",
            .confused_with = "stiff or soft region, hole offset",
            .separated_by = "a micrometre"};
  }
  [[nodiscard]] double section(Values values, const Scene& scene, const Eigen::Vector3d& point) const override {
    const Eigen::Vector2d from = point.head<2>() - scene.middle();
    return 1.0 + values[0] * from[0] + values[1] * from[1];
  }
  [[nodiscard]] bool acts_on_section() const override { return true; }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> taper() { return std::make_shared<Taper>(); }

}  // namespace imic3d::loop
