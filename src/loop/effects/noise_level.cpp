// The image noise changes with the clock: gain of the camera, temperature, exposure.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class NoiseLevel final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "noise level",
            .link = Link::light,
            .quantities = {{.name = "noise_drift",
                            .unit = "-",
                            .description = "relative change of the noise's standard deviation over the test",
                            .step = 1e-3,
                            .size = 0.2,
                            .lower = -0.9,
                            .upper = 10.0}},
            .sentence = "the image noise changes with the clock",
            .confused_with = "motion that the mesh cannot follow, speckle debonding",
            .separated_by = "frames at rest at the end"};
  }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void light(Values values, const Scene& scene, int t, const Eigen::Vector2d&, const Eigen::Vector2d&,
             Light& light) const override {
    light.noise *= 1.0 + values[0] * scene.drifted(t);
  }
};

}  // namespace

std::shared_ptr<const Effect> noise_level() { return std::make_shared<NoiseLevel>(); }

}  // namespace imic3d::loop
