// The camera does not face the specimen: what is nearer to the lens is seen larger.
#include "effects.hpp"

namespace imic3d::loop {

namespace {

class CameraTilt final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double tilt = 1e-2 / (0.5 * (scene.high - scene.low).norm());
    const auto along = [&](const char* name, const char* axis) {
      return Quantity{.name = name,
                      .unit = "1/length",
                      .description = std::string("growth of the magnification along ") + axis +
                                     ": sine of the angle over the distance of the lens",
                      .step = 1e-2 * tilt,
                      .size = 0.3 * tilt,
                      .lower = -20 * tilt,
                      .upper = 20 * tilt};
    };
    return {.name = "camera tilt",
            .link = Link::camera,
            .quantities = {along("perspective_x", "x"), along("perspective_y", "y")},
            .sentence = "the camera does not face the specimen: what is nearer to the lens is seen larger",
            .confused_with = "placement, lens distortion, taper",
            .separated_by = "an image of a grid in the specimen's plane; a telecentric lens"};
  }
  /// Of one camera: those of a rig have their poses.
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.components == 2; }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    const Eigen::Vector2d tilt(values[0], values[1]);
    see_through([&](const Eigen::Vector2d& x) -> Eigen::Vector2d { return tilt.dot(x) * x; }, scene, U, error);
  }
};

}  // namespace

std::shared_ptr<const Effect> camera_tilt() { return std::make_shared<CameraTilt>(); }

}  // namespace imic3d::loop
