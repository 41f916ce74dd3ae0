#pragma once
// The light of a test: what the correlation leaves of the grey levels, before the mechanics are looked at.

#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "imic3d/app/observation.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/light_experiment.hpp"
#include "synthetic_images.hpp"

namespace imic3d::app {

/// Throws InputError: an effect on the grey levels that is declared beyond its bounds, or for a test without images.
void check_light_effects(const io::Case& test, const mesh::Mesh& surface);

struct LightFindings {
  loop::Verdict verdict = loop::Verdict::nothing_found;
  std::string sentence;
  bool gain_or_offset = false;  ///< found, or most of what was found is a gain and an offset of each frame
  bool gradient = false;        ///< found, or most of it grows linearly over the surface beside
  /// of each face, over the cameras' noise [frames]; empty where nothing was found
  std::vector<Eigen::VectorXd> frame_noise;
  /// of the grey levels that the correlation leaves, over the frames [grey level]
  double rms = 0.0;
  nlohmann::json json;  ///< section `light` of result.json
};

/// Closes the loop on the light of the first `frames` frames that were correlated. `synthetic` correlates images of the
/// declared model's motion and shows them; it is called once. Collective.
[[nodiscard]] LightFindings look_at_light(const Observation& seen, const io::Case& test, int frames,
                                          const std::function<void(const ImageShown&)>& synthetic,
                                          const loop::LoopOptions& options,
                                          const std::function<void(const std::string&)>& say);

}  // namespace imic3d::app
