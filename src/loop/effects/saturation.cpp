// The exposure is too long: bright pixels stop at the largest grey level, in all images.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class Saturation final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "saturation",
            .link = Link::light,
            .quantities = {{.name = "saturated",
                            .unit = "-",
                            .description = "share of the specimen's pixels at the largest grey level",
                            .step = 1e-4,
                            .size = 0.03,
                            .lower = 0.0,
                            .upper = INFINITY}},
            .sentence = "pixels are saturated",
            .confused_with = "light gain",
            .separated_by = "a shorter exposure; the histogram of the reference"};
  }
  void light(Values values, const Scene&, int, const Eigen::Vector2d&, const Eigen::Vector2d&,
             Light& light) const override {
    light.saturated += values[0];
  }
};

}  // namespace

std::shared_ptr<const Effect> saturation() { return std::make_shared<Saturation>(); }

}  // namespace imic3d::loop
