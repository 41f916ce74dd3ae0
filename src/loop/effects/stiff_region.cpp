// A region that is weaker or stronger than the rest: a weld, a defect, a hard spot.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class StiffRegion final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    Description description{.name = "stiff or soft region",
            .link = Link::material,
            .quantities = {},
            .sentence = "a part of the specimen is softer or stiffer than the rest",
            .confused_with = "taper, hole radius",
            .separated_by = "the other face, hardness"};
    for (int k = 0; k < places; ++k)
      description.quantities.push_back({.name = "region_" + std::to_string(k + 1), .unit = "-", .description = place_of(scene, k), .step = 5e-3, .size = 0.05, .lower = -0.6, .upper = 2.0});
    return description;
  }
  [[nodiscard]] double section(Values values, const Scene& scene, const Eigen::Vector3d& point) const override {
    double factor = 1.0;
    for (int k = 0; k < places; ++k) {
      const Eigen::Vector2d centre = middle_of(scene, k);
      const double r = (point.head<2>() - centre).norm() / (0.2 * (scene.high - scene.low).minCoeff());
      factor += values[static_cast<std::size_t>(k)] * std::exp(-r * r);
    }
    return factor;
  }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }

 private:
  static constexpr int columns = 2, rows = 3, places = columns * rows;
  static Eigen::Vector2d middle_of(const Scene& scene, int k) {
    return {scene.low[0] + scene.span(0) * (k % columns + 0.5) / columns, scene.low[1] + scene.span(1) * (k / columns + 0.5) / rows};
  }
  static std::string place_of(const Scene& scene, int k) {
    const Eigen::Vector2d at = middle_of(scene, k);
    return "relative strength about x = " + std::to_string(at[0]).substr(0, 5) + ", y = " + std::to_string(at[1]).substr(0, 5);
  }
};

}  // namespace

std::shared_ptr<const Effect> stiff_region() { return std::make_shared<StiffRegion>(); }

}  // namespace imic3d::loop
