#pragma once
// A number that the forward chain depends on.

#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace imic3d {

/// Describes one parameter: its name, unit and admissible range.
struct ParameterInfo {
  std::string name;                                        ///< field's symbol, e.g. `S_y`
  std::string unit;                                        ///< in the case's units: `MPa`, `mm`, `-`
  std::string description;                                 ///< one line
  double lower = -std::numeric_limits<double>::infinity();  ///< smallest admissible value
  double upper = std::numeric_limits<double>::infinity();   ///< largest admissible value
  std::optional<double> null_value{};                      ///< the value at which its effect is absent
};

}  // namespace imic3d
