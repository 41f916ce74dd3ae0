#pragma once
// Uniform tests: stress-strain curves of bars, each a material point under mixed control, and the identification on
// them.

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "imic3d/core/whitening.hpp"
#include "imic3d/material/bar.hpp"
#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::identification {

/// One bar.
struct Curve {
  std::string name, group;       ///< curves of a group are repetitions of each other
  material::BarHistory history;  ///< logarithmic strain of the gauge in time [rows]
  Eigen::VectorXd stress;        ///< measured [rows, stress]
  /// the stress is force over the first section; else that times length/length_0
  bool engineering = true;
  double deviation = 1.0;  ///< standard deviation of a row [stress]
  bool estimated = false;  ///< that is the point_noise of this curve
  /// standard deviation of the recorded strain, of which `history` has the smooth course; 0: not known
  double strain_noise = 0.0;
  std::vector<char> use;  ///< of each row: not_judged, fitted, held_out
  enum Use : char { not_judged, fitted, held_out };
  Eigen::Index repeated_rows = 0;             ///< of the record that repeated the row before, and are left out
  std::optional<Eigen::Index> broken_from{};  ///< the row from which on it is not judged because it broke
};

/// From the recorded strain of `history` its noise, its turns and the smooth course between (gauge.hpp). Without
/// recorded times (`timed`) the noise is not sought.
void read_gauge(Curve& curve, bool timed = true);

/// Row `row` of curve `curve`.
struct CurvePlace {
  int curve = 0;
  Eigen::Index row = 0;
};

/// A set of curves and the law that shall predict them. All vectors hold the rows that are fitted or held out, curve
/// after curve. Parameters stand in the law's order; a law that is made with known_effects() has all of them, at their
/// null values until moved. Curves are simulated on the threads of OpenMP.
class CurveSet {
 public:
  /// Throws std::invalid_argument for a law of plane stress or curves whose sizes do not agree.
  CurveSet(std::shared_ptr<const material::FiniteStrainLaw> law, std::vector<Curve> curves,
           material::BarOptions options = {});

  /// Stresses at `parameters` [rows]. Throws ConvergenceError naming the curve that the law cannot follow.
  [[nodiscard]] Eigen::VectorXd predict(const std::vector<double>& parameters) const;
  /// The same, and d(stress)/d(parameter) of those of `free` [rows x free].
  [[nodiscard]] Eigen::VectorXd predict(const std::vector<double>& parameters, const std::vector<int>& free,
                                        Eigen::MatrixXd& derivatives) const;

  [[nodiscard]] const Eigen::VectorXd& measured() const { return measured_; }
  /// Of each row, with all that it is off by.
  [[nodiscard]] const Eigen::VectorXd& standard_deviation() const { return deviation_; }
  /// Of `values` of all rows [rows x k] those of the fitted ones, which become independent with a standard deviation of
  /// one [fitted x k].
  [[nodiscard]] Eigen::MatrixXd whitened(const Eigen::MatrixXd& values) const;
  [[nodiscard]] const std::vector<CurvePlace>& places() const { return places_; }
  [[nodiscard]] bool is_fitted(Eigen::Index i) const;
  /// Weighs the rows of curves that have no repetition by what their strain's noise, if any is seen about the
  /// prediction at `parameters`, makes of the stress: of each row's own, and by what is not known of a turn of all rows
  /// that remember it (`memory_of_turns`). Returns the standard deviation of the strain of each curve; 0 where none is
  /// seen.
  std::vector<double> weigh(const std::vector<double>& parameters);
  [[nodiscard]] const std::vector<Curve>& curves() const { return curves_; }
  [[nodiscard]] const std::vector<ParameterInfo>& parameters() const { return law_->parameters(); }
  [[nodiscard]] const material::FiniteStrainLaw& law() const { return *law_; }
  /// The same curves under another law.
  [[nodiscard]] CurveSet with(std::shared_ptr<const material::FiniteStrainLaw> law) const {
    return {std::move(law), curves_, options_};
  }

 private:
  std::shared_ptr<const material::FiniteStrainLaw> law_;
  std::vector<Curve> curves_;
  material::BarOptions options_;
  std::vector<CurvePlace> places_;
  /// Rows of a curve in the vectors, and what they are off by.
  struct Span {
    Eigen::Index first = 0, size = 0;
    std::vector<Eigen::Index> fitted;  // of its own rows
    Whitening whitening;               // of these
  };
  std::vector<Span> spans_;
  Eigen::VectorXd measured_, deviation_;
};

/// Distances of the values y at x to the line through their neighbours, over the deviation of such a distance of
/// independent values of deviation one [rows between two others that x goes on through and that `counts`].
[[nodiscard]] std::vector<double> distances(const Eigen::VectorXd& x, const Eigen::VectorXd& y,
                                            const std::function<bool(Eigen::Index)>& counts = {});
/// Noise of values y at x [points]: from each one's distance to the line through its neighbours, robust (Huber's
/// proposal 2, 1964: distances beyond three standard deviations count as three).
[[nodiscard]] double point_noise(const Eigen::VectorXd& x, const Eigen::VectorXd& y);
/// The same of a course that bends from row to row: from the distances to the cubic through two rows on either side,
/// their median, where that is less than three quarters of it.
[[nodiscard]] double noise_of_course(const Eigen::VectorXd& x, const Eigen::VectorXd& y);
/// Noise of the points of a curve [stress], which bends.
[[nodiscard]] double point_noise(const Curve& curve);
/// How a bar's stress rises with its strain from the row before, d(stress)/d(strain) [rows, stress]; where the strain
/// stands still as in the row before, and as in the row after where it turned back between the two. Nowhere more than
/// `steepest`, E of a law: where a hold relaxes the stress does not change by what the strain does.
[[nodiscard]] Eigen::VectorXd slopes(const material::BarHistory& history, const Eigen::VectorXd& stress,
                                     double steepest = INFINITY);

/// Noise of the points of a curve, of its stress and of its strain, which moves the stress by d(stress)/d(strain) times
/// as much: almost only where the curve is steep.
struct PointNoise {
  /// standard deviations; strain: 0 where the steep rows scatter no more than chance lets them, or as an error of the
  /// law does
  double stress = 0.0, strain = 0.0;
  /// degrees of freedom of the square of the noise where the curve is steep
  double steep_freedom = 0.0;
};
/// From the distances of the residual (measured - predicted) to the line through its neighbours, on the rows that are
/// steeper than half of the steepest and on the others; `slope` is that of the prediction [rows]. `stress`: what is
/// known of the stress's noise, `of_strain`: of the strain's; 0: nothing.
[[nodiscard]] PointNoise point_noise(const Eigen::VectorXd& strain, const Eigen::VectorXd& residual,
                                     const Eigen::VectorXd& slope, double stress = 0.0, double of_strain = 0.0);

/// Degrees of freedom of its square, of so many points: neighbouring distances share points (their squares are
/// correlated by 4/9 and 1/36), and 0.96 is the efficiency of the clipped mean.
[[nodiscard]] inline double freedom_of_point_noise(Eigen::Index points) {
  return 0.96 * static_cast<double>(points) / 1.944;
}

/// Standard deviation between repetitions [stress]: of their stresses at the same strain, rms over the strains that at
/// least two of them reach; each curve up to where its strain first turns back, one in compression turned round. Rows
/// that are not judged do not count. 0 if there is only one.
[[nodiscard]] double scatter(const std::vector<const Curve*>& repetitions);

struct CurveFitOptions {
  int max_iterations = 100;
  double eta = 1e-4;  ///< relative change of the parameters at convergence, Eq. 13
};

struct CurveIterate {
  std::vector<double> parameters;
  double eta = 0.0, chi = 0.0;  ///< chi: rms of the fitted rows' residuals over their standard deviations
};

struct CurveFit {
  std::vector<double> parameters;  ///< all of them
  /// of the free ones, if the rows' noise is white [free x free]; NaN for one that stays on a bound or is not seen, an
  /// infinite variance for those of which the rows show a combination alone
  Eigen::MatrixXd noise_covariance;
  /// the same, and each bar of a group of repetitions off by their scatter, all along it
  Eigen::MatrixXd covariance;
  std::vector<CurveIterate> iterates;
  std::vector<int> at_bounds;  ///< free parameters that ended on a bound
  bool converged = false;
};

/// Gauss-Newton with damping (Levenberg, Marquardt) and exact derivatives, on the rows that are fitted, from `start`
/// within the bounds of `information`. A bound that is reached holds until the gradient leads away from it.
[[nodiscard]] CurveFit fit(const CurveSet& set, const std::vector<ParameterInfo>& information,
                           const std::vector<double>& start, const std::vector<int>& free,
                           const CurveFitOptions& options = {},
                           const std::function<void(const CurveIterate&)>& report = {});

/// Of measured - predicted over some rows of a group (all groups if empty).
struct Misfit {
  Eigen::Index rows = 0;
  double stress = 0.0, chi = 0.0;  ///< rms [stress]; rms over the rows' standard deviations
  double typical =
      0.0;  ///< median of the absolute value / 0.6745 [stress]: the rms without a few rows that are far off
};
[[nodiscard]] Misfit misfit(const CurveSet& set, const Eigen::VectorXd& predicted, const std::string& group,
                            bool fitted);

}  // namespace imic3d::identification
