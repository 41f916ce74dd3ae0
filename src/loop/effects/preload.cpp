// The reference image shows a specimen under load: all displacements and the zeroed force count from there.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Preload final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double largest = scene.force.cwiseAbs().maxCoeff();
    return {.name = "preload",
            .link = Link::initial,
            .quantities = {{.name = "preload",
                            .unit = "force",
                            .description = "on the specimen when the reference image was taken, and not in the record",
                            .step = 2e-3 * largest,
                            .size = 0.02 * largest,
                            .lower = -0.3 * largest,
                            .upper = 0.5 * largest}},
            .sentence = "the specimen was loaded already in the reference image",
            .confused_with = "force zero, Voce term",
            .separated_by = "an image before clamping"};
  }
  /// The displacement is counted from the loaded state; the record was set to zero there.
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd&, Eigen::VectorXd& error) const override {
    error -= values[0] * scene.elastic;
  }
  void record(Values values, const Scene&, Eigen::VectorXd& force) const override { force.array() -= values[0]; }
};

}  // namespace

std::shared_ptr<const Effect> preload() { return std::make_shared<Preload>(); }

}  // namespace imic3d::loop
