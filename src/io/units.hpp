#pragma once
// Units by name, in SI units; 1 for a name that the schema refuses.

#include <map>
#include <string>

namespace imic3d::io {

inline double newtons(const std::string& unit) {
  static const std::map<std::string, double> values{
      {"N", 1.0}, {"kN", 1e3}, {"MN", 1e6}, {"lbf", 4.4482216152605}, {"kip", 4448.2216152605}};
  const auto it = values.find(unit);
  return it == values.end() ? 1.0 : it->second;
}

inline double metres(const std::string& unit) {
  static const std::map<std::string, double> values{{"um", 1e-6}, {"mm", 1e-3}, {"m", 1.0}, {"in", 0.0254}};
  const auto it = values.find(unit);
  return it == values.end() ? 1.0 : it->second;
}

inline double pascals(const std::string& unit) {
  static const std::map<std::string, double> values{
      {"Pa", 1.0}, {"kPa", 1e3}, {"MPa", 1e6}, {"GPa", 1e9}, {"psi", 6894.757293168}, {"ksi", 6894757.293168}};
  const auto it = values.find(unit);
  return it == values.end() ? 1.0 : it->second;
}

}  // namespace imic3d::io
