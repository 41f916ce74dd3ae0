// The zero of the load cell is off.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class ForceOffset final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double largest = scene.force.cwiseAbs().maxCoeff();
    return {.name = "force zero",
            .link = Link::record,
            .quantities = {{.name = "force_offset",
                            .unit = "force",
                            .description = "reading without load",
                            .step = 1e-3 * largest,
                            .size = 0.01 * largest,
                            .lower = -0.3 * largest,
                            .upper = 0.3 * largest,
                            .read_at_rest = true}},
            .sentence = "the load cell reads a force without load",
            .confused_with = "hole radius",
            .separated_by = "frames without load, unloading to zero"};
  }
  void record(Values values, const Scene&, Eigen::VectorXd& force) const override { force.array() += values[0]; }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
  [[nodiscard]] bool of_each_group() const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> force_offset() { return std::make_shared<ForceOffset>(); }

}  // namespace imic3d::loop
