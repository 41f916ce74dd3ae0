// The light changes from place to place with the clock: a lamp that moves or is blocked on one side.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class LightGradient final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    return {.name = "light gradient",
            .link = Link::light,
            .quantities = {{.name = "gradient_x",
                            .unit = "1/length",
                            .description = "growth along x of the relative change of the grey levels over the test",
                            .step = 1e-4 / scene.span(0),
                            .size = 0.02 / scene.span(0),
                            .lower = -1.0 / scene.span(0),
                            .upper = 1.0 / scene.span(0)},
                           {.name = "gradient_y",
                            .unit = "1/length",
                            .description = "the same along y",
                            .step = 1e-4 / scene.span(1),
                            .size = 0.02 / scene.span(1),
                            .lower = -1.0 / scene.span(1),
                            .upper = 1.0 / scene.span(1)}},
            .sentence = "the light changes from one side to the other with the clock",
            .confused_with = "light gain, speckle debonding",
            .separated_by = "dic.local_brightness; frames at rest at the end"};
  }
  /// About the surface's middle: what is common to all is a gain.
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void light(Values values, const Scene& scene, int t, const Eigen::Vector2d&, const Eigen::Vector2d& now,
             Light& light) const override {
    const Eigen::Vector2d at = now - scene.middle();
    light.gain *= 1.0 + (values[0] * at[0] + values[1] * at[1]) * scene.drifted(t);
  }
};

}  // namespace

std::shared_ptr<const Effect> light_gradient() { return std::make_shared<LightGradient>(); }

}  // namespace imic3d::loop
