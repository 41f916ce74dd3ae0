// One jaw of a grip slips: from some moment on the specimen's end moves differently on its two faces.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class GripSlip final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double longest = scene.elongation.size() > 0 ? scene.elongation.cwiseAbs().maxCoeff() : 1.0;
    return {.name = "grip slip",
            .link = Link::loading,
            .quantities = {{.name = "slip",
                            .unit = "length",
                            .description = "of the end on the front, beyond the middle of the thickness",
                            .step = 1e-4 * longest,
                            .size = 0.01 * longest,
                            .lower = -0.5 * longest,
                            .upper = 0.5 * longest},
                           {.name = "slip_onset",
                            .unit = "-",
                            .description = "when, 0 at the reference and 1 at the last frame",
                            .null = 0.5,
                            .step = 1e-3,
                            .lower = 0.0,
                            .upper = 1.0,
                            .shape = true,
                            .scale = 0.5}},
            .sentence = "the specimen slips in a grip, on one face more than on the other",
            .confused_with = "misalignment",
            .separated_by = "a camera on the other face; marks on specimen and jaws",
            .elsewhere = moments(scene, 1.0, 6)};  // each takes a simulation
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return !scene.plane && !scene.half; }
  /// Grows linearly from zero where the cameras look.
  [[nodiscard]] double driven(Values values, const Scene& scene, int t, double z) const override {
    return values[0] * begun(scene, t, values[1]) * (z + scene.driven_depth) / (0.5 * scene.thickness);
  }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> grip_slip() { return std::make_shared<GripSlip>(); }

}  // namespace imic3d::loop
