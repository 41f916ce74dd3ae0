#pragma once
// Lines of a table separated by commas, semicolons, tabs or blanks.

#include <algorithm>
#include <charconv>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace imic3d::io {

inline std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(" \t\r");
  if (first == std::string::npos) return {};
  return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

/// The separator that stands most often in the header outside quotes; a blank if there is none.
inline char separator_of(const std::string& header) {
  std::map<char, int> count{{',', 0}, {';', 0}, {'\t', 0}};
  bool quoted = false;
  for (char c : header) {
    if (c == '"') quoted = !quoted;
    if (const auto it = count.find(c); !quoted && it != count.end()) ++it->second;
  }
  const auto most = std::max_element(count.begin(), count.end(), [](auto& a, auto& b) { return a.second < b.second; });
  return most->second > 0 ? most->first : ' ';
}

/// Fields of one line, or nothing if a quote is not closed. "" inside quotes is one quote, several blanks are one
/// separator.
inline std::optional<std::vector<std::string>> fields_of(std::string line, char separator) {
  if (separator == ' ') line = trimmed(line);
  std::vector<std::string> fields;
  std::string field;
  bool quoted = false, was_quoted = false;
  const auto finish = [&] {
    fields.push_back(was_quoted ? field : trimmed(field));
    field.clear();
    was_quoted = false;
  };
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (quoted) {
      if (c != '"') {
        field += c;
      } else if (i + 1 < line.size() && line[i + 1] == '"') {
        field += line[++i];
      } else {
        quoted = false;
      }
    } else if (c == '"' && trimmed(field).empty()) {
      quoted = was_quoted = true;
      field.clear();
    } else if (c == separator) {
      if (c != ' ' || was_quoted || !field.empty()) finish();
    } else if (!(was_quoted && (c == ' ' || c == '\r'))) {
      field += c;
    }
  }
  if (quoted) return std::nullopt;
  finish();
  return fields;
}

template <class Number>
std::optional<Number> parsed(std::string text) {
  if (text.starts_with('+')) text.erase(0, 1);
  Number number{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || text.empty()) return std::nullopt;
  return number;
}

/// A number of a table whose fields `separator` parts: its decimal sign is the point or, where commas do not part
/// fields, the comma.
inline std::optional<double> number_in(std::string text, char separator) {
  if (separator != ',' && text.find('.') == std::string::npos && std::count(text.begin(), text.end(), ',') == 1)
    text[text.find(',')] = '.';
  return parsed<double>(std::move(text));
}

/// A row below the header that gives units: fields that are not empty are all in brackets, or none is a number and one
/// is a unit of what tests record.
inline bool are_units(const std::vector<std::string>& fields, char separator) {
  static const std::set<std::string> units = {"s",  "ms",  "min", "N",   "kN",  "MN",  "lbf", "mm", "m",
                                              "in", "MPa", "Pa",  "GPa", "kPa", "psi", "ksi", "%"};
  const auto in_brackets = [](const std::string& f) {
    return f.size() > 1 && ((f.front() == '(' && f.back() == ')') || (f.front() == '[' && f.back() == ']'));
  };
  const auto all = [&](const auto& are) {
    return std::all_of(fields.begin(), fields.end(), [&](const std::string& f) { return f.empty() || are(f); });
  };
  if (std::any_of(fields.begin(), fields.end(), in_brackets) && all(in_brackets)) return true;
  return std::any_of(fields.begin(), fields.end(), [&](const std::string& f) { return units.contains(f); }) &&
         all([&](const std::string& f) { return !number_in(f, separator); });
}

}  // namespace imic3d::io
