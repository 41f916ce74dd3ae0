#pragma once
// In reverse: which effect, left out of the model, carries one set of identified parameters into another?

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace imic3d::loop {

/// A number that says how large an effect is.
struct EffectSize {
  double null = 0.0;   ///< the effect is absent
  double step = 1e-3;  ///< of the first tangent
  double lower = 0.0, upper = 0.0;
};

/// One effect as an explanation of a difference.
struct Explanation {
  Eigen::VectorXd size;       ///< values of its quantities - their null values [k]
  Eigen::MatrixXd tangent;    ///< shift of the parameters per unit of size, at the null [p x k]
  Eigen::VectorXd explained;  ///< shift of the parameters at `size`, identified again there [p]
  double chi_squared = 0.0;   ///< of the difference - explained
  int degrees = 0;            ///< p - k; not judged if none is left
  double p = 0.0;             ///< of chi_squared
  bool fits = false;          ///< not refused at 1 %
  bool failed = false;        ///< not judged: the test with a small effect could not be identified
  bool on_bound = false;      ///< a size stopped at its bound
  int identifications = 0;    ///< that it took
  std::string message;        ///< why it could not be followed, if so
};

/// Shift of the parameters [p] that sizes [k] of an effect cause when it is left out; nothing where the model cannot
/// follow.
using Bias = std::function<std::optional<Eigen::VectorXd>(const Eigen::VectorXd& sizes)>;

/// The sizes that carry the parameters by `difference` [p], by least squares with its `covariance` [p x p]. The first
/// tangent is a difference of Bias; from there Bias itself is followed in Gauss-Newton steps, its tangent updated by
/// the secant (Broyden), until the sizes stand within 2 %, `most` steps are done, or after the first of them the new
/// tangent refuses the effect at 1e-6: nothing that is reported is extrapolated.
[[nodiscard]] Explanation explain(const Eigen::VectorXd& difference, const Eigen::MatrixXd& covariance,
                                  const std::vector<EffectSize>& sizes, const Bias& bias, int most = 4);

}  // namespace imic3d::loop
