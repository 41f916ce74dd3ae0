// The image grows with the clock: a warming camera, a support that creeps.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class MagnificationDrift final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "magnification drift",
            .link = Link::camera,
            .quantities = {{.name = "magnification_drift",
                            .unit = "-",
                            .description = "relative growth of the image over the test",
                            .step = 1e-5,
                            .size = 3e-4,
                            .lower = -0.05,
                            .upper = 0.05}},
            .sentence = "the camera's magnification drifts with the clock",
            .confused_with = "Poisson's ratio, lens distortion",
            .separated_by = "static frames at the end, a second camera, a telecentric lens"};
  }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void see(Values values, const Scene& scene, int t, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    const int c = scene.components;
    for (Eigen::Index i = 0; i < U.size() / c; ++i) {
      const Eigen::Vector2d at =
          scene.surface->nodes.row(i).head<2>().transpose() + U.segment<2>(c * i) - scene.axis_of_lens;
      error.segment<2>(c * i) += values[0] * scene.drifted(t) * at;
    }
  }
};

}  // namespace

std::shared_ptr<const Effect> magnification_drift() { return std::make_shared<MagnificationDrift>(); }

}  // namespace imic3d::loop
