#pragma once
// Non-linear least squares on an experiment's residual: Gauss-Newton with bounds, priors and damping (Levenberg).

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

#include "imic3d/loop/experiment.hpp"

namespace imic3d::loop {

/// What turns residuals in units of the measured noise into white ones where the noise of the model's inputs is there
/// too: a block for each frame, and the rows that are fitted.
class Weight {
 public:
  /// Blocks from draws of null residuals [N x draws]: the covariance within a frame, pooled over `window` frames to
  /// each side, each scaled to the frame's own variance, and drawn towards the identity as far as the number of draws
  /// asks for. Without draws, and in frames where all are zero: the identity. `apart`: a block for each channel of a
  /// frame, so that no number of one tells of another.
  Weight(const std::vector<Datum>& data, const Eigen::MatrixXd& null, int window = 2, bool apart = false);
  /// Residuals or sensitivities [N x any], whitened; still [N x any].
  [[nodiscard]] Eigen::MatrixXd operator()(const Eigen::MatrixXd& rows) const;
  /// The reverse.
  [[nodiscard]] Eigen::MatrixXd undone(const Eigen::MatrixXd& rows) const;

 private:
  std::vector<std::pair<Eigen::Index, Eigen::MatrixXd>>
      blocks_;  // first row, inverse Cholesky factor of the covariance
};

/// The rows of the given frames.
[[nodiscard]] std::vector<Eigen::Index> rows_of_frames(const std::vector<Datum>& data, const std::vector<char>& frames);

struct FitOptions {
  std::optional<int> max_iterations{};  ///< not given: as the experiment lets be
  /// expected decrease of the residual's square (chi^2) that ends the iterations, per parameter
  double tolerance = 1e-3;
  std::vector<int> released{};  ///< parameters that may go beyond their bounds, to half or twice of these
};

struct Fit {
  std::vector<int> free;
  std::vector<double> values;   ///< of all parameters
  Eigen::VectorXd residual;     ///< whitened, all rows [N]
  Eigen::MatrixXd sensitivity;  ///< d(predicted)/d(free), whitened [N x free]
  double cost = 0.0;            ///< square of the residual on the fitted rows, priors included
  int iterations = 0;
  bool converged = false;
  double expected = 0.0;  ///< further decrease of the cost that the last derivatives let expect
  /// Declared parameters whose bounds keep them from taking more off chi^2 than chance would (10): they do not give way
  /// to what is missing, and their sensitivities are zero. E, free to go to half of its value in the scores alone,
  /// would hide a compliance.
  std::vector<int> held{};
  /// Parameters that the data do not show, of which nothing is known beforehand: all of their value moves the residuals
  /// by less than a thousandth of a standard deviation. They stay where they started; sensitivities are zero.
  std::vector<int> unseen{};
};

/// Minimises |W (measured - predicted)|^2 on `rows` over the `free` parameters from `start`. Collective. Throws
/// ConvergenceError if the model cannot be computed at the start.
[[nodiscard]] Fit fit(Experiment& experiment, const Weight& weight, const std::vector<Eigen::Index>& rows,
                      const std::vector<int>& free, std::vector<double> start, const FitOptions& options = {});

/// Whether a parameter stands where it may go no further: the size of an effect within a hundredth of its range,
/// another one, and a size at its null value that is a bound, within a tenth of its step. A shape never does.
[[nodiscard]] bool on_bound(const Parameter& parameter, double value);

/// Other values of a shape (ParameterInfo::shape): an eighth and eight times of `value`; from 0, a third of its usual
/// size and that.
[[nodiscard]] std::array<double, 2> other_shapes(const Parameter& shape, double value);

/// What a candidate changes in the prediction.
struct Mark {
  Eigen::MatrixXd columns;  ///< whitened [N x columns]; zero where the model could not be computed
  int failed = 0;           ///< columns of which it could not
  /// d(predicted)/d(sizes) at each place of Candidate::elsewhere, whitened [N x sizes places]
  Eigen::MatrixXd elsewhere{};
};

/// Marks of candidates at `values`, all simulations side by side: first d(predicted)/d(parameter) of each size, then
/// for each shape (ParameterInfo::shape), which has no meaning while the sizes are null, the mark of the sizes with two
/// other values of it; of a candidate that acts somewhere, the few directions that hold nearly all of its marks at
/// other places. Collective.
[[nodiscard]] std::vector<Mark> marks(Experiment& experiment, const Weight& weight, const std::vector<double>& values,
                                      const std::vector<int>& candidates);

/// The same where what drives the model has one more draw of its noise, `times` times, and the sensitivities found in
/// the same way. Not of candidates that act somewhere.
struct DisturbedMarks {
  Eigen::MatrixXd sensitivity{};           ///< by the free parameters [N x free]
  std::vector<Eigen::MatrixXd> columns{};  ///< of each candidate, as Mark::columns
};
/// Nothing where that noise is not known. Collective.
[[nodiscard]] std::optional<DisturbedMarks> disturbed_marks(Experiment& experiment, const Weight& weight,
                                                            const std::vector<double>& values,
                                                            const std::vector<int>& candidates,
                                                            const std::vector<int>& free, double times);

}  // namespace imic3d::loop
