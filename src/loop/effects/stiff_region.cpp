// A region that is weaker or stronger than the rest: a weld, a defect, a hard spot. Its place and its size are unknown.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class StiffRegion final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    const auto shape = [](const char* name, const char* description, double usual, double lower, double upper) {
      return Quantity{.name = name,
                      .unit = "-",
                      .description = description,
                      .null = usual,
                      .step = 1e-3,
                      .lower = lower,
                      .upper = upper,
                      .shape = true,
                      .scale = usual};
    };
    Description description{
        .name = "stiff or soft region",
        .link = Link::material,
        .quantities =
            {{.name = "region",
              .unit = "-",
              .description = "how much stronger than the rest its middle is, by 1 + region exp(-(r/radius)^2)",
              .step = 5e-3,
              .size = 0.05,
              .lower = -0.6,
              .upper = 2.0},
             shape("region_x", "its middle, 0 at the left and 1 at the right end of the surface", 0.5, 0.0, 1.0),
             shape("region_y", "its middle, 0 at the lower and 1 at the upper end of the surface", 0.5, 0.0, 1.0),
             shape("region_radius", "over the smaller side of the surface", 0.2, 0.03, 1.0)},
        .sentence = "a part of the specimen is softer or stiffer than the rest",
        .confused_with = "taper, hole radius",
        .separated_by = "the other face, hardness"};
    description.elsewhere.push_back({0.5, 0.5, 0.2});
    for (double y : {1.0 / 6.0, 0.5, 5.0 / 6.0})
      for (double x : {0.25, 0.75}) description.elsewhere.push_back({x, y, 0.2});
    return description;
  }
  [[nodiscard]] double section(Values values, const Scene& scene, const Eigen::Vector3d& point) const override {
    const Eigen::Vector2d middle =
        scene.low + Eigen::Vector2d(values[1], values[2]).cwiseProduct(scene.high - scene.low);
    const double r = (point.head<2>() - middle).norm() / (values[3] * (scene.high - scene.low).minCoeff());
    return 1.0 + values[0] * std::exp(-r * r);
  }
  [[nodiscard]] bool acts_on_section() const override { return true; }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> stiff_region() { return std::make_shared<StiffRegion>(); }

}  // namespace imic3d::loop
