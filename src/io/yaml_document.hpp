#pragma once
// A YAML file as JSON values that remember their lines.

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::io {

/// A mistake and the line of the case file that it belongs to (for the order of the messages).
struct PlacedMistake {
  int line = 0;
  Mistake mistake;
  std::string path = {};  ///< of the value that the schema refuses
};

/// The contents of a YAML file. A value is named by its key path, e.g. `cameras[0].pixel_size`; the root is "".
struct YamlDocument {
  std::filesystem::path file;
  std::string text;
  nlohmann::json root;
  std::map<std::string, int> lines;     ///< line (from 1) of every key path
  std::vector<PlacedMistake> mistakes;  ///< duplicate keys, numbers that are not finite

  [[nodiscard]] int line(const std::string& path) const;
  /// `case.yaml:12 specimen.thickness`
  [[nodiscard]] std::string place(const std::string& path) const;
};

/// Reads a file with one YAML document. Plain scalars become numbers, booleans or null by the rules of YAML 1.2's core
/// schema (so 198e3 is a number and "198e3" a text). Throws InputError if the file cannot be read or is not YAML.
[[nodiscard]] YamlDocument read_yaml(const std::filesystem::path& file);

/// Key path of a member or an item.
[[nodiscard]] std::string member(const std::string& path, const std::string& key);
[[nodiscard]] std::string item(const std::string& path, std::size_t index);

}  // namespace imic3d::io
