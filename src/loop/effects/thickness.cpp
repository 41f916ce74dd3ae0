// The specimen, or the section of a bar, is not as thick as was measured.
#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Thickness final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {
        .name = "thickness",
        .link = Link::geometry,
        .quantities = {{.name = "thickness_error",
                        .unit = "-",
                        .description = "of the specimen beyond the declared thickness, over it; of a bar its section",
                        .step = 1e-3,
                        .size = 0.02,
                        .lower = -0.5,
                        .upper = 1.0}},
        .sentence = "the specimen is thicker than was measured",
        .confused_with = "force gain; E, S_y and H together",
        .separated_by = "a micrometre"};
  }
  [[nodiscard]] double thickness(Values values) const override { return 1.0 + values[0]; }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
  /// In plane stress, and in a bar, the motion does not depend on it.
  [[nodiscard]] bool changes_simulation(const Scene& scene) const override {
    return scene.surface != nullptr && !scene.plane;
  }
};

}  // namespace

std::shared_ptr<const Effect> thickness() { return std::make_shared<Thickness>(); }

}  // namespace imic3d::loop
