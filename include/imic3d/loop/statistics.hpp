#pragma once
// The few distributions that the scores are judged by.

#include <Eigen/Core>
#include <vector>

namespace imic3d::loop {

/// P(chi^2 with `degrees` > value).
[[nodiscard]] double chi_squared_tail(double value, int degrees);
/// Its logarithm, where the tail itself underflows too.
[[nodiscard]] double log_chi_squared_tail(double value, int degrees);
/// Whether estimates [n] of this covariance [n x n] are told from zero: x^T C^-1 x beyond the 95 % of chi^2 with n
/// degrees.
[[nodiscard]] bool told_from_zero(const Eigen::VectorXd& estimates, const Eigen::MatrixXd& covariance);
/// z with P(|N(0,1)| > z) = p: a p-value as a number of standard deviations, from log p.
[[nodiscard]] double deviations(double log_p);
/// The standard normal number with the tail of Student's `t` with `freedom` degrees (Wallace 1959; to 1e-3 above 5).
[[nodiscard]] double student_as_normal(double t, double freedom);
/// Its inverse.
[[nodiscard]] double normal_as_student(double z, double freedom);
/// Length of a mean (in standard deviations) with which chi^2 of `degrees` exceeds in Phi(`beyond`) of all cases what
/// N(0,1)^2 at `limit` is as improbable as: limit + beyond for one degree.
[[nodiscard]] double detectable(double limit, double beyond, int degrees);
/// W [n square] that whitens numbers over time: each row is a number less what those before it let expect, in its
/// standard deviation. The rows that are fitted hold nothing of the numbers in `held_out` [places]; no row holds
/// anything of what comes after it, so that a frame far off at the end (a specimen that necks) moves no other.
[[nodiscard]] Eigen::MatrixXd whitening(const Eigen::MatrixXd& covariance, const std::vector<int>& held_out);
/// What one more draw of the same distribution as `values` exceeds with probability `level` or less: a value of them,
/// the largest where they are few.
[[nodiscard]] double upper_quantile(Eigen::VectorXd values, double level);
/// The value that the fraction `level` of the values does not exceed.
[[nodiscard]] double quantile(Eigen::VectorXd values, double level);

}  // namespace imic3d::loop
