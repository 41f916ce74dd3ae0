// Force and images, or strain, do not belong to the same moment.
#include <algorithm>
#include <cmath>
#include <string>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class ForceDelay final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene& scene) const override {
    const double duration = scene.time[scene.time.size() - 1] - scene.start_time, frame = duration / static_cast<double>(scene.time.size());
    const double longest = std::max(3.0 * frame, 0.1 * duration);
    const std::string other = scene.surface == nullptr ? "strain" : "images";
    return {.name = "delay of the force",
            .link = Link::record,
            .quantities = {{.name = "force_delay", .unit = "time", .description = "of the force behind the " + other, .step = 0.02 * frame, .size = 0.2 * frame, .lower = -longest, .upper = longest}},
            .sentence = "force and " + other + " are not recorded at the same time",
            .confused_with = "rate dependence",
            .separated_by = "a pulse that both record; a hold"};
  }
  /// F(t - delay), the force between two frames being linear in time.
  void record(Values values, const Scene& scene, Eigen::VectorXd& force) const override {
    const Eigen::VectorXd now = force;
    const auto value_at = [&](double time) {
      Eigen::Index after = 0;
      while (after + 1 < now.size() && scene.time[after] < time) ++after;
      const double t0 = after == 0 ? scene.start_time : scene.time[after - 1], F0 = after == 0 ? 0.0 : now[after - 1];
      if (scene.time[after] <= t0) return now[after];
      return F0 + (now[after] - F0) * (time - t0) / (scene.time[after] - t0);
    };
    for (Eigen::Index t = 0; t < now.size(); ++t) force[t] = value_at(scene.time[t] - values[0]);
  }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> force_delay() { return std::make_shared<ForceDelay>(); }

}  // namespace imic3d::loop
