#pragma once
// What the declared model says of an effect's parameter.

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/effect.hpp"

namespace imic3d::loop {

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
