#pragma once
// What a report says to a test engineer.

#include <string>

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// The verdict in words, with sizes, chi of the held-out frames before and after, and what would tell the candidates apart.
[[nodiscard]] std::string sentence_of(const Experiment& experiment, const Report& report);

}  // namespace imic3d::loop
