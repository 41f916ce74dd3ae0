#pragma once
// Efficient scores (Rao; Neyman's C(alpha)) of many candidates, calibrated by an ensemble of null residuals.

#include <Eigen/Core>
#include <vector>

namespace imic3d::loop {

/// Levels of the two tests of the declared model, together one false alarm in twenty; what comes after a first effect
/// needs stronger evidence.
constexpr double level_of_scores = 0.04, level_of_omnibus = 0.01, level_after_addition = 0.01;

/// Below this visibility an effect is one that the test cannot see; its score does not count.
constexpr double least_visibility = 0.05;

/// The linearised problem at the identified parameters, all in units of the noise.
struct ScoreProblem {
  /// measured - predicted, the parameters fitted as far as their bounds let them [N]
  Eigen::VectorXd residual;
  Eigen::MatrixXd sensitivity;  ///< d(predicted)/d(free parameters) [N x p], prior rows included
  /// of each candidate: d(predicted)/d(its sizes), then with other shapes [N x columns]
  std::vector<Eigen::MatrixXd> signatures;
  std::vector<int> sizes;  ///< of each candidate: the columns that are sizes [k]; empty: all
  /// of each candidate that acts somewhere: d(predicted)/d(its sizes) at the first place, at the second … [N x k
  /// places]; empty: none does
  std::vector<Eigen::MatrixXd> elsewhere{};
  /// The same of data that are not fitted: where frames that are fitted do not tell places or moments apart, these do.
  struct {
    Eigen::VectorXd residual;                ///< [held out]
    Eigen::MatrixXd sensitivity;             ///< [held out x p]
    std::vector<Eigen::MatrixXd> elsewhere;  ///< of each candidate [held out x k places]
  } held_out{};
  /// degrees of freedom that each number's noise was estimated from [N]; empty: known
  Eigen::VectorXd freedom;
  /// residuals that noise alone makes, before the parameters are fitted [N x draws]
  Eigen::MatrixXd null;
  Eigen::MatrixXd squares;  ///< the same for the energy; empty: as `null`
  /// so many of the last rows are what was known of the parameters beforehand
  Eigen::Index known = 0;
  /// share of null tests in which the largest score may exceed its limit
  double level = level_of_scores;
};

struct Score {
  double statistic = 0.0;  ///< T: chi^2 with `degrees` under the null
  int degrees = 1;
  double p = 1.0;  ///< of T alone
  /// T as a number of standard deviations of a normal distribution: Student's t where the noise was estimated from few
  /// data
  double z = 0.0;
  double visibility = 0.0;  ///< kappa = |P s|/|s|: what the free parameters leave of its mark
  /// most of that is what was known of a parameter beforehand, not a remnant of the mark itself
  bool shown_by_prior = false;
  double drop = 0.0;          ///< of the residual's square if it were added (white noise)
  bool contradicted = false;  ///< with its size data that were held out are explained worse: no more than chance
  Eigen::VectorXd size;       ///< estimate of its parameters - null value [k]
  Eigen::VectorXd deviation;  ///< standard deviation of these under the null [k]
  /// MDE: sizes that are found with 80 % probability, each alone [k], then of the size with the other shapes [columns];
  /// a single size of one that acts somewhere: where it is seen best; infinite: leaves no trace
  Eigen::VectorXd detectable;
  Eigen::MatrixXd size_there;  ///< size by its mark at each place alone, as if noise were white [k x places]
  /// of the residual's square by each, in what is fitted and in what is held out [places]
  Eigen::VectorXd drop_there, drop_there_held_out;
  Eigen::MatrixXd bias;  ///< shift of the free parameters per unit of size if it is left out [p x k]
  [[nodiscard]] bool visible() const { return visibility >= least_visibility || shown_by_prior; }
};

struct Scores {
  std::vector<Score> candidates;
  /// of the largest z over all visible candidates: a share `level` of null tests has more
  double threshold = 0.0;
  double largest_p = 1.0;    ///< of the largest z of these: the share of null tests that have as much or more
  double energy = 0.0;       ///< |r|^2: what parameters on their bounds leave counts
  double null_energy = 0.0;  ///< its mean under the null
  /// how far the energy lies beyond the null's, as standard deviations of a normal distribution
  double omnibus = 0.0;
  double omnibus_threshold = 0.0;  ///< one null test of a hundred has more
  double omnibus_p = 1.0;
  Eigen::VectorXd null_largest;  ///< largest z of null tests [any]
};

/// T_j = (G_j^T C^-1 z)^T (G_j^T C^-1 G_j)^-1 (G_j^T C^-1 z) with z = A^T r, A = P S the projected marks of all
/// candidates, G = A^T A and C the covariance of z under the null. C is that of the draws, drawn towards G (the
/// covariance of white noise) as far as their number asks for. The largest z is judged by Gaussian scores of covariance
/// C, each tested with a covariance estimated anew from as many draws; where `freedom` is finite they are of Student's
/// t, with one scale for all scores of a test.
[[nodiscard]] Scores score(const ScoreProblem& problem);

/// What simpler methods would say of the same residual and the same marks; for comparison, no verdict rests on them.
struct Baselines {
  /// of |P r|^2 as a chi^2: noise taken as white and of the size that the weights say
  double chi_squared_p = 1.0;
  /// of each candidate: between P r and its projected marks (the best one is the name that a cosine gives)
  std::vector<double> cosine;
  /// candidates that forward selection by the Bayesian information criterion takes, in its order
  std::vector<int> bic;
};
[[nodiscard]] Baselines baselines(const ScoreProblem& problem);

}  // namespace imic3d::loop
