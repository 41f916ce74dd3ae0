#pragma once
// What a model is judged by: draws of the null.

#include <memory>
#include <vector>

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// Draws of the noise with these values of the parameters, with what the experiment has learned now; `draws` are asked
/// for, for the weight and for the null each. Collective.
[[nodiscard]] std::shared_ptr<const Ground> ground_of(Experiment& experiment, const std::vector<double>& values,
                                                      int draws);

}  // namespace imic3d::loop
