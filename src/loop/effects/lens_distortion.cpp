// Radial distortion (Brown): what moves through the field of view is stretched on its way, and the reference shows it
// beside its place.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class LensDistortion final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double r2 = 0.25 * (scene.high - scene.low).squaredNorm();
    return {
        .name = "lens distortion",
        .link = Link::camera,
        .quantities = {{.name = "k1",
                        .unit = "1/length^2",
                        .description = "radial distortion x (1 + k1 r^2) about the image's centre, r on the specimen",
                        .step = 1e-4 / r2,
                        .size = 3e-3 / r2,
                        .lower = -0.2 / r2,
                        .upper = 0.2 / r2}},
        .sentence = "the lens distorts radially",
        .confused_with = "magnification drift, taper",
        .separated_by = "images of a grid, or of the specimen shifted rigidly"};
  }
  /// In the plane of an image; of one of several cameras: of_one_camera.
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.components == 2; }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    see_through([k1 = values[0]](const Eigen::Vector2d& x) -> Eigen::Vector2d { return k1 * x.squaredNorm() * x; },
                scene, U, error);
  }
};

}  // namespace

std::shared_ptr<const Effect> lens_distortion() { return std::make_shared<LensDistortion>(); }

}  // namespace imic3d::loop
