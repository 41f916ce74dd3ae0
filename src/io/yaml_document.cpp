#include "yaml_document.hpp"

#include <fmt/format.h>
#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string_view>

#include "utf8.hpp"

namespace imic3d::io {

namespace {

constexpr int deepest = 32;           // levels; an alias to an anchor around it would never end
constexpr int most_values = 200'000;  // aliases of aliases could multiply without bound

/// What a plain scalar looks like.
enum class Plain { text, integer, real, not_finite };

/// [-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?, or [-+]?\.?(inf|nan).
Plain kind_of(std::string_view rest) {
  const auto take_sign = [&] {
    if (!rest.empty() && (rest.front() == '-' || rest.front() == '+')) rest.remove_prefix(1);
  };
  const auto take_digits = [&] {
    const auto end = std::min(rest.find_first_not_of("0123456789"), rest.size());
    rest.remove_prefix(end);
    return end > 0;
  };
  take_sign();
  for (std::string_view name : {"inf", "Inf", "INF", "nan", "NaN", "NAN"})
    if (rest == name || (rest.starts_with('.') && rest.substr(1) == name)) return Plain::not_finite;
  const bool whole = take_digits();
  if (rest.empty()) return whole ? Plain::integer : Plain::text;
  if (rest.front() == '.') {
    rest.remove_prefix(1);
    if (!take_digits() && !whole) return Plain::text;
  } else if (!whole) {
    return Plain::text;
  }
  if (rest.starts_with('e') || rest.starts_with('E')) {
    rest.remove_prefix(1);
    take_sign();
    if (!take_digits()) return Plain::text;
  }
  return rest.empty() ? Plain::real : Plain::text;
}

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
    const Plain kind = kind_of(text);
    const char* first = text.data() + (text.starts_with('+') ? 1 : 0);
    const char* last = text.data() + text.size();
    if (kind == Plain::integer) {
      std::int64_t number = 0;
      if (std::from_chars(first, last, number).ec == std::errc()) return number;
    }
    if (kind == Plain::integer || kind == Plain::real) {
      double number = 0;
      const auto error = std::from_chars(first, last, number).ec;
      if (error == std::errc() && std::isfinite(number)) return number;
      not_a_number(path, text);
      return 1.0;  // stands for a number, so that the schema does not complain a second time
    }
    if (kind == Plain::not_finite) {
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

namespace {

/// Passes over a document.
class Skip : public YAML::EventHandler {
  void OnDocumentStart(const YAML::Mark&) override {}
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark&, YAML::anchor_t) override {}
  void OnAlias(const YAML::Mark&, YAML::anchor_t) override {}
  void OnScalar(const YAML::Mark&, const std::string&, YAML::anchor_t, const std::string&) override {}
  void OnSequenceStart(const YAML::Mark&, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {}
  void OnSequenceEnd() override {}
  void OnMapStart(const YAML::Mark&, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {}
  void OnMapEnd() override {}
};

/// Whether anything follows the first document. YAML::LoadAll would go on for ever where a text begins with a comma,
/// which is no document and is never passed.
bool several_documents(const std::string& text) {
  std::istringstream stream(text);
  YAML::Parser parser(stream);
  Skip skip;
  return parser.HandleNextDocument(skip) && parser.HandleNextDocument(skip);
}

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
  if (const auto foreign = first_foreign_byte(document.text); foreign < document.text.size())
    throw InputError(fmt::format("{}:{}", file.string(),
                                 1 + std::count(document.text.begin(),
                                                document.text.begin() + static_cast<std::ptrdiff_t>(foreign), '\n')),
                     fmt::format("byte 0x{:02x}", static_cast<unsigned char>(document.text[foreign])), "text in UTF-8");
  YAML::Node root;
  bool several = false;
  try {
    root = YAML::Load(document.text);
    several = root.IsMap() && several_documents(document.text);
  } catch (const YAML::Exception& exception) {
    throw InputError(fmt::format("{}:{}", file.string(), exception.mark.line + 1),
                     fmt::format("not YAML at column {}: {}", exception.mark.column + 1, exception.msg), "");
  }
  if (several || !root.IsMap())
    throw InputError(file.string(), several ? "several YAML documents" : "no sections",
                     "sections such as title, specimen, cameras, loads, material, identify");
  document.root = Converter(document).convert(root, "", 1);
  return document;
}

}  // namespace imic3d::io
