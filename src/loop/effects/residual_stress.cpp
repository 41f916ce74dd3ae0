// Stress that is in the specimen before the test.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class ResidualStress final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {
        .name = "residual stress",
        .link = Link::initial,
        .quantities = {{.name = "residual_strain",
                        .unit = "-",
                        .description = "elastic strain in the middle of the width before the test, parabolic across it",
                        .step = 1e-5,
                        .size = 2e-4,
                        .lower = -5e-3,
                        .upper = 5e-3}},
        .sentence = "the specimen holds residual stress, parabolic across its width",
        .confused_with = "Voce term, first yield",
        .separated_by = "slitting or hole drilling"};
  }
  /// In equilibrium over the width: 1 - 3 s^2 with s from -1 to 1.
  [[nodiscard]] double initial_strain(Values values, const Scene& scene, const Eigen::Vector3d& point) const override {
    const int across = 1 - scene.axis;
    const double s = (point[across] - scene.middle()[across]) / (0.5 * scene.span(across));
    return values[0] * (1.0 - 3.0 * s * s);
  }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> residual_stress() { return std::make_shared<ResidualStress>(); }

}  // namespace imic3d::loop
