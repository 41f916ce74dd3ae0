#pragma once
// Closing the loop: identify, find what is left unexplained, trace it, add it, identify again, report before and after.

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "imic3d/loop/fit.hpp"
#include "imic3d/loop/score.hpp"

namespace imic3d::loop {

struct LoopOptions {
  /// of the null ensemble, and as many for the covariance that it is weighed with
  int draws = 100;
  int additions = 3;  ///< effects added at most
  /// candidates tried non-linearly at a time; where none of them helps, the next ones
  int rivals = 4;
  std::vector<double> starts = {1.0, 0.9, 1.1};  ///< factors on the free parameters' declared values
  /// candidates that are not considered, by their names or as `key_of` writes these
  std::vector<std::string> leave_out{};
  std::vector<int> held_out;  ///< frames (places in the record) that are never fitted; chosen for a search, if empty
  bool search = true;         ///< false: the declared model is identified and judged, no candidate is considered
};

enum class Verdict { nothing_found, attributed, ambiguous, unexplained };
[[nodiscard]] std::string_view name(Verdict verdict);

/// chi = sqrt(mean square of the whitened residual); 1 where noise alone is left.
struct Misfit {
  double fitted = 0.0, held_out = 0.0;
  double null_fitted = 0.0, null_held_out = 0.0;  ///< 95 % quantiles under the null
  double images = 0.0, force = 0.0;               ///< of the channels, fitted frames
  double null_images = 0.0, null_force = 0.0;
  /// Of the white squares of a checkerboard on the surface when the parameters are those of the black ones (and the
  /// force), linearised at the fit, fitted frames; and its 95 % quantile under the null. 0 without a surface.
  double checkerboard = 0.0, null_checkerboard = 0.0;
  /// The same of each rig of cameras when the parameters are those of the others. What acts on that rig alone stays as
  /// it was found with it, and the mean motion of the ends, which drives the simulation, has its part of them. Empty
  /// where there is one rig.
  struct LeftOut {
    int channel = 0;
    double chi = 0.0, null = 0.0;
  };
  std::vector<LeftOut> cameras;
  Eigen::VectorXd frames;       ///< [frames]
  Eigen::VectorXd null_frames;  ///< 95 % quantile of each frame's under the null
};

/// What a model is judged by: what the procedure errs by under it, and what noise alone leaves.
struct Ground {
  std::shared_ptr<const Experiment::Learned> learned;
  Weight weight{{}, {}};
  Weight apart{{}, {}};     ///< the same of each channel by itself
  Eigen::MatrixXd null;     ///< whitened residuals of noise alone, before any fit [N x draws]
  Eigen::MatrixXd squares;  ///< the same for sums of squares
};

/// A candidate that a model was not tested for.
struct Untested {
  int candidate = 0;
  std::string reason;
  /// of a mark that no size within its bounds would lift out of the noise; without one where there is no mark
  std::optional<Score> score{};
};

/// A model: which candidates it contains, and what the data say of it.
struct Model {
  std::vector<int> added;  ///< candidates, in the order of their addition
  /// parameters of these that the data do not tell, at their null or usual values
  std::vector<int> idle;
  std::vector<int> released{};  ///< declared parameters that may go beyond their bounds
  Fit fit;
  /// free parameters of which the data show a combination alone, each of which may be anything
  std::vector<int> undetermined{};
  double of_law = 0.0;         ///< what the effects among these that act in the law took off chi^2
  Eigen::MatrixXd covariance;  ///< of the free parameters, from the null draws [free x free]
  Misfit misfit;
  Scores scores;  ///< of all other candidates; the energy alone until these are traced
  bool traced = false;
  Baselines baselines;      ///< of the same, in the declared model alone
  std::vector<int> others;  ///< the candidates that `scores` and `baselines` are about
  std::vector<Untested> untested;
  std::string message;  ///< why the model could not be fitted, if so
  std::shared_ptr<const Ground> ground;
};

/// Whether the data show a free parameter, and apart from the others.
[[nodiscard]] bool is_determined(const Model& model, int parameter);

/// A candidate that was tried.
struct Trial {
  int candidate = 0;
  Model model;
  bool visible = true;  ///< κ of its mark is large enough that its score tells of it
  /// nothing significant remains, and of several effects each has a size that is told from its null value
  bool sufficient = false;
  bool plausible = true;  ///< within its bounds, and its size agrees between the blocks of frames
  /// plausible but for the latter, as an effect is beside another one that is missing, too
  bool disagrees = false;
  std::string objection;  ///< why not plausible, or why not sufficient though nothing remains
  /// of chi^2 of the fitted frames, in the weights of the model that it was added to; 0 where it could not be fitted
  double drop = 0.0;
};

struct Round {
  std::vector<Trial> trials;
  std::vector<int> set;  ///< candidates that suffice alone
  bool kept = false;     ///< one of the trials stayed
};

/// The remainder: what the final model leaves, where and when.
struct Remainder {
  Eigen::VectorXd time;  ///< first singular vector over the frames [frames]
  double share = 0.0;    ///< of the whole square
  /// Length of the nodes' residual displacement over its rms under the null [surface nodes x frames], and what its
  /// largest value exceeds in one null test of a hundred. Empty without a surface.
  Eigen::MatrixXd map;
  double limit = 0.0;
  /// The residual displacement of the declared and of the final model, each number over its rms under the null of its
  /// model [unknowns x frames].
  Eigen::MatrixXd before, after;
  /// rms of the force residual under the null of the final model, in units of the force's noise [frames]; empty without
  /// a force
  Eigen::VectorXd force;
  Eigen::VectorXd mode;  ///< the displacement that goes with `time` [unknowns, length per unit of it]
};

struct Report {
  std::vector<char> held_out;  ///< per frame
  Model declared, final;
  std::vector<Round> rounds;
  Verdict verdict = Verdict::nothing_found;
  std::vector<int> set;        ///< candidates of the verdict: one, or those that cannot be told apart
  std::vector<int> named;      ///< all that were added on the way
  std::string sentence;        ///< for a test engineer
  std::vector<int> invisible;  ///< candidates that this test cannot see
  /// the declared model, where it leaves nothing significant with parameters beyond the bounds that hold them
  std::optional<Model> beyond_bounds{};
  Remainder remainder;
  /// of a report on several tests: verdict, sentence and the misfits of all frames are those of all tests
  bool part = false;
  bool searched = true;  ///< whether candidates were considered
};

/// Runs the loop (docs/loop.md). `say` gets one line for each step. Collective.
[[nodiscard]] Report close_loop(Experiment& experiment, const LoopOptions& options,
                                const std::function<void(const std::string&)>& say = {});

/// Blocks of contiguous frames that are held out: about a quarter of the frames in `blocks` blocks, none at either end.
[[nodiscard]] std::vector<int> held_out_blocks(int frames, int blocks = 3);

}  // namespace imic3d::loop
