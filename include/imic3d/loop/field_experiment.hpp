#pragma once
// Measured displacement fields of a surface with the force of each frame, seen through the DIC-driven simulation.

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <functional>
#include <map>
#include <memory>
#include <random>

#include "imic3d/core/groups.hpp"
#include "imic3d/identification/forward_model.hpp"
#include "imic3d/loop/effect.hpp"
#include "imic3d/loop/experiment.hpp"
#include "imic3d/loop/one_camera.hpp"
#include "imic3d/loop/surface_modes.hpp"

namespace imic3d::loop {

/// A face of the specimen and the rig, one camera or several, that looks at it.
struct FieldFace {
  std::string name = "front";  ///< or back
  mesh::Mesh surface;          ///< quad4 [n nodes]
  /// of a node's displacement that the rig sees: x, y, with several directions of sight z
  int components = 2;
  /// the covariance of its displacement is noise^2 M^-1 (Eq. 14) [components * n square]
  Eigen::SparseMatrix<double> M;
  Eigen::Matrix2d pixels = Eigen::Matrix2d::Identity();  ///< d(pixel)/d(displacement) [px/length]
  /// where the optical axis meets the specimen [length]
  Eigen::Vector2d axis_of_lens = Eigen::Vector2d::Zero();
  std::vector<Sight> sights{};  ///< of each camera, where there are several and three components
  /// standard deviation of each frame's noise over FieldData::noise [frames]; empty: 1
  Eigen::VectorXd frame_noise{};
  [[nodiscard]] Eigen::Index unknowns() const { return components * surface.nodes.rows(); }
};

/// What was measured, whatever program correlated the images. Displacements are those of the faces one after the other,
/// node by node [unknowns]: with one face and two components [2n].
struct FieldData {
  struct Reading {
    double value, deviation;  ///< mean and its standard deviation [force]
  };
  std::vector<FieldFace> faces;  ///< as Specimen::faces
  double noise = 1.0;            ///< of one frame, in the unit that goes with M
  int references = 1;  ///< images whose mean displacements count from, and whose noise all frames have in common
  Eigen::MatrixXd displacement;  ///< [unknowns x frames, length]
  Eigen::MatrixXd driving;       ///< the same, smoothed: prescribed on the ends
  /// what made `driving` of `displacement`, linear [unknowns x first frames]
  std::function<Eigen::MatrixXd(Eigen::MatrixXd)> smooth;
  /// What the correlation would measure [unknowns x frames] if the faces of a specimen, of another mesh, moved by U
  /// [its unknowns x frames]: images are made of the references and correlated, without noise. Collective. Not given:
  /// no bias is learned.
  std::function<Eigen::MatrixXd(const identification::Specimen& specimen, const Eigen::MatrixXd& U)> correlate;
  std::vector<int> frames;  ///< numbers, as the user knows them
  /// places of the frames that are never fitted: what is whitened over time holds nothing of them in the others
  std::vector<int> held_out{};
  Eigen::VectorXd time, force;  ///< [frames]
  /// of the virgin state; of what the displacement counts from (Scene)
  double start_time = 0.0, reference_time = 0.0;
  /// what the load cell reads in frames in which nothing has moved yet, where it is known how well it does
  std::optional<Reading> force_at_rest{};
  double force_noise = 1.0;  ///< standard deviation of the load record [force]; infinity: there is none
  bool images = true;        ///< this program correlated the images, and interpolated their grey levels
  /// What made `noise` of the displacement of the frames at rest [unknowns x at_rest]: few numbers of a coarse mesh
  /// tell it to some percent only, which is part of the null. Not given: `noise` is known.
  std::function<double(const Eigen::MatrixXd& U)> noise_at_rest;
  int at_rest = 0;
  [[nodiscard]] Eigen::Index unknowns() const {
    Eigen::Index all = 0;
    for (const auto& face : faces) all += face.unknowns();
    return all;
  }
};

/// How the specimen is to be made differently from what is declared.
struct MeshChange {
  /// moves a node of the declared 2D mesh (or its column)
  std::function<void(Eigen::Vector2d&)> place{};
  std::function<double(const Eigen::Vector3d&)> section{};         ///< factor of a cell by its middle
  std::function<double(const Eigen::Vector3d&)> initial_strain{};  ///< of a cell by its middle
  double thickness = 1.0;                                          ///< factor of the declared one
  Numerics numerics{};                                             ///< of the mesh, beyond the declared ones
};

/// A number for each cell from its middle [cells].
[[nodiscard]] Eigen::VectorXd of_cells(const mesh::Mesh& mesh,
                                       const std::function<double(const Eigen::Vector3d&)>& of_point);

/// Part of the thickness with which a simulation in space is one of plane stress: what it has beyond that goes with the
/// thickness squared.
constexpr double thin = 0.05;

struct DeclaredModel {
  std::shared_ptr<const material::FiniteStrainLaw> law;
  std::vector<ParameterInfo> information;  ///< of the law's parameters, in its order
  std::vector<double> values, priors;      ///< priors: standard deviations, 0 where nothing is known
  std::vector<char> free;                  ///< declared unknown
  std::vector<ParameterInfo> lacking;      ///< parameters of the effects of the law that are not declared
  /// The declared law with these effects beside its own; `in_space`: not that of plane stress.
  std::function<std::shared_ptr<const material::FiniteStrainLaw>(const std::vector<std::string>& effects,
                                                                 bool in_space)>
      extended;
  std::function<identification::Specimen(const MeshChange&)> specimen;
  int increments = 1;                              ///< between two frames
  int groups = 0;                                  ///< of ranks
  std::vector<DeclaredEffect> effects{};           ///< no candidates any more
  std::function<std::string(std::string)> unit{};  ///< `length`, `force` and `time` as the case names them
};

struct FieldOptions {
  /// numbers that the residual displacement of each frame is written in: half as many smooth modes on either side of
  /// the checkerboard
  int modes = 100;
};

/// The residual of each frame: the measured minus the simulated displacement in smooth modes on the two colours of a
/// checkerboard (SurfaceModes), and the measured force minus the reaction before any scaling (the dual residual). What
/// lies beyond the modes is left out. The noise of the reference, common to all frames, is whitened over time.
///
/// Cameras on both faces: each face has its own modes, blind to rigid motions of its rig, and its own channel. The ends
/// move alike at every depth, by the mean of the faces: in what they differ they are data. What a camera adds is a
/// candidate for each face.
class FieldExperiment final : public Experiment {
 public:
  FieldExperiment(Communicator world, FieldData data, DeclaredModel model, const FieldOptions& options = {});
  ~FieldExperiment() override;

  [[nodiscard]] const std::vector<Parameter>& parameters() const override { return parameters_; }
  [[nodiscard]] const std::vector<Candidate>& candidates() const override { return candidates_; }
  [[nodiscard]] const std::vector<Datum>& data() const override { return data_; }
  [[nodiscard]] std::vector<int> frame_numbers() const override { return measured_.frames; }
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_near(const std::vector<double>& values,
                                                            std::vector<std::vector<double>> sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_disturbed(const std::vector<double>& values,
                                                                 std::vector<std::vector<double>> sets,
                                                                 double times) override;
  [[nodiscard]] bool takes_simulations(int parameter) const override;
  void learn_bias(const std::vector<double>& values) override;
  /// What was learned, in units of the noise [N].
  [[nodiscard]] Eigen::VectorXd bias() const { return whitened(bias_->displacement, bias_->force); }
  [[nodiscard]] Doubt doubt() const override;
  /// What a simulation in space has more than that of plane stress, in units of the noise [N], as it was learned and is
  /// taken off; empty where none was made.
  [[nodiscard]] const Eigen::VectorXd& in_space() const { return bias_->in_space; }
  [[nodiscard]] std::shared_ptr<const Learned> learned() const override {
    return measured_.correlate ? bias_ : nullptr;
  }
  void put_back(const std::shared_ptr<const Learned>& learned) override {
    if (const auto bias = std::dynamic_pointer_cast<const Bias>(learned)) bias_ = bias;
  }
  [[nodiscard]] std::vector<Eigen::MatrixXd> learned_numbers() const override;
  void learn_again(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& numbers) override;
  [[nodiscard]] Eigen::MatrixXd noise(const std::vector<double>& values, int draws) override;
  [[nodiscard]] Eigen::VectorXd displacement_of(const Eigen::VectorXd& frame) const override;
  [[nodiscard]] Eigen::VectorXd lengths_of(const Eigen::VectorXd& displacement) const override;
  [[nodiscard]] std::string channel_name(int channel) const override {
    return measured_.faces[static_cast<std::size_t>(channel)].name;
  }

  [[nodiscard]] const FieldData& measured() const { return measured_; }
  /// Of the first face.
  [[nodiscard]] const Scene& scene() const { return faces_.front().scene; }
  /// Measured - predicted displacement [unknowns x frames, length] and force [frames] with these values, not whitened.
  [[nodiscard]] std::pair<Eigen::MatrixXd, Eigen::VectorXd> unwhitened(const std::vector<double>& values);
  /// Simulations made so far, in series of all frames.
  [[nodiscard]] int simulations() const { return simulations_; }
  /// What the groups of ranks did with their time: in the series of the test, and in those of synthetic tests.
  /// Collective.
  [[nodiscard]] std::map<std::string, std::vector<GroupTime>> group_times() const;

 private:
  struct Bias final : Learned {
    Eigen::MatrixXd displacement;
    Eigen::VectorXd force;
    /// Standard deviations of what is not known of it, in units of the noise, a column for each thing that is unknown
    /// [N x things]: of the mesh, of the increments; then what ends that move unevenly at depth would add, where that
    /// is not seen.
    Eigen::MatrixXd doubt;
    Eigen::Index of_numerics = 0;  // columns of mesh and increments
    // what a simulation in space has more than that of plane stress, in units of the noise [N]; empty where none was
    // made
    Eigen::VectorXd in_space{};
    Bias(std::vector<double> values, Eigen::MatrixXd u, Eigen::VectorXd f)
        : displacement(std::move(u)), force(std::move(f)) {
      at = std::move(values);
    }
  };
  struct Simulation;  // what one series is made of
  struct Variant;     // a specimen with its forward model
  struct Prediction {
    Eigen::MatrixXd displacement;
    Eigen::VectorXd force;
  };

  struct Series;  // what comes of it
  [[nodiscard]] std::vector<Series> simulate(const std::vector<Simulation>& wanted);
  struct Key;  // what a specimen with its forward model is made for
  Variant& variant(const Key& key);
  [[nodiscard]] MeshChange mesh_of(const Key& key) const;
  [[nodiscard]] Simulation simulation_of(const std::vector<double>& values, const Eigen::MatrixXd& driving) const;
  /// The simulations that a prediction is made of, and their weights: first that with the declared numerics. What other
  /// numerics change is a difference of two that the declared model's motion, smoothed ten times more, drives: of two
  /// under the measured ends it would hold their noise, answered by another mesh, and be found again in the residual.
  [[nodiscard]] std::vector<std::pair<double, Simulation>> simulations_of(const std::vector<double>& values,
                                                                          const Eigen::MatrixXd& driving) const;
  /// What a measured displacement was before the camera added its errors. These are taken at the declared model's
  /// motion: at the measured one they would hold its noise, and be found again in the residual.
  [[nodiscard]] Eigen::MatrixXd true_motion(const std::vector<double>& values, Eigen::MatrixXd driving) const;
  /// What camera and load cell make of displacement and force.
  [[nodiscard]] Prediction observed(const std::vector<double>& values, Prediction true_one) const;
  /// What effects of the loading with these values add to the prescribed displacement of the ends [prescribed x
  /// frames]; empty without them.
  [[nodiscard]] Eigen::MatrixXd driven_beyond(const Variant& with, const std::vector<double>& loading) const;
  /// What a camera on one face does not see of ends that are cut from a longer specimen: that they move at depth
  /// otherwise than on the face, along the axis and across (a parabola over the depth that is greatest in the middle of
  /// the thickness, in parts of the elongation), and that the rest of the specimen, which does not grow thinner alike,
  /// pulls at them through the thickness (half a sine, in parts of the mean axial stress); over the width a polynomial
  /// of Legendre. One of so many shapes.
  [[nodiscard]] identification::Direction uneven_end(const Variant& with, int shape) const;
  [[nodiscard]] int uneven_shapes() const;
  static constexpr int uneven_degree = 4;
  static constexpr double uneven_motion = 0.01, uneven_traction = 0.03, uneven_thickness = 0.4;
  struct Tangent;  // what a series is differentiated by
  /// The prediction without camera and load cell, and its derivatives. Without forces where the model could not follow.
  [[nodiscard]] std::pair<Prediction, std::vector<Prediction>> differentiate(const std::vector<double>& values,
                                                                             const std::vector<Tangent>& tangents);
  /// What each number of the law changes where it is off by a thousandth, and those of the direction in which it flows
  /// (Hill's ratios, friction and dilatancy) by the elastic strain, a thousandth at least: what theories of the same
  /// law differ by [N each], in units of the noise. The elastic strain is that of the mean stress under the largest
  /// `reaction` [frames] with the declared E. Collective.
  [[nodiscard]] std::vector<Eigen::VectorXd> theory_in_doubt(const std::vector<double>& values,
                                                             const Eigen::VectorXd& reaction);
  /// How the prediction moves with the displacement that drives the ends [unknowns x frames]: by the derivatives of the
  /// simulation; by simulations.
  [[nodiscard]] std::vector<Prediction> responses(const std::vector<double>& values,
                                                  const std::vector<Eigen::MatrixXd>& changes);
  [[nodiscard]] std::vector<Prediction> differences(const std::vector<double>& values,
                                                    const std::vector<Eigen::MatrixXd>& changes);
  [[nodiscard]] std::vector<Prediction> predict(const std::vector<std::vector<double>>& sets,
                                                const std::vector<const Eigen::MatrixXd*>& drivings);
  [[nodiscard]] Eigen::VectorXd residual_of(const Prediction& p) const;
  [[nodiscard]] Eigen::VectorXd whitened(const Eigen::MatrixXd& displacement, const Eigen::VectorXd& force) const;
  [[nodiscard]] std::span<const double> values_of(std::size_t effect, const std::vector<double>& values) const;
  void make_scene();
  void make_candidates();
  /// The scene that an effect is told of.
  [[nodiscard]] const Scene& scene_of(std::size_t effect) const {
    return faces_[static_cast<std::size_t>(std::max(0, face_of_[effect]))].scene;
  }
  /// What the cameras show in frame t beyond a displacement U of all faces [unknowns].
  [[nodiscard]] Eigen::VectorXd seen_beyond(const std::vector<double>& values, Eigen::Index t,
                                            const Eigen::VectorXd& U) const;

  /// Draws of the noise of all frames, that of the references included [unknowns x frames], and of further frames as at
  /// rest [unknowns x rest].
  [[nodiscard]] std::pair<Eigen::MatrixXd, Eigen::MatrixXd> drawn_fields(
      const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>>& factor, std::mt19937_64& random,
      Eigen::Index rest = 0) const;

  struct Side {
    Scene scene;
    SurfaceModes modes;
    Eigen::Index first = 0;     // unknown
    Eigen::MatrixXd over_time;  // whitens S^2 + 11^T/references, S of frame_noise [frames x frames]
  };

  Communicator world_;
  FieldData measured_;
  DeclaredModel model_;
  std::vector<Side> faces_;
  Eigen::SparseMatrix<double> M_;  // of all faces
  std::vector<std::shared_ptr<const Effect>> effects_;
  std::vector<int> face_of_;        // whose rig an effect is of; -1: the specimen's, seen by all
  std::vector<std::size_t> first_;  // parameter of each effect
  std::vector<Parameter> parameters_;
  std::vector<Candidate> candidates_;
  std::vector<Datum> data_;
  bool differentiable_ = false;  // its series
  Eigen::MatrixXd motion_;       // of the faces under the declared model [unknowns x frames]
  Eigen::MatrixXd smooth_ends_;  // the same, smoothed ten times as what drives the ends is once
  // one more draw of the noise of what drives the ends [unknowns x frames]; empty until it is asked for
  Eigen::MatrixXd disturbance_;
  struct Groups;
  std::unique_ptr<Groups> groups_;
  struct SyntheticTests;
  /// Side by side; `driving_as_seen` [unknowns x frames] drives the ends of refined meshes, the measured ones those of
  /// the others.
  [[nodiscard]] SyntheticTests synthetic_tests(const std::vector<double>& values,
                                               const Eigen::MatrixXd& driving_as_seen);
  static constexpr int again = 4;
  /// What the noise of what drives the ends changes in the mean, the model not being linear in it: sim(d) - E sim(d +
  /// noise), from pairs of opposite draws.
  [[nodiscard]] std::optional<Prediction> second_order_of_noise(const std::vector<double>& values,
                                                                const Prediction& nominal);
  /// Parameters of effects that every test has a little of, and how much (standard deviation). Ends that are cut from a
  /// longer specimen do not move alike at every depth once it yields, which one face does not show: the middle's
  /// elongation is 0.3 to 0.5 % larger than the front's on plates with a hole that are 0.4 of their width thick, cut
  /// one to two thicknesses from the hole. Real images are not splines: those of two generators show 0.0004 to 0.0008
  /// px of interpolation's error.
  [[nodiscard]] std::vector<std::pair<std::size_t, double>> always_there() const;
  /// How often the mesh of a synthetic test is refined: in space twice would be 64 times the elements.
  [[nodiscard]] int refinements() const { return scene().plane ? 2 : 1; }
  /// Its increments over the declared ones.
  [[nodiscard]] int more_increments() const { return scene().plane ? 4 : 2; }
  /// The simulation with the section that `values` make.
  [[nodiscard]] Simulation with_section(Simulation one, const std::vector<double>& values) const;
  /// Relative change of the cells' section from one key to another [cells of `specimen`].
  [[nodiscard]] Eigen::VectorXd change_of_section(const identification::Specimen& specimen, const Key& from,
                                                  const Key& to) const;
  std::shared_ptr<const Bias> bias_;  // taken off the measured displacement and force
  int simulations_ = 0;
};

}  // namespace imic3d::loop
