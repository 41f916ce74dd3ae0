// The load line does not pass through the middle of the thickness, which a camera on one face alone does not see.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Misalignment final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double size = 0.02;
    return {
        .name = "misalignment",
        .link = Link::loading,
        .quantities = {{.name = "bending_share",
                        .unit = "-",
                        .description =
                            "relative difference of the elongation between the front and the middle of the thickness",
                        .step = 0.02 * size,
                        .size = size,
                        .lower = -0.5,
                        .upper = 0.5}},
        .sentence = "the load is eccentric through the thickness and bends the specimen",
        .confused_with = scene.plane ? "" : "E, force gain",
        .separated_by = "a camera on the other face"};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return !scene.plane && !scene.half; }
  /// Grows linearly from zero where the cameras look, in proportion to the elongation.
  [[nodiscard]] double driven(Values values, const Scene& scene, int t, double z) const override {
    return values[0] * scene.elongation[t] * (z + scene.driven_depth) / (0.5 * scene.thickness);
  }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> misalignment() { return std::make_shared<Misalignment>(); }

}  // namespace imic3d::loop
