#pragma once
// Effects of the test as the case file declares them: planted in a virtual test, or part of the declared model.

#include <nlohmann/json_fwd.hpp>

#include "imic3d/app/setup.hpp"
#include "imic3d/loop/effect.hpp"
#include "imic3d/loop/one_camera.hpp"

namespace imic3d::app {

/// Quantities of each effect that a test with these cameras and experiments may have, by its key, for io::CaseChecks.
[[nodiscard]] std::map<std::string, std::vector<std::string>> effect_quantities(const io::Case& test);

/// Whether a camera has errors of its own that its rig takes for a motion in space: it is one of several on its face,
/// one of them a perspective one.
[[nodiscard]] bool is_one_of_several(const io::CameraCase& camera, const std::vector<io::CameraCase>& cameras);

/// A scene of unit size: names, units and null values of the effects do not depend on it.
[[nodiscard]] loop::Scene unit_scene();

/// Throws InputError if the case declares effects, which `command` would have to ignore.
void refuse_effects(const io::Case& test, const std::string& command);

/// The declared effects as the loop's models take them: those on the grey levels, or all others.
[[nodiscard]] std::vector<loop::DeclaredEffect> declared_effects(const io::Case& test, bool of_light = false);

/// The effects that a virtual test has. Frames are those after the reference, from 0.
class PlantedEffects {
 public:
  /// The scene's lengths are those of the declared specimen. Throws InputError: an effect that cannot be planted
  /// (numerics), that the specimen lacks the thing for, or that is beyond its bounds.
  explicit PlantedEffects(const io::Case& test);
  PlantedEffects(const PlantedEffects&) = delete;
  PlantedEffects& operator=(const PlantedEffects&) = delete;

  /// How the generator's specimen is to be made.
  [[nodiscard]] loop::MeshChange change() const;
  /// Beyond the prescribed displacement along the axis in a frame of `simulate` (from 1), of a node of the loaded end
  /// at depth z [length]; empty if nothing is.
  [[nodiscard]] std::function<double(int frame, double z)> beyond() const;

  /// Once it is simulated: the force [frames]. Checks bounds that depend on it.
  void simulated(const Eigen::VectorXd& force);
  /// The key of an effect on what cameras of a face (front, back; empty: the only one) show of the displacement; empty
  /// if there is none.
  [[nodiscard]] std::string seen(const std::string& face) const;
  /// What a telecentric camera shows of its face [quad4] beyond the displacement in the plane [2n x frames, length].
  [[nodiscard]] Eigen::MatrixXd seen_beyond(const std::string& face, const mesh::Mesh& mesh,
                                            const Eigen::MatrixXd& displacement, const Eigen::Matrix2d& pixels,
                                            const Eigen::Vector2d& axis_of_lens) const;
  /// Whether a camera, one of several, has an effect of its own.
  [[nodiscard]] bool has_own(const std::string& camera) const;
  /// What it adds in a frame to the pixels of the nodes of its face that have moved by `motion` [n x 2, px].
  [[nodiscard]] loop::Pixels pixels_beyond(const loop::Sight& sight, const mesh::Mesh& surface, int frame,
                                           const loop::Pixels& motion) const;
  /// Whether there is an effect on the grey levels.
  [[nodiscard]] bool lit() const;
  /// What becomes of the grey levels that a camera sees of a point of its face that is at `point` in the reference and
  /// at `now` in a frame (-1: the reference).
  [[nodiscard]] loop::Light light(const std::string& camera, int frame, const Eigen::Vector2d& point,
                                  const Eigen::Vector2d& now) const;
  /// The force as it is recorded [frames, force], and in the frames before loading, where it is `still`.
  [[nodiscard]] Eigen::VectorXd recorded(Eigen::VectorXd force) const;
  [[nodiscard]] double recorded_still(double still) const;
  /// For truth.json: effect -> quantity -> {value, unit}.
  [[nodiscard]] nlohmann::json truth() const;

 private:
  struct Planted {
    std::shared_ptr<const loop::Effect> effect;
    std::string key, face;  // of whose cameras it is: front, back; empty: of all
    std::string camera;     // that has it alone; empty: the face's
    std::vector<double> values;
  };
  /// Of a face's cameras, or of one of several `camera`s.
  void plant(const std::shared_ptr<const loop::Effect>& effect, const std::string& face,
             const std::string& camera = "");
  void check_bounds(bool with_force) const;

  const io::Case& test_;
  loop::Scene scene_;
  mesh::Mesh declared_;  // that the scene points to
  std::vector<Planted> planted_;
};

}  // namespace imic3d::app
