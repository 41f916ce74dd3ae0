#pragma once
// What the declared law may lack, as candidates.

#include "imic3d/loop/experiment.hpp"

namespace imic3d::loop {

/// One candidate for each effect among `information` (ParameterInfo::effect), with its parameters at `first` and on.
/// Parameters that are `declared` make no candidate. `scale` of the information is a usual size in its unit.
[[nodiscard]] std::vector<Candidate> law_candidates(const std::vector<ParameterInfo>& information,
                                                    const std::vector<char>& declared, int first = 0);

/// Poisson's ratio, the law's `parameter`, where it is held at what was declared.
[[nodiscard]] Candidate poissons_ratio(int parameter);

/// The parameter of an effect of the law at its null value. `rate`: the lowest strain rate of the test, which the yield
/// stress is taken relative to: far below a reference rate no size would show; 0: not known.
[[nodiscard]] Parameter at_null(ParameterInfo info, double rate = 0.0);

}  // namespace imic3d::loop
