#pragma once
// The few distributions that the scores are judged by.

#include <Eigen/Core>

namespace imic3d::loop {

/// P(chi^2 with `degrees` > value).
[[nodiscard]] double chi_squared_tail(double value, int degrees);
/// Its logarithm, where the tail itself underflows too.
[[nodiscard]] double log_chi_squared_tail(double value, int degrees);
/// z with P(|N(0,1)| > z) = p: a p-value as a number of standard deviations, from log p.
[[nodiscard]] double deviations(double log_p);
/// The value that the fraction `level` of the values does not exceed.
[[nodiscard]] double quantile(Eigen::VectorXd values, double level);

}  // namespace imic3d::loop
