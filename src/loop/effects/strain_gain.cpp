// The extensometer is off by a factor.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class StrainGain final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "strain gain",
            .link = Link::record,
            .quantities = {{.name = "strain_gain",
                            .unit = "-",
                            .description = "recorded over true strain",
                            .null = 1.0,
                            .step = 1e-3,
                            .size = 1.03,
                            .lower = 0.5,
                            .upper = 2.0}},
            .sentence = "the extensometer's gain (or its gauge length) is off",
            .confused_with = "E, hardening over the whole range",
            .separated_by = "a prior on E; a second extensometer"};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.surface == nullptr; }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
  [[nodiscard]] bool of_each_group() const override { return true; }
  /// Of the elongation.
  void gauge(Values values, Eigen::VectorXd& strain) const override {
    strain = strain.unaryExpr([&](double e) { return std::log1p(std::expm1(e) / values[0]); });
  }
};

}  // namespace

std::shared_ptr<const Effect> strain_gain() { return std::make_shared<StrainGain>(); }

}  // namespace imic3d::loop
