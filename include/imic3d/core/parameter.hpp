#pragma once
// A number that the forward chain depends on.

#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace imic3d {

/// Describes one parameter: its name, unit and admissible range.
struct ParameterInfo {
  std::string name;                                         ///< field's symbol, e.g. `S_y`
  std::string unit;                                         ///< in the case's units: `MPa`, `mm`, `-`
  std::string description;                                  ///< one line
  double lower = -std::numeric_limits<double>::infinity();  ///< smallest admissible value
  double upper = std::numeric_limits<double>::infinity();   ///< largest admissible value
  std::optional<double> null_value{};                       ///< the value at which its effect is absent
  std::string effect{};  ///< the effect that it belongs to; empty: the declared law itself
  /// says how its effect acts, not how much: without meaning where the effect's sizes are at their null values;
  /// null_value is then a usual value
  bool shape = false;
  /// a usual size of it, for steps from 0; in units of E where `unit` holds stress (see usual_size)
  double scale = 0.0;
  bool turns_flow = false;  ///< it changes the direction of plastic flow under a given stress
};

/// A usual size of a parameter of a material with Young's modulus E, in its own unit: the size of a step from 0. 0 if
/// unknown.
[[nodiscard]] inline double usual_size(const ParameterInfo& info, double E) {
  if (info.unit.starts_with("1/stress")) return info.scale / E;
  return info.unit.starts_with("stress") ? info.scale * E : info.scale;
}

}  // namespace imic3d
