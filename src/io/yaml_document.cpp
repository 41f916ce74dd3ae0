#include "yaml_document.hpp"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <charconv>
#include <cmath>
#include <fstream>
#include <regex>
#include <sstream>

namespace imic3d::io {

namespace {

constexpr int deepest = 32;           // levels; an alias to an anchor around it would never end
constexpr int most_values = 200'000;  // aliases of aliases could multiply without bound

/// Turns yaml-cpp's nodes into JSON, noting lines and what JSON cannot hold.
class Converter {
 public:
  explicit Converter(YamlDocument& document) : document_(document) {}

  nlohmann::json convert(const YAML::Node& node, const std::string& path, int line, int depth = 0) {
    document_.lines.emplace(path, line);
    if (depth > deepest || ++values_ > most_values)
      throw InputError(fmt::format("{}:{}", document_.file.string(), line), "too many levels or values",
                       "a plain case file");
    if (node.IsMap()) return convert_map(node, path, depth);
    if (node.IsSequence()) {
      auto list = nlohmann::json::array();
      for (std::size_t i = 0; i < node.size(); ++i)
        list.push_back(convert(node[i], item(path, i), node[i].Mark().line + 1, depth + 1));
      return list;
    }
    if (node.IsScalar()) return convert_scalar(node, path);
    return nullptr;
  }

 private:
  nlohmann::json convert_map(const YAML::Node& node, const std::string& path, int depth) {
    auto object = nlohmann::json::object();
    for (const auto& entry : node) {
      const YAML::Node &key_node = entry.first, &value = entry.second;
      const int line = key_node.Mark().line + 1;
      if (!key_node.IsScalar()) {
        mistake(line, fmt::format("{}:{} {}", document_.file.string(), line, path), "a key that is a list or a group",
                "a name");
        continue;
      }
      const auto& key = key_node.Scalar();
      const auto key_path = member(path, key);
      if (object.contains(key)) {
        mistake(line, fmt::format("{}:{} {}", document_.file.string(), line, key_path),
                fmt::format("key given twice (first in line {})", document_.line(key_path)), "each key once");
        continue;
      }
      object[key] = convert(value, key_path, line, depth + 1);
    }
    return object;
  }

  nlohmann::json convert_scalar(const YAML::Node& node, const std::string& path) {
    const std::string& text = node.Scalar();
    if (node.Tag() == "!") return text;  // quoted
    if (text.empty() || text == "~" || text == "null" || text == "Null" || text == "NULL") return nullptr;
    if (text == "true" || text == "True" || text == "TRUE") return true;
    if (text == "false" || text == "False" || text == "FALSE") return false;
    static const std::regex integer("[-+]?[0-9]+");
    static const std::regex real(R"([-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?)");
    static const std::regex not_finite(R"([-+]?\.?(inf|Inf|INF|nan|NaN|NAN))");
    const char* first = text.data() + (text.starts_with('+') ? 1 : 0);
    const char* last = text.data() + text.size();
    if (std::regex_match(text, integer)) {
      std::int64_t number = 0;
      if (std::from_chars(first, last, number).ec == std::errc()) return number;
    }
    if (std::regex_match(text, real)) {
      double number = 0;
      const auto error = std::from_chars(first, last, number).ec;
      if (error == std::errc() && std::isfinite(number)) return number;
      not_a_number(path, text);
      return 1.0;  // stands for a number, so that the schema does not complain a second time
    }
    if (std::regex_match(text, not_finite)) {
      not_a_number(path, text);
      return 1.0;
    }
    return text;
  }

  void not_a_number(const std::string& path, const std::string& text) {
    mistake(document_.line(path), document_.place(path), text, "a finite number");
  }

  void mistake(int line, std::string place, std::string found, std::string allowed) {
    document_.mistakes.push_back({line, {std::move(place), std::move(found), std::move(allowed)}});
  }

  YamlDocument& document_;
  int values_ = 0;
};

}  // namespace

std::string member(const std::string& path, const std::string& key) { return path.empty() ? key : path + "." + key; }
std::string item(const std::string& path, std::size_t index) { return fmt::format("{}[{}]", path, index); }

int YamlDocument::line(const std::string& path) const {
  std::string known = path;
  while (true) {
    if (const auto it = lines.find(known); it != lines.end()) return it->second;
    const auto end = known.find_last_of(".[");
    if (end == std::string::npos) return 1;
    known.resize(end);
  }
}

std::string YamlDocument::place(const std::string& path) const {
  return fmt::format("{}:{}{}{}", file.string(), line(path), path.empty() ? "" : " ", path);
}

YamlDocument read_yaml(const std::filesystem::path& file) {
  std::error_code error;
  std::ifstream stream(file, std::ios::binary);
  if (!stream || std::filesystem::is_directory(file, error)) {
    throw InputError(file.string(), std::filesystem::exists(file, error) ? "cannot be read" : "no such file",
                     "a case file (YAML)");
  }
  YamlDocument document;
  document.file = file;
  document.text.assign(std::istreambuf_iterator<char>(stream), {});
  std::vector<YAML::Node> nodes;
  try {
    nodes = YAML::LoadAll(document.text);
  } catch (const YAML::Exception& exception) {
    throw InputError(fmt::format("{}:{}", file.string(), exception.mark.line + 1),
                     fmt::format("not YAML at column {}: {}", exception.mark.column + 1, exception.msg), "");
  }
  if (nodes.size() != 1 || !nodes.front().IsMap())
    throw InputError(file.string(), nodes.size() > 1 ? "several YAML documents" : "no sections",
                     "sections such as title, specimen, cameras, loads, material, identify");
  document.root = Converter(document).convert(nodes.front(), "", 1);
  return document;
}

}  // namespace imic3d::io
