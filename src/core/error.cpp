#include "imic3d/core/error.hpp"

#include <fmt/format.h>

namespace imic3d {

namespace {
std::string joined(const std::vector<Mistake>& mistakes) {
  std::string text;
  for (const auto& mistake : mistakes) text += (text.empty() ? "" : "\n") + mistake.message();
  return text;
}
}  // namespace

std::string Mistake::message() const {
  if (found.empty()) return place;
  return fmt::format("{}: {}{}{}", place, found, allowed.empty() ? "" : "; allowed: ", allowed);
}

InputError::InputError(std::vector<Mistake> mistakes)
    : std::runtime_error(joined(mistakes)), mistakes_(std::move(mistakes)) {}

InputError::InputError(std::string place, std::string found, std::string allowed)
    : InputError({Mistake{std::move(place), std::move(found), std::move(allowed)}}) {}

}  // namespace imic3d
