#include "schema.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validation_results.hpp>
#include <valijson/validator.hpp>

namespace imic3d::io {

namespace {

using Json = nlohmann::json;

/// Levenshtein's distance, a swap of neighbours counting as one change.
std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i) d[i][0] = i;
  for (std::size_t j = 0; j <= b.size(); ++j) d[0][j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    for (std::size_t j = 1; j <= b.size(); ++j) {
      d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1)});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
    }
  }
  return d[a.size()][b.size()];
}

bool has_type(const Json& value, const std::string& type) {
  if (type == "object") return value.is_object();
  if (type == "array") return value.is_array();
  if (type == "string") return value.is_string();
  if (type == "boolean") return value.is_boolean();
  if (type == "integer") return value.is_number_integer();
  if (type == "number") return value.is_number();
  return false;
}

/// Walks the document and its schema side by side and names every place where they differ.
class Describer {
 public:
  Describer(const YamlDocument& document, const Json& schema) : document_(document), schema_(schema) {}

  std::vector<PlacedMistake> describe() {
    compare(document_.root, schema_, "");
    return std::move(mistakes_);
  }

 private:
  const Json& resolved(const Json& schema) const {
    if (!schema.contains("$ref")) return schema;
    const auto reference = schema["$ref"].get<std::string>();  // "#/definitions/frames"
    return schema_.at(Json::json_pointer(reference.substr(1)));
  }

  void compare(const Json& value, const Json& reference, const std::string& path) {
    const Json& schema = resolved(reference);
    if (schema.contains("anyOf")) return compare_alternatives(value, schema, path);
    if (schema.contains("type") && !has_type(value, schema["type"]))
      return mistake(path, shown(value), allowed(schema));
    if (schema.contains("enum")) {
      const auto& values = schema["enum"];
      if (std::find(values.begin(), values.end(), value) == values.end()) mistake(path, shown(value), allowed(schema));
    }
    if (schema.contains("not") && schema["not"].value("const", Json()) == value)
      mistake(path, shown(value), allowed(schema));
    if (value.is_number()) compare_number(value, schema, path);
    if (value.is_array()) compare_array(value, schema, path);
    if (value.is_object()) compare_object(value, schema, path);
  }

  /// Where no alternative has the value's type, what is allowed is said as a whole; else the one of that type is meant.
  void compare_alternatives(const Json& value, const Json& schema, const std::string& path) {
    for (const Json& alternative : schema["anyOf"])
      if (has_type(value, alternative["type"])) return compare(value, alternative, path);
    mistake(path, shown(value), allowed(schema));
  }

  void compare_number(const Json& value, const Json& schema, const std::string& path) {
    const double number = value.get<double>();
    const double infinity = std::numeric_limits<double>::infinity();
    const bool fits = number >= schema.value("minimum", -infinity) && number <= schema.value("maximum", infinity) &&
                      number > schema.value("exclusiveMinimum", -infinity) &&
                      number < schema.value("exclusiveMaximum", infinity);
    if (!fits) mistake(path, shown(value), allowed(schema));
  }

  void compare_array(const Json& value, const Json& schema, const std::string& path) {
    if (value.size() < schema.value("minItems", std::size_t{0}) ||
        value.size() > schema.value("maxItems", std::numeric_limits<std::size_t>::max()))
      mistake(path, value.empty() ? "an empty list" : fmt::format("a list of {}", value.size()), allowed(schema));
    if (!schema.contains("items")) return;
    for (std::size_t i = 0; i < value.size(); ++i) compare(value[i], schema["items"], item(path, i));
  }

  void compare_object(const Json& value, const Json& schema, const std::string& path) {
    if (value.size() < schema.value("minProperties", std::size_t{0})) mistake(path, "nothing", allowed(schema));
    for (const auto& key : schema.value("required", Json::array()))
      if (!value.contains(key)) {
        const auto name = key.get<std::string>();
        mistake(member(path, name), "not given", allowed(schema["properties"][name]));
      }
    const Json properties = schema.value("properties", Json::object());
    for (const auto& [key, child] : value.items()) {
      if (properties.contains(key)) {
        compare(child, properties[key], member(path, key));
      } else if (schema.contains("additionalProperties") && schema["additionalProperties"].is_object()) {
        compare(child, schema["additionalProperties"], member(path, key));
      } else {
        std::vector<std::string> names;
        for (const auto& property : properties.items()) names.push_back(property.key());
        const auto near = nearest(key, names);
        const bool decimals = key.find_first_not_of("0123456789") == std::string::npos;  // 1,0 is 1 and a key 0
        mistake(member(path, key), near.empty() ? "unknown key" : fmt::format("unknown key, near to {}", near),
                fmt::format("{}{}", fmt::join(names, ", "), decimals ? "; the decimal sign is the point" : ""));
      }
    }
  }

  std::string unit(const Json& schema) const {
    std::string text = schema.value("x-unit", "");
    if (text.empty()) return {};
    const Json units = document_.root.value("units", Json::object());
    for (const auto& [quantity, standard] :
         {std::pair{"length", "mm"}, std::pair{"force", "N"}, std::pair{"time", "s"}}) {
      const auto at = text.find(quantity);
      if (at == std::string::npos) continue;
      const bool given = units.is_object() && units.contains(quantity) && units[quantity].is_string();
      text.replace(at, std::string(quantity).size(),
                   given ? units[quantity].get<std::string>() : std::string(standard));
    }
    return " [" + text + "]";
  }

  std::string allowed(const Json& reference) const {
    const Json& schema = resolved(reference);
    if (schema.contains("x-allowed")) return schema["x-allowed"];
    if (schema.contains("enum")) {
      std::vector<std::string> values;
      for (const auto& value : schema["enum"])
        values.push_back(value.is_string() ? value.get<std::string>() : value.dump());
      return fmt::format("{}", fmt::join(values, ", "));
    }
    const std::string type = schema.value("type", "");
    if (type == "string") return "a text";
    if (type == "boolean") return "true or false";
    if (type == "object") {
      std::vector<std::string> names;
      for (const auto& property : schema["properties"].items()) names.push_back(property.key());
      return fmt::format("a group of {}", fmt::join(names, ", "));
    }
    std::string text = type == "integer" ? "an integer" : "a number";
    if (schema.value("exclusiveMinimum", Json()) == 0 && !schema.contains("exclusiveMaximum")) {
      text = "a positive number";
    } else if (schema.contains("minimum") && schema.contains("maximum")) {
      text += fmt::format(" from {} to {}", schema["minimum"].dump(), schema["maximum"].dump());
    } else if (schema.contains("minimum")) {
      text += fmt::format(" from {}", schema["minimum"].dump());
    } else if (schema.contains("exclusiveMinimum")) {
      text += fmt::format(" between {} and {}", schema["exclusiveMinimum"].dump(), schema["exclusiveMaximum"].dump());
    }
    return text + unit(schema);
  }

  void mistake(const std::string& path, std::string found, std::string allowed_values) {
    mistakes_.push_back(
        {document_.line(path), {document_.place(path), std::move(found), std::move(allowed_values)}, path});
  }

  const YamlDocument& document_;
  const Json& schema_;
  std::vector<PlacedMistake> mistakes_;
};

}  // namespace

std::vector<PlacedMistake> check_schema(const YamlDocument& document, std::string_view schema_text) {
  const Json schema_document = Json::parse(schema_text);
  valijson::Schema schema;
  valijson::SchemaParser parser(valijson::SchemaParser::kDraft7);
  parser.populateSchema(valijson::adapters::NlohmannJsonAdapter(schema_document), schema);
  valijson::Validator validator(valijson::Validator::kStrongTypes);
  valijson::ValidationResults results;
  if (validator.validate(schema, valijson::adapters::NlohmannJsonAdapter(document.root), &results)) return {};
  auto mistakes = Describer(document, schema_document).describe();
  if (mistakes.empty()) {  // a keyword of the schema that the describer does not know
    valijson::ValidationResults::Error deepest, error;
    while (results.popError(error))
      if (error.context.size() > deepest.context.size()) deepest = error;
    std::string path;
    for (std::size_t i = 1; i < deepest.context.size(); ++i) path += deepest.context[i];
    mistakes.push_back({1, {document.file.string() + " " + path, "does not fit the schema", "see case.schema.json"}});
  }
  return mistakes;
}

std::string nearest(const std::string& name, const std::vector<std::string>& names) {
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(1, std::min<std::size_t>(name.size() / 2, 3)) + 1;
  for (const auto& candidate : names) {
    const auto distance = edit_distance(name, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

std::string shown(const Json& value) {
  if (value.is_null()) return "nothing";
  if (value.is_object()) return value.empty() ? "an empty group" : "a group of keys";
  if (value.is_array()) return value.empty() ? "an empty list" : fmt::format("a list of {}", value.size());
  if (value.is_string()) return fmt::format("\"{}\"", value.get<std::string>());
  if (value.is_number_float()) return fmt::format("{}", value.get<double>());
  return value.dump();
}

}  // namespace imic3d::io
