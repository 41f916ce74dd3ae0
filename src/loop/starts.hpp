#pragma once
// Where a candidate is identified from.

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// Whether the candidate has a number that says how it acts, not how much (ParameterInfo::shape).
[[nodiscard]] bool shaped(const Experiment& experiment, int candidate);

/// Whether a candidate is looked for from the declared parameters, too: one without a shape, of the law or of the path
/// on which it yields, where the misfit of `at` is large.
[[nodiscard]] bool from_afar(const Experiment& experiment, const Model& at, int candidate);

/// Values of all parameters from which `at` with its i-th other candidate added is identified, in their order. One
/// that acts somewhere: at the three places whose marks explain most, of what is fitted and what is held out, with the
/// sizes that they ask for. Any other: the size that its score predicts (next to the null value where a shape decides
/// what it is, for three of its values). The best place where the misfit is large, and any `from_afar`, with the
/// declared parameters, too: what is missing has bent those that were found, and no way may lead from there to where it
/// is. Last, the null value.
[[nodiscard]] std::vector<std::vector<double>> starts_of(const Experiment& experiment, const Model& at, std::size_t i);

}  // namespace imic3d::loop
