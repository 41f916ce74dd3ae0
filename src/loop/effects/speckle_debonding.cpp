// Speckle comes off in flakes, whitens or cracks about a moment of the test: what is seen there is another pattern from
// then on.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class SpeckleDebonding final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    Description description{.name = "speckle debonding",
                            .link = Link::light,
                            .quantities = {},
                            .sentence = "the speckle has come off or changed in places",
                            .confused_with = "noise level, cracks and motion that the mesh cannot follow",
                            .separated_by = "a look at the images of these places"};
    const Places places(scene);
    for (int k = 0; k < places.count(); ++k) {
      const Eigen::Vector2d at = places.middle(k);
      description.quantities.push_back(
          {.name = "loose_" + std::to_string(k + 1),
           .unit = "-",
           .description = "share of the speckle about x = " + std::to_string(at[0]).substr(0, 5) +
                          ", y = " + std::to_string(at[1]).substr(0, 5) + " (noise may make it negative)",
           .step = 1e-4,
           .size = 0.3,
           .lower = -0.2,
           .upper = 1.2});
    }
    description.quantities.push_back({.name = "onset",
                                      .unit = "-",
                                      .description = "when, 0 at the reference and 1 at the last frame",
                                      .null = 0.4,
                                      .step = 1e-3,
                                      .lower = 0.0,
                                      .upper = 0.9,
                                      .shape = true,
                                      .scale = 0.4});
    description.quantities.push_back({.name = "beneath",
                                      .unit = "grey level",
                                      .description = "brightness of what is seen then, beyond the mean",
                                      .null = 0.0,
                                      .step = 1e-3 * scene.dynamic,
                                      .lower = -0.6 * scene.dynamic,
                                      .upper = 0.6 * scene.dynamic,
                                      .shape = true,
                                      .scale = 0.2 * scene.dynamic});
    description.quantities.push_back({.name = "contrast_beneath",
                                      .unit = "-",
                                      .description = "its contrast over that of the speckle",
                                      .null = 0.8,
                                      .step = 1e-3,
                                      .lower = 0.0,
                                      .upper = 2.0,
                                      .shape = true,
                                      .scale = 0.8});
    return description;
  }
  /// Within a good half of a frame about the onset.
  void light(Values values, const Scene& scene, int t, const Eigen::Vector2d& point, const Eigen::Vector2d&,
             Light& light) const override {
    if (t < 0 || (point - scene.low).minCoeff() < 0.0 || (scene.high - point).minCoeff() < 0.0)
      return;  // a generator's specimen goes on beyond
    const Places places(scene);
    const auto shapes = values.last(3);
    const double since = (scene.clock(t) - shapes[0]) * static_cast<double>(scene.time.size());  // [frames]
    light.foreign += values[static_cast<std::size_t>(places.of(point))] / (1.0 + std::exp(-15.0 * since));
    light.beneath = shapes[1], light.contrast = shapes[2];
  }
};

}  // namespace

std::shared_ptr<const Effect> speckle_debonding() { return std::make_shared<SpeckleDebonding>(); }

}  // namespace imic3d::loop
