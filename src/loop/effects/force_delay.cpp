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
    const double duration = scene.time[scene.time.size() - 1] - scene.start_time,
                 frame = duration / static_cast<double>(scene.time.size());
    const double longest = std::max(3.0 * frame, 0.1 * duration);
    const std::string other = scene.surface == nullptr ? "strain" : "images";
    return {.name = "delay of the force",
            .link = Link::record,
            .quantities = {{.name = "force_delay",
                            .unit = "time",
                            .description = "of the force behind the " + other,
                            .step = 0.02 * frame,
                            .size = 0.2 * frame,
                            .lower = -longest,
                            .upper = longest}},
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
  /// The force is simulated at the frames alone. Between two of them it bends as the record does at both (at a turn it
  /// does so at one): the chord of a parabola is off by phi (1 - phi)/2 of the second difference, that of a kink in its
  /// middle by four times as much, and twice is taken. Beyond the first and the last frame it may stay, or change twice
  /// as fast.
  [[nodiscard]] Eigen::VectorXd unknown_in_record(Values values, const Scene& scene) const override {
    const Eigen::Index frames = scene.force.size();
    // of the reference: -1
    const auto time_of = [&](Eigen::Index t) { return t < 0 ? scene.start_time : scene.time[t]; };
    const auto slope_before = [&](Eigen::Index t) {
      const double interval = time_of(t) - time_of(t - 1);
      return interval > 0.0 ? (scene.force[t] - (t > 0 ? scene.force[t - 1] : 0.0)) / interval : 0.0;
    };
    const auto kink_at = [&](Eigen::Index t) {
      return t < 0 || t + 1 >= frames ? INFINITY : std::abs(slope_before(t + 1) - slope_before(t));
    };
    Eigen::VectorXd unknown(frames);
    for (Eigen::Index t = 0; t < frames; ++t) {
      const double time = scene.time[t] - values[0];
      Eigen::Index after = 0;
      while (after + 1 < frames && scene.time[after] < time) ++after;
      const double from_before = time - time_of(after - 1), to_after = time_of(after) - time;
      if (from_before < 0.0 || to_after < 0.0)
        unknown[t] = std::abs(slope_before(after)) * std::max(-from_before, -to_after);
      else if (const double kink = std::min(kink_at(after - 1), kink_at(after));
               from_before + to_after > 0.0 && std::isfinite(kink))
        unknown[t] = from_before * to_after / (from_before + to_after) * kink;
      else
        unknown[t] = 0.0;
    }
    return unknown;
  }
  [[nodiscard]] bool acts_on_curves() const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> force_delay() { return std::make_shared<ForceDelay>(); }

}  // namespace imic3d::loop
