// The light changes in proportion with the clock: a lamp that warms up, daylight.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class LightGain final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "light gain",
            .link = Link::light,
            .quantities = {{.name = "gain_drift",
                            .unit = "-",
                            .description = "relative change of the grey levels over the test",
                            .step = 1e-4,
                            .size = 0.02,
                            .lower = -0.9,
                            .upper = 2.0}},
            .sentence = "the light grows or fades with the clock",
            .confused_with = "light offset, saturation",
            .separated_by = "a grey scale in the field of view; frames at rest at the end"};
  }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void light(Values values, const Scene& scene, int t, const Eigen::Vector2d&, const Eigen::Vector2d&,
             Light& light) const override {
    light.gain *= 1.0 + values[0] * scene.drifted(t);
  }
};

}  // namespace

std::shared_ptr<const Effect> light_gain() { return std::make_shared<LightGain>(); }

}  // namespace imic3d::loop
