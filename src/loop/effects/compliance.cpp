// Part of the recorded strain is that of grips and load train.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Compliance final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double largest = scene.force.cwiseAbs().maxCoeff();
    return {.name = "compliance",
            .link = Link::record,
            .quantities = {{.name = "compliance",
                            .unit = "1/stress",
                            .description = "recorded engineering strain per stress, beyond that of the bar",
                            .step = 1e-6 / largest,
                            .size = 1e-3 / largest,
                            .lower = 0.0,
                            .upper = 0.03 / largest}},
            .sentence = "the recorded strain contains that of grips and load train",
            .confused_with = "E",
            .separated_by = "an extensometer on the bar; a handbook value of E",
            .elsewhere = {},
            .changes_path = true};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.surface == nullptr; }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
  [[nodiscard]] bool of_each_group() const override { return true; }
  [[nodiscard]] double gives_way(Values values) const override { return values[0]; }
};

}  // namespace

std::shared_ptr<const Effect> compliance() { return std::make_shared<Compliance>(); }

}  // namespace imic3d::loop
