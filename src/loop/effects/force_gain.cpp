// The load cell is off by a factor.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class ForceGain final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "force gain",
            .link = Link::record,
            .quantities = {{.name = "force_gain",
                            .unit = "-",
                            .description = "recorded over true force",
                            .null = 1.0,
                            .step = 1e-3,
                            .size = 1.02,
                            .lower = 0.5,
                            .upper = 2.0}},
            .sentence = "the load cell's gain is off",
            .confused_with = "thickness; E, S_y and H together, exactly",
            .separated_by = "a second load cell; a prior on E"};
  }
  void record(Values values, const Scene&, Eigen::VectorXd& force) const override { force *= values[0]; }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> force_gain() { return std::make_shared<ForceGain>(); }

}  // namespace imic3d::loop
