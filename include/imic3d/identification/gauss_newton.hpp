#pragma once
// Identification of the material parameters: Gauss-Newton on the images, Eqs 10-14.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <functional>
#include <string>
#include <vector>

#include "imic3d/core/parameter.hpp"
#include "imic3d/identification/covariance.hpp"
#include "imic3d/identification/forward_model.hpp"

namespace imic3d::identification {

/// What the parameters are judged by.
enum class Functional {
  force_driven,         ///< images of the force-driven simulation: Eq. 16, alpha -> 0 or (`alpha` > 0) finite
  displacement_driven,  ///< images and reaction force of the DIC-driven simulation, each weighted by its noise
  combined,             ///< images of the force-driven, reaction force of the DIC-driven simulation
  /// Eq. 2: images and equilibrium at the nodes without external force (equilibrium_gap.hpp)
  equilibrium_gap
};
[[nodiscard]] Functional functional_from(const std::string& name);  ///< throws InputError

/// Where dU/dLambda and dR/dLambda come from.
enum class Sensitivities {
  direct,    ///< direct differentiation of the simulation (mechanics/equilibrium.hpp); not of hex8s elements
  perturbed  ///< differences to simulations with one parameter changed each, as concurrent groups
};

struct GaussNewtonOptions {
  Functional functional = Functional::force_driven;
  double alpha = 0.0;  ///< penalty parameter of Eq. 16; 0: the limit, images only judge
  double eta = 1e-3;   ///< eta_c of Eq. 13
  int max_iterations = 20;
  /// sigma of F - R [force]: the load cell's and that of `reaction_noise`; where ParameterNoise::difference is not
  /// known
  double force_noise = 1.0;
  Sensitivities sensitivities = Sensitivities::direct;
  double perturbation = 1e-3;  ///< relative step of the perturbed simulations
  double largest_step = 0.5;   ///< largest relative change of a parameter in one iteration
  /// load increments between two frames up to which what fewer of them err by is taken off (FinerIncrements); 0: it is
  /// not
  int most_increments = 0;
  /// usual size of each parameter, by which steps are measured where its value is smaller
  std::vector<double> scale{};
  NoiseModel noise_model{};  ///< what the covariance is made of
};

/// One stage: which parameters move and which frames judge them.
struct Stage {
  std::vector<int> free;    ///< indices of the parameters
  std::vector<int> frames;  ///< indices in the record, ascending
};

/// One iteration as it is reported.
struct Iterate {
  std::vector<double> parameters;
  /// Eq. 13, of the step that led here (0 at the start, and where the force was weighed anew or load increments were
  /// taken off)
  double eta = 0.0;
  /// distance of the simulated surface from the DIC [px], over the stage's frames
  double displacement_rms = 0.0;
  double image_rms = 0.0;  ///< grey-level residual [grey level]
  double force_rms = 0.0;  ///< F - R, where the functional contains it [force]
  double cost = 0.0;       ///< the weighted sum of squares that step control watches
  int frames = 0;          ///< frames of the stage that could be simulated
  /// load increments between two frames: those that the simulation takes, or FinerIncrements::number
  int increments = 1;
  std::string message;  ///< why not all of them, if so
};

/// Steps of Eq. 10 that led through `iterates`: the start is none, nor is what changed in place (weights, load
/// increments).
[[nodiscard]] int steps_taken(const std::vector<Iterate>& iterates);

/// Simulations at some parameters: the nominal one and, per free parameter, the derivative of what is observed.
struct Linearisation {
  int frames = 0;  ///< of the record, that could be simulated
  /// displacement of the seen faces [unknowns x frames, length]
  Eigen::MatrixXd surface;
  /// its derivative by each free parameter [unknowns x frames]
  std::vector<Eigen::MatrixXd> sensitivity;
  std::vector<Eigen::VectorXd> force_sensitivity;  ///< dR/dLambda [frames]
  Eigen::VectorXd reaction;                        ///< R of the DIC-driven simulation [frames, force]
  std::string message;                             ///< why not all frames, if so
};

/// What is added to the displacement and the reaction of a Linearisation.
struct Addition {
  Eigen::MatrixXd surface{};   ///< [unknowns x frames, length]
  Eigen::VectorXd reaction{};  ///< [frames, force]
};

/// What the load increments of a simulation err by, which goes with their length: 2, 4, 8, ... times as many are taken,
/// at the same parameters, and what infinitely many would add follows from the last two. It ends where that moves no
/// parameter by more than eta_c or 0.3 standard deviations. At other parameters it changes by what the first two
/// numbers alone tell, which is little.
struct FinerIncrements {
  int number = 0;                  ///< between two frames, the finest that was simulated; 0: nothing is known
  std::vector<double> parameters;  ///< at which it was found
  Addition endless{};              ///< what infinitely many add
  Addition first{};                ///< the same by the first two numbers, at these parameters
  /// by which the last doubling moved each free parameter, where that is more for one of them; else empty
  Eigen::VectorXd unsure{};
};

/// How sure the parameters are, by noise.
struct ParameterNoise {
  std::vector<double> parameters;  ///< at which it was found; empty: it was not yet
  Covariance covariance;           ///< of the free parameters
  /// standard deviation of F - R [frames, force] by the draws, which weighs it from then on; empty:
  /// GaussNewtonOptions::force_noise
  Eigen::VectorXd difference;
  /// why the draws of NoiseModel could not be taken through the simulation, so that the covariance is that without
  /// draws; else empty
  std::string unknown;
};

struct StageResult {
  std::vector<Iterate> iterates;  ///< the first is the start
  Covariance covariance;          ///< of the free parameters
  bool converged = false;
  FinerIncrements finer;
  Eigen::VectorXd difference;  ///< ParameterNoise::difference
  std::string unknown_noise;   ///< ParameterNoise::unknown
  std::string message;         ///< what the user should know: frames that could not be simulated
};

/// M_Lambda and b_Lambda of Eqs 10-12 in units of the noise, and the sums that are reported.
struct NormalEquations {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd right;
  double cost = 0.0, squares = 0.0, pixels = 0.0, distance = 0.0, force = 0.0;
  int frames = 0;
};

/// Where a stage stands after an iteration: all that the next one depends on, beside the forward model's solutions.
struct StagePoint {
  std::vector<Iterate> iterates;  ///< the first is the start, the last is where it stands
  Linearisation linear;           ///< there
  NormalEquations normal;         ///< there
  FinerIncrements finer;          ///< its part in `linear`
  ParameterNoise noise;           ///< of the stage, near there
  bool converged = false;
};

/// How a stage is kept and taken up again.
struct Continuation {
  /// goes on from here; from the parameters if not given
  const StagePoint* from = nullptr;
  /// called on every rank after each iteration, the start included
  std::function<void(const StagePoint&)> reached = {};
};

/// Runs one stage from `parameters` and leaves the result there. With direct sensitivities and a simulation under
/// forces it begins where the reaction of the DIC-driven simulation is nearest to the measured force (Sec. 2.2: their
/// ratio calibrates): a coarse start, which Eqs 10-13 do not depend on. The last step, below eta_c, is not simulated:
/// what it changes follows from the sensitivities; nor, displacement-driven, is one of a few eta_c of which
/// second-order terms, as large as the step before shows them, are below a thousandth of eta_c. Once converged it goes
/// on with the force weighed by ParameterNoise::difference, then with FinerIncrements taken off, found anew as long as
/// the parameters have moved since by more than the root of eta_c: it goes with them, so that this moves them by
/// another eta_c. `information` describes each parameter (bounds). `report` is called after each iteration. Collective
/// over `world`. Throws std::invalid_argument for direct sensitivities of a model that is not differentiable().
StageResult gauss_newton(Communicator world, ForwardModel& model, const ImageData& images,
                         const std::vector<ParameterInfo>& information, const Stage& stage,
                         const GaussNewtonOptions& options, std::vector<double>& parameters,
                         const std::function<void(const Iterate&)>& report = {}, const Continuation& continuation = {});

/// What one step of Eq. 10 does with all parameters of stages that found them one after another, each as if the others
/// were known.
struct FreedAtOnce {
  Eigen::VectorXd step;  ///< of each free parameter
  ParameterNoise noise;
};
/// `all`: the parameters and frames of all stages; `finer`: of the last one. Empty where nothing can be simulated.
/// Collective over `world`. Throws ConvergenceError where derivatives are not found.
FreedAtOnce free_at_once(Communicator world, ForwardModel& model, const ImageData& images, const Stage& all,
                         const GaussNewtonOptions& options, const std::vector<double>& parameters,
                         const FinerIncrements& finer);

/// A test on one of two meshes.
struct OnMesh {
  ForwardModel& model;      ///< its record is that mesh's
  const ImageData& images;  ///< judged on its surface
  const Path& path;         ///< simulated there, by what drives the other mesh alike
};
/// By what one step of Eq. 10 moves the free parameters of `stage` from what they are on a coarse mesh to what they are
/// on a fine one [free]; empty where nothing can be simulated. `onto`: displacement of the fine surface from that of
/// the coarse one. `finer`, `difference`: of that stage, on the coarse mesh. Collective over `world`. Throws
/// ConvergenceError where derivatives are not found.
Eigen::VectorXd moved_by_mesh(Communicator world, const OnMesh& coarse, const OnMesh& fine,
                              const Eigen::SparseMatrix<double>& onto, const Stage& stage,
                              const GaussNewtonOptions& options, const std::vector<double>& parameters,
                              const FinerIncrements& finer, const Eigen::VectorXd& difference);

/// Noise of the reaction R of a DIC-driven simulation [force] that comes from the noise of the displacement prescribed
/// on the ends: the rms reaction to `driving`, random displacements of the surface [unknowns x draws, length], from
/// rest, with the law `parameters`, elastic. Where the specimen yields its tangent is lower and so is the noise:
/// an upper bound there. What is common to neighbouring frames (noise of the reference) counts as if it were not.
[[nodiscard]] double reaction_noise(Communicator world, ForwardModel& model, const Eigen::MatrixXd& driving,
                                    const std::vector<double>& parameters);

/// The rigid motions of the deformed surface that a simulation under `control` leaves to the images [unknowns x modes].
/// Under forces those in the plane (2 translations, rotation), and where cameras see them also the translation along z
/// and the rotations about x and y, at the middle of the seen faces; driven by the ends only the latter three. For
/// small angles.
[[nodiscard]] Eigen::MatrixXd rigid_modes(const Specimen& specimen, Control control,
                                          const Eigen::VectorXd& displacement);

/// The displacement of the seen faces [unknowns x frames, length] turned back about axes in their plane, where cameras
/// see how they lean: that which drives ends along x and y, the same through the thickness. Simulations stay upright
/// (Specimen::displacement_dofs), and fit_rigid_motion leans them.
[[nodiscard]] Eigen::MatrixXd without_leaning(const Specimen& specimen, Eigen::MatrixXd displacement);

/// Moves a path by the rigid motion that brings it nearest to the DIC displacement in the norm of M.
void fit_rigid_motion(const Specimen& specimen, Control control, const Eigen::SparseMatrix<double>& M,
                      const Eigen::MatrixXd& dic, Path& path);

}  // namespace imic3d::identification
