#include "effects.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace imic3d::loop {

double begun(const Scene& scene, int t, double onset) {
  const double since = (scene.clock(t) - onset) * static_cast<double>(scene.time.size());  // [frames]
  return 1.0 / (1.0 + std::exp(-15.0 * since));
}

std::vector<std::vector<double>> moments(const Scene& scene, double last, Eigen::Index most) {
  const Eigen::Index frames = scene.time.size(), each = 1 + (frames - 1) / most;
  std::vector<std::vector<double>> all;
  for (Eigen::Index t = 0; t < frames; t += each)
    if (const double between = 0.5 * (scene.clock(t - 1) + scene.clock(t)); between <= last) all.push_back({between});
  return all;
}

std::vector<std::shared_ptr<const Effect>> effects() {
  return {coarse_mesh(),  large_increments(),    interpolation_bias(), force_gain(),      force_offset(),
          force_delay(),  magnification_drift(), parallax(),           lens_distortion(), placement(),
          camera_bump(),  hole_radius(),         hole_offset(),        thickness(),       taper(),
          preload(),      residual_stress(),     misalignment(),       grip_slip(),       friction(),
          stiff_region(), strain_gain(),         strain_zero(),        compliance(),      group_gain()};
}

std::vector<std::shared_ptr<const Effect>> light_effects() {
  return {light_gain(), light_offset(), light_gradient(), saturation(), noise_level(), aliasing(), speckle_debonding()};
}

std::vector<std::shared_ptr<const Effect>> all_effects() {
  auto all = effects();
  for (auto& one : light_effects()) all.push_back(std::move(one));
  return all;
}

double near_hole(const Scene& scene, double distance) {
  const double edge = std::min({scene.hole[0] - scene.low[0], scene.high[0] - scene.hole[0],
                                scene.hole[1] - scene.low[1], scene.high[1] - scene.hole[1]});
  const double s = std::clamp((edge - distance) / (edge - scene.radius), 0.0, 1.0);
  return s * s * (3.0 - 2.0 * s);
}

std::string_view name(Link link) {
  constexpr std::array<std::string_view, 8> names = {"numerics", "record",        "camera",  "light",
                                                     "geometry", "initial state", "loading", "material"};
  return names[static_cast<std::size_t>(link)];
}

}  // namespace imic3d::loop
