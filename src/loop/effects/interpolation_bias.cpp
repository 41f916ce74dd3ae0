// Interpolation of grey levels between pixels: the displacement errs like a sine with the period of a pixel (Schreier
// 2000).
#include <Eigen/LU>
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class InterpolationBias final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "sub-pixel interpolation",
            .link = Link::numerics,
            .quantities = {{.name = "bias_columns",
                            .unit = "px",
                            .description = "amplitude along the columns",
                            .step = 1e-3,
                            .size = 0.01,
                            .lower = -0.2,
                            .upper = 0.2},
                           {.name = "bias_rows",
                            .unit = "px",
                            .description = "amplitude along the rows",
                            .step = 1e-3,
                            .size = 0.01,
                            .lower = -0.2,
                            .upper = 0.2}},
            .sentence = "the interpolation of the images errs with the period of a pixel",
            .confused_with = "noise",
            .separated_by = "images of rigid shifts by parts of a pixel; a wider dic.low_pass"};
  }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  [[nodiscard]] bool of_one_of_several() const override { return true; }
  /// Another program's points come of subsets and splines of its own, and of pixels that its tables do not tell.
  [[nodiscard]] bool applies(const Scene& scene) const override { return scene.images && scene.components == 2; }
  void see(Values values, const Scene& scene, int, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    const Eigen::Matrix2d back = scene.pixels.inverse();
    for (Eigen::Index i = 0; i < U.size() / 2; ++i) {
      const Eigen::Vector2d pixel = scene.pixels * U.segment<2>(2 * i);
      const Eigen::Vector2d bias(values[0] * std::sin(2.0 * M_PI * pixel[0]),
                                 values[1] * std::sin(2.0 * M_PI * pixel[1]));
      error.segment<2>(2 * i) += back * bias;
    }
  }
};

}  // namespace

std::shared_ptr<const Effect> interpolation_bias() { return std::make_shared<InterpolationBias>(); }

}  // namespace imic3d::loop
