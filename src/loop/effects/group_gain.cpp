// The bars of one group carry more or less than those of the others.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class GroupGain final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {
        .name = "gain",
        .link = Link::record,
        .quantities = {{.name = "gain",
                        .unit = "-",
                        .description = "stress of these bars over that of the others",
                        .null = 1.0,
                        .step = 1e-3,
                        .size = 1.02,
                        .lower = 0.5,
                        .upper = 2.0}},
        .sentence = "these bars carry more or less than the others, by a factor: another batch, section or load cell",
        .confused_with = "whatever sets these tests apart, such as their rate",
        .separated_by = "bars of one batch on one machine under both conditions"};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.surface == nullptr; }
  [[nodiscard]] bool of_each_group() const override { return true; }
  void record(Values values, const Scene&, Eigen::VectorXd& force) const override { force *= values[0]; }
};

}  // namespace

std::shared_ptr<const Effect> group_gain() { return std::make_shared<GroupGain>(); }

}  // namespace imic3d::loop
