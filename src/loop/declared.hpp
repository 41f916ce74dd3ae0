#pragma once
// An effect's parameter, and what the declared model says of it.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/effect.hpp"

namespace imic3d::loop {

/// The parameter of an effect that is not there; `unit`: in the case's units.
inline Parameter absent(const Effect::Quantity& q, std::string unit) {
  return {.info = {.name = q.name,
                   .unit = std::move(unit),
                   .description = q.description,
                   .lower = q.lower,
                   .upper = q.upper,
                   .null_value = q.null,
                   .shape = q.shape,
                   .scale = q.shape ? q.scale : std::abs(q.size - q.null)},
          .value = q.null,
          .step = q.step,
          .prior = 0.0,
          .free = false};
}

/// Gives an effect's parameter what the model declares of it; null if it declares nothing. Throws InputError: a value
/// beyond the bounds.
inline const DeclaredEffect* declare(Parameter& parameter, const std::string& effect,
                                     const std::vector<DeclaredEffect>& declared) {
  const auto its = std::find_if(declared.begin(), declared.end(), [&](const auto& one) {
    return one.effect == key_of(effect) && one.quantity == parameter.info.name;
  });
  if (its == declared.end()) return nullptr;
  auto& info = parameter.info;
  info.lower = std::max(info.lower, its->lower.value_or(info.lower)),
  info.upper = std::min(info.upper, its->upper.value_or(info.upper));
  parameter.value = its->value.value_or(*info.null_value), parameter.free = its->free;
  if (parameter.value < info.lower || parameter.value > info.upper)
    throw InputError("effects." + its->effect + "." + its->quantity, fmt::format("{:.6g}", parameter.value),
                     fmt::format("a number from {:.6g} to {:.6g} [{}]", info.lower, info.upper, info.unit));
  return &*its;
}

}  // namespace imic3d::loop
