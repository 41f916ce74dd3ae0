// Stray light, or the camera's black level, changes with the clock.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class LightOffset final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    return {.name = "light offset",
            .link = Link::light,
            .quantities = {{.name = "offset_drift",
                            .unit = "grey level",
                            .description = "change of all grey levels over the test",
                            .step = 1e-4 * scene.dynamic,
                            .size = 0.02 * scene.dynamic,
                            .lower = -0.5 * scene.dynamic,
                            .upper = 0.5 * scene.dynamic}},
            .sentence = "stray light or the black level drifts with the clock",
            .confused_with = "light gain",
            .separated_by = "a black patch in the field of view; frames at rest at the end"};
  }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void light(Values values, const Scene& scene, int t, const Eigen::Vector2d&, const Eigen::Vector2d&,
             Light& light) const override {
    light.offset += values[0] * scene.drifted(t);
  }
};

}  // namespace

std::shared_ptr<const Effect> light_offset() { return std::make_shared<LightOffset>(); }

}  // namespace imic3d::loop
