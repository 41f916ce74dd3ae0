// The extensometer was not at zero where the bar was not strained: a slack of the load train, a knife that moved.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class StrainZero final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "strain zero",
            .link = Link::record,
            .quantities = {{.name = "strain_offset",
                            .unit = "-",
                            .description = "recorded engineering strain beyond the true one",
                            .step = 1e-6,
                            .size = 1e-4,
                            .lower = -0.01,
                            .upper = 0.01}},
            .sentence = "the extensometer reads a strain that the bar does not have, all along",
            .confused_with = "delay of the force, which is the same at one rate; E",
            .separated_by = "the line through the elastic rows, which meets no stress at that strain; a hold",
            .elsewhere = {},
            .changes_path = true};
  }
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.surface == nullptr; }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
  [[nodiscard]] bool of_each_group() const override { return true; }
  void gauge(Values values, Eigen::VectorXd& strain) const override {
    strain = strain.unaryExpr([&](double e) { return std::log1p(std::expm1(e) - values[0]); });
  }
};

}  // namespace

std::shared_ptr<const Effect> strain_zero() { return std::make_shared<StrainZero>(); }

}  // namespace imic3d::loop
