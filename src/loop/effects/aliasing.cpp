// The speckle is finer than pixels and interpolation resolve. After a motion of d pixels an interpolated wave of
// amplitude a is a (1 - h + h exp(2 pi i d)): h is all of it beyond half a wave per pixel, and little of a coarse one.
// It leaves 2 a^2 h^2 (1 - cos 2 pi d) of the squared residual, and a^2 h (1 - cos 2 pi d) goes with the reference:
// contrast that is lost. Waves along x and y have half of the variance each: sum of a^2 h^2 = aliased var f, sum of a^2
// h = contrast_lost aliased var f.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Aliasing final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {
        .name = "aliasing",
        .link = Link::light,
        .quantities = {{.name = "aliased",
                        .unit = "-",
                        .description = "share of the variance of the grey levels (as the correlation sees them, after "
                                       "its low pass) that pixels do not resolve, in all images",
                        .step = 1e-4,
                        .size = 0.02,
                        .lower = 0.0,
                        .upper = INFINITY},
                       {.name = "contrast_lost",
                        .unit = "-",
                        .description = "contrast lost halfway between pixels over the aliased share",
                        .null = 3.0,
                        .step = 1e-2,
                        .lower = 1.0,
                        .upper = 30.0,
                        .shape = true,
                        .scale = 3.0}},
        .sentence = "the speckle is finer than the pixels resolve",
        .confused_with = "noise level, motion that the mesh cannot follow",
        .separated_by =
            "frames moved by fractions of a pixel before the test; a lens a little out of focus, or `dic.low_pass`"};
  }
  void light(Values values, const Scene&, int, const Eigen::Vector2d&, const Eigen::Vector2d&,
             Light& light) const override {
    light.aliased += values[0], light.smeared += values[0] * values[1];
  }
};

}  // namespace

std::shared_ptr<const Effect> aliasing() { return std::make_shared<Aliasing>(); }

}  // namespace imic3d::loop
