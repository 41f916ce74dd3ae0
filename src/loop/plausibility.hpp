#pragma once
// Whether an effect that was added on trial is plausible, beyond what it leaves.

#include <optional>
#include <vector>

#include "appraisal.hpp"

namespace imic3d::loop {

/// A fitted frame without which the data do not tell an effect's sizes from their null values (95 %), and what the
/// others want instead.
struct LoneFrame {
  int frame = 0;
  /// of its sizes the one that the others want changed most, in their standard deviations
  int parameter = 0;
  double size = 0.0, deviation = 0.0;  ///< that the others want, and how sure they are
};
/// The first of them; none where no frame is as much alone. Linearised at the fit, shapes held. `rows`: those that are
/// fitted.
[[nodiscard]] std::optional<LoneFrame> told_by_one_frame(const Experiment& experiment, const Model& model,
                                                         int candidate, const std::vector<Eigen::Index>& rows);

/// Sets `sufficient`, `plausible`, `disagrees` and `objection` of a trial whose model has been judged, beside the model
/// `at` that its effect was added to: something is left, or a size is not told; it explains no more than chance does,
/// is at a bound, is behaviour of the material at 20 times its usual size, is contradicted by the record, explains
/// worse what was held out (frames, half of the surface, a rig of cameras), cannot be checked, is asked for by one
/// frame against all others, or thirds of the frames disagree about its size (docs/loop.md, Verdict).
void weigh(Trial& trial, const Model& at, const Experiment& experiment, const Appraisal& appraisal);

}  // namespace imic3d::loop
