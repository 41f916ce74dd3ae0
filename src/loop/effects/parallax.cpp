// Perspective of a lens that is taken for a telecentric one: what moves away is seen smaller.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Parallax final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double size = 1.0 / (20.0 * (scene.high - scene.low).norm());
    return {.name = "parallax",
            .link = Link::camera,
            .quantities = {{.name = "inverse_distance",
                            .unit = "1/length",
                            .description = "of the lens from the surface, which moves away as the specimen thins",
                            .step = 1e-2 * size,
                            .size = size,
                            .lower = -10.0 * size,
                            .upper = 10.0 * size}},
            .sentence = "the surface moves away from the lens as the specimen thins, and is seen smaller",
            .confused_with = "Hill's ratios, magnification drift, Poisson's ratio",
            .separated_by = "a telecentric lens or a second camera"};
  }
  /// Of one camera: several, whose directions differ, see it as a motion in space.
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.components == 2; }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  /// The surface sinks by half the change of thickness, lambda_3 = 1/det F of plastic flow (the elastic part of it is
  /// small).
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    const auto& mesh = *scene.surface;
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(mesh.nodes.rows()), count = sum;
    for (Eigen::Index e = 0; e < mesh.cells.rows(); ++e) {
      double before = 0.0, after = 0.0;
      for (int a = 0; a < 4; ++a) {
        const int i = mesh.cells(e, a), j = mesh.cells(e, (a + 1) % 4);
        const Eigen::Vector2d X = mesh.nodes.row(i).head<2>(), Y = mesh.nodes.row(j).head<2>();
        const Eigen::Vector2d x = X + U.segment<2>(2 * i), y = Y + U.segment<2>(2 * j);
        before += X[0] * Y[1] - X[1] * Y[0], after += x[0] * y[1] - x[1] * y[0];
      }
      for (int a = 0; a < 4; ++a) sum[mesh.cells(e, a)] += before / after, count[mesh.cells(e, a)] += 1.0;
    }
    for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
      const double away = 0.5 * scene.thickness * (1.0 - sum[i] / count[i]);
      const Eigen::Vector2d at = mesh.nodes.row(i).head<2>().transpose() + U.segment<2>(2 * i) - scene.axis_of_lens;
      error.segment<2>(2 * i) -= values[0] * away * at;
    }
  }
};

}  // namespace

std::shared_ptr<const Effect> parallax() { return std::make_shared<Parallax>(); }

}  // namespace imic3d::loop
