// The camera is pushed: from some moment on it is tilted and nearer. Its in-plane motion leaves no trace, the ends
// follow it.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class CameraBump final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double tilt = 1e-3 / (0.5 * (scene.high - scene.low).norm());
    return {.name = "camera bump",
            .link = Link::camera,
            .quantities = {{.name = "tilt_x",
                            .unit = "1/length",
                            .description = "magnification grows along x from then on",
                            .step = 1e-2 * tilt,
                            .size = 0.3 * tilt,
                            .lower = -20 * tilt,
                            .upper = 20 * tilt},
                           {.name = "tilt_y",
                            .unit = "1/length",
                            .description = "magnification grows along y from then on",
                            .step = 1e-2 * tilt,
                            .size = 0.3 * tilt,
                            .lower = -20 * tilt,
                            .upper = 20 * tilt},
                           {.name = "step_of_magnification",
                            .unit = "-",
                            .description = "magnification from then on",
                            .step = 1e-5,
                            .size = 3e-4,
                            .lower = -0.02,
                            .upper = 0.02},
                           {.name = "bump_onset",
                            .unit = "-",
                            .description = "when, 0 at the reference and 1 at the last frame",
                            .null = 0.5,
                            .step = 1e-3,
                            .lower = 0.0,
                            .upper = 0.9,
                            .shape = true,
                            .scale = 0.5}},
            .sentence = "the camera was moved during the test",
            .confused_with = "magnification drift",
            .separated_by = "a fixed mark in the field of view",
            .elsewhere = moments(scene, 0.9, 30)};
  }
  /// In the plane of an image; of one of several cameras: of_one_camera.
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.components == 2; }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void see(Values values, const Scene& scene, int t, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    const double moved = begun(scene, t, values[3]);
    for (Eigen::Index i = 0; i < U.size() / 2; ++i) {
      const Eigen::Vector2d at =
          scene.surface->nodes.row(i).head<2>().transpose() + U.segment<2>(2 * i) - scene.axis_of_lens;
      error.segment<2>(2 * i) += moved * (values[0] * at[0] + values[1] * at[1] + values[2]) * at;
    }
  }
};

}  // namespace

std::shared_ptr<const Effect> camera_bump() { return std::make_shared<CameraBump>(); }

}  // namespace imic3d::loop
