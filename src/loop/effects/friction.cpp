// Guides, seals and pins of the load train rub: between specimen and load cell the force loses what friction takes,
// against the motion.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

/// -1 to 1: which way the specimen is being strained at each row of the record; 0 where it rests.
Eigen::ArrayXd direction(const Scene& scene) {
  Eigen::ArrayXd step = scene.elongation;
  step.tail(step.size() - 1) -= scene.elongation.head(step.size() - 1).array();
  const double rest = 0.02 * step.abs().maxCoeff();
  return step / (step.square() + rest * rest).sqrt().max(1e-300);
}

class Friction final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double largest = scene.force.cwiseAbs().maxCoeff();
    return {
        .name = "friction",
        .link = Link::loading,
        .quantities =
            {{.name = "friction_force",
              .unit = "force",
              .description =
                  "recorded beyond that on the specimen while it is being pulled, and as much less while it goes back",
              .step = 1e-3 * largest,
              .size = 0.01 * largest,
              .lower = -0.1 * largest,
              .upper = 0.3 * largest}},
        .sentence = "there is friction in the load train",
        .confused_with = "force zero, S_y, kinematic hardening",
        .separated_by = "a load cell on the other side of the guides; a run without a specimen"};
  }
  /// Without reversal it is a zero of the force.
  [[nodiscard]] bool applies(const Scene& scene) const override {
    return scene.elongation.size() > 1 && direction(scene).minCoeff() < -0.5 && direction(scene).maxCoeff() > 0.5;
  }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
  [[nodiscard]] bool of_each_group() const override { return true; }
  void record(Values values, const Scene& scene, Eigen::VectorXd& force) const override {
    force.array() += values[0] * direction(scene);
  }
};

}  // namespace

std::shared_ptr<const Effect> friction() { return std::make_shared<Friction>(); }

}  // namespace imic3d::loop
