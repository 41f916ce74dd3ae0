#pragma once
// An effect that a test may have and its declared model may lack: one small file each in src/loop/effects.

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "imic3d/loop/experiment.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::loop {

/// What the effects are told of the test. Positions and displacements are those of the surface's nodes in the
/// specimen's frame.
struct Scene {
  const mesh::Mesh* surface = nullptr;  ///< quad4 [n nodes]
  int components = 2;                   ///< of a node's displacement: x, y; 3 where several cameras see z too
  int axis = 1;                         ///< of the load
  bool plane = false;                   ///< plane stress
  /// in space, but the mesh ends at a plane of symmetry in the middle of the thickness: neither face moves otherwise
  /// than the other
  bool half = false;
  Eigen::Vector2d low, high;  ///< the surface's box [length]
  double element = 1.0;       ///< mean size of its elements [length]
  double thickness = 1.0;     ///< [length]
  /// below the front where what drives the ends was measured: of cameras on both faces the middle [length]
  double driven_depth = 0.0;
  bool has_hole = false;
  Eigen::Vector2d hole;         ///< centre of the hole [length]
  double radius = 0.0;          ///< of the hole [length]
  Eigen::VectorXd time, force;  ///< of the record [frames]
  double start_time = 0.0;      ///< of the last frame before the first
  /// of the reference, or the mean of several: what displacements and grey levels count from
  double reference_time = 0.0;
  Eigen::Matrix2d pixels;  ///< d(pixel)/d(displacement) [px/length]
  /// where the optical axis meets the specimen: the image's centre [length]
  Eigen::Vector2d axis_of_lens;
  double poisson = 0.3;  ///< declared
  /// of the surface between its ends [frames, length]; of a bar its strain [rows]
  Eigen::VectorXd elongation;
  /// elastic displacement for a force of one [components * n, length/force]
  Eigen::VectorXd elastic;
  bool images = true;      ///< the displacement comes of images that this program interpolates
  double dynamic = 255.0;  ///< largest grey level of the images

  [[nodiscard]] Eigen::Vector2d middle() const { return 0.5 * (low + high); }
  [[nodiscard]] double span(int direction) const { return high[direction] - low[direction]; }
  /// Clock time of frame t, from 0 at the start (t = -1) to 1 at the last frame.
  [[nodiscard]] double clock(Eigen::Index t) const { return t < 0 ? 0.0 : since(start_time, t); }
  /// Share of what drifts with the clock that frame t has more than the reference: 1 at the last frame.
  [[nodiscard]] double drifted(Eigen::Index t) const { return since(reference_time, t); }

 private:
  [[nodiscard]] double since(double start, Eigen::Index t) const {
    return (time[t] - start) / std::max(1e-300, time[time.size() - 1] - start);
  }
};

/// What a scene knows of the surface [quad4] alone: its box, the size of its elements and its largest hole.
void measure(Scene& scene, const mesh::Mesh& surface);

/// The coarse grid that says where on the surface something local is: the twelve places over its box that are nearest
/// to squares.
struct Places {
  Eigen::Vector2d low, size;  ///< corner of the first place, size of each [length]
  int columns = 1, rows = 1;
  explicit Places(const Scene& scene);
  [[nodiscard]] int count() const { return columns * rows; }
  [[nodiscard]] int of(const Eigen::Vector2d& point) const;  ///< the nearest one for points beyond the box
  [[nodiscard]] Eigen::Vector2d middle(int place) const;
};

/// What becomes of the grey levels about a point of the specimen in a frame: recorded = (1 - foreign) (gain grey +
/// offset) + foreign (mean + beneath + contrast * another speckle), and noise.
struct Light {
  double gain = 1.0, offset = 0.0;  ///< offset [grey level]
  double foreign = 0.0;             ///< share of the area whose speckle is another one than in the reference
  double beneath = 0.0;             ///< what that one is brighter than the mean [grey level]
  double contrast = 1.0;            ///< its contrast over the specimen's
  double noise = 1.0;               ///< standard deviation of the image noise over the reference's
  /// share of the variance of grey levels that pixels and interpolation do not resolve, in all frames and the reference
  double aliased = 0.0;
  /// share of the contrast that interpolation takes away where a frame has moved by half a pixel along x; as much along
  /// y
  double smeared = 0.0;
  /// share of the specimen's pixels that the exposure takes to the largest grey level, in all frames and the reference
  double saturated = 0.0;
};

/// How the simulation is made; the null effect leaves it as declared.
struct Numerics {
  int refinements = 0;        ///< of the mesh, beyond the declared ones
  int increments_factor = 1;  ///< times the declared load increments between two frames
  bool in_space = false;      ///< with elements through the thickness where plane stress is declared
  /// so large a part of it, in space: a small one is plane stress with the same elements
  double of_thickness = 1.0;
  auto operator<=>(const Numerics&) const = default;
};

/// An effect acts at one link of the chain; the functions of the other links leave things as they are. `values` are
/// those of its parameters, in the order in which they are declared. All are smooth in the values and do nothing at the
/// null values.
class Effect {
 public:
  struct Quantity {
    std::string name, unit, description;
    double null = 0.0;
    double step = 1e-3;  ///< of a finite difference
    double size = 0.0;   ///< that an engineer would care for: one to plant
    double lower, upper;
    bool shape = false;  ///< says how the effect acts, not how much: ParameterInfo::shape
    double scale = 0.0;  ///< of a shape: a usual size
    /// the record of a test on images or fields shows it in the frames at rest: FieldData::force_at_rest
    bool read_at_rest = false;
  };
  struct Description {
    std::string name;
    Link link;
    std::vector<Quantity> quantities;
    std::string sentence, confused_with, separated_by;
    std::vector<std::vector<double>> elsewhere{};  ///< of one that acts somewhere: Candidate::elsewhere
    bool changes_path = false;                     ///< Candidate::changes_path
  };
  using Values = std::span<const double>;

  virtual ~Effect() = default;
  /// Steps and bounds in the test's own units.
  [[nodiscard]] virtual Description describe(const Scene& scene) const = 0;
  /// Whether the test has what the effect acts on (a hole, a thickness that is simulated …).
  [[nodiscard]] virtual bool applies(const Scene&) const { return true; }

  /// Geometry: moves a point of the declared mesh (in the plane) to where it is.
  virtual void place(Values, const Scene&, Eigen::Vector2d& /*point*/) const {}
  /// Geometry and material: multiplies the section force of a cell whose middle is at `point` [length].
  [[nodiscard]] virtual double section(Values, const Scene&, const Eigen::Vector3d& /*point*/) const { return 1.0; }
  /// Whether that is all that it does: a series is differentiated by it.
  [[nodiscard]] virtual bool acts_on_section() const { return false; }
  /// Geometry: the thickness over the declared one. Where that is not simulated the motion is the same, and the force
  /// on the specimen so much larger.
  [[nodiscard]] virtual double thickness(Values) const { return 1.0; }
  /// Initial state: the elastic strain (axial, in the direction of the load) of a cell before the test.
  [[nodiscard]] virtual double initial_strain(Values, const Scene&, const Eigen::Vector3d& /*point*/) const {
    return 0.0;
  }
  /// Loading: displacement along the axis of a point of the loaded end, z above the front (below: negative), beyond
  /// what the cameras show at `driven_depth` [length].
  [[nodiscard]] virtual double driven(Values, const Scene&, int /*frame*/, double /*z*/) const { return 0.0; }
  /// Whether each rig of cameras has it for itself, on its face.
  [[nodiscard]] virtual bool of_each_camera() const { return false; }
  /// Whether, where several cameras see a face in three components, each of them has it for itself too (of_one_camera);
  /// of the light, each of several cameras.
  [[nodiscard]] virtual bool of_one_of_several() const { return false; }
  /// Camera: adds to `error` [components * n, length] what the camera shows of the displacement beyond the truth:
  /// measured - true, at the displacement `U` [components * n, length] of frame t.
  virtual void see(Values, const Scene&, int /*frame*/, const Eigen::VectorXd& /*U*/,
                   Eigen::VectorXd& /*error*/) const {}
  /// Light: changes what becomes of the grey levels about the point of the specimen that is at `point` in the reference
  /// and at `now` in a frame
  /// (-1: the reference itself).
  virtual void light(Values, const Scene&, int /*frame*/, const Eigen::Vector2d& /*point*/,
                     const Eigen::Vector2d& /*now*/, Light& /*light*/) const {}
  /// Record: turns the force on the specimen [frames] into the one that is recorded.
  virtual void record(Values, const Scene&, Eigen::VectorXd& /*force*/) const {}
  /// Record: standard deviation of what the effect leaves unknown of the force that is recorded in each frame [frames,
  /// force]; empty where it leaves nothing.
  [[nodiscard]] virtual Eigen::VectorXd unknown_in_record(Values, const Scene&) const { return {}; }
  /// Record of a uniform test: turns the recorded logarithmic strain of a bar [rows] into that of its material.
  virtual void gauge(Values, Eigen::VectorXd& /*strain*/) const {}
  /// Record of a uniform test: recorded engineering strain per engineering stress, of what gives way beside the bar.
  [[nodiscard]] virtual double gives_way(Values) const { return 0.0; }
  /// Whether it acts on uniform tests too, where there is no surface: on all alike.
  [[nodiscard]] virtual bool acts_on_curves() const { return false; }
  /// Whether each of several groups of uniform tests has it for itself, as one that was measured on another machine.
  [[nodiscard]] virtual bool of_each_group() const { return false; }
  /// Numerics: what the simulation is made of with the effect at one; a prediction between is interpolated.
  virtual void numerics(Numerics&) const {}
  /// Links of the chain that ask for a simulation of their own.
  [[nodiscard]] virtual bool changes_simulation(const Scene&) const { return false; }
};

/// What an effect is called that one group of uniform tests has for itself.
[[nodiscard]] std::string in_group(const std::string& effect, const std::string& group);

/// An effect's name as a key of the case file: `force zero` is `force_zero`.
[[nodiscard]] std::string key_of(std::string name);

/// A quantity of an effect that the declared model contains.
struct DeclaredEffect {
  std::string effect, quantity;  ///< the former as `key_of` writes it
  std::optional<double> value, lower, upper;
  bool free = false;
  /// standard deviation of what is known beforehand, in units of Quantity::size; 0: nothing is
  double prior = 0.0;
};

/// All effects that act outside the law but on the grey levels, in the order of the links.
[[nodiscard]] std::vector<std::shared_ptr<const Effect>> effects();
/// Those on the grey levels.
[[nodiscard]] std::vector<std::shared_ptr<const Effect>> light_effects();
/// Both.
[[nodiscard]] std::vector<std::shared_ptr<const Effect>> all_effects();

}  // namespace imic3d::loop
