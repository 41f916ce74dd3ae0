#pragma once
// Efficient scores (Rao; Neyman's C(alpha)) of many candidates, calibrated by an ensemble of null residuals.

#include <Eigen/Core>
#include <vector>

namespace imic3d::loop {

/// The linearised problem at the identified parameters, all in units of the noise.
struct ScoreProblem {
  Eigen::VectorXd residual;                 ///< measured - predicted [N]
  Eigen::MatrixXd sensitivity;              ///< d(predicted)/d(free parameters) [N x p], prior rows included
  std::vector<Eigen::MatrixXd> signatures;  ///< of each candidate: d(predicted)/d(its sizes), then with other shapes [N x columns]
  std::vector<int> sizes;                   ///< of each candidate: the columns that are sizes [k]; empty: all
  Eigen::MatrixXd null;                     ///< residuals that noise alone makes, before the parameters are fitted [N x draws]
};

struct Score {
  double statistic = 0.0;    ///< T: chi^2 with `degrees` under the null
  int degrees = 1;
  double p = 1.0;            ///< of T alone
  double z = 0.0;            ///< T as a number of standard deviations
  double visibility = 0.0;   ///< kappa = |P s|/|s|: what the free parameters leave of its mark
  double drop = 0.0;         ///< of the residual's square if it were added (white noise)
  Eigen::VectorXd size;      ///< estimate of its parameters - null value [k]
  Eigen::VectorXd deviation; ///< standard deviation of these under the null [k]
  Eigen::VectorXd detectable;///< MDE: sizes that are found with 80 % probability, each alone [k]
  Eigen::MatrixXd bias;      ///< shift of the free parameters per unit of size if it is left out [p x k]
};

struct Scores {
  std::vector<Score> candidates;
  double threshold = 0.0;      ///< of the largest z over all candidates: its 95 % quantile under the null
  double energy = 0.0;         ///< |P r|^2
  double null_energy = 0.0, null_energy_deviation = 0.0;
  double omnibus = 0.0;        ///< (energy - null_energy)/null_energy_deviation
  double omnibus_threshold = 0.0;  ///< its 99 % quantile under the null
  Eigen::VectorXd null_largest;    ///< largest z of each null draw, covariance from the other half of the draws [draws]
};

/// T_j = (G_j^T C^-1 z)^T (G_j^T C^-1 G_j)^-1 (G_j^T C^-1 z) with z = A^T r, A = P S the projected marks of all candidates, G = A^T A
/// and C the covariance of z under the null. C is that of the draws, drawn towards G (the covariance of white noise) as far
/// as their number asks for. The threshold is the larger of what Gaussian scores of covariance C and the draws themselves
/// (cross-validated) give.
[[nodiscard]] Scores score(const ScoreProblem& problem);

}  // namespace imic3d::loop
