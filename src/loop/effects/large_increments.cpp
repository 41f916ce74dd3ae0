// The path is followed in too large increments: a run with more of them shows it.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class LargeIncrements final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "large increments",
            .link = Link::numerics,
            .quantities = {{.name = "increment_error",
                            .unit = "-",
                            .description = "part of the way to three times as many load increments",
                            .step = 1.0,
                            .size = 1.0,
                            .lower = 0.0,
                            .upper = 3.0}},
            .sentence = "the load increments between two frames are too large",
            .confused_with = "first yield",
            .separated_by = "one run with identify.steps_per_frame three times as many"};
  }
  void numerics(Numerics& made) const override { made.increments_factor = 3; }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> large_increments() { return std::make_shared<LargeIncrements>(); }

}  // namespace imic3d::loop
