#pragma once
// What a report says to a test engineer.

#include <string>

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// The verdict in words, with sizes, chi of the held-out frames before and after, and what would tell the candidates
/// apart.
[[nodiscard]] std::string sentence_of(const Experiment& experiment, const Report& report);
/// A value to a digit of its standard deviation: 0.042 (0.0015), 197943 (3114), with an exponent from ten million on;
/// six digits without one.
[[nodiscard]] std::string to_a_digit(double value, double deviation);

}  // namespace imic3d::loop
