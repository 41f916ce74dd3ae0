#pragma once
// Checks a document against a JSON schema and says what is wrong in the user's terms.

#include <string>
#include <string_view>
#include <vector>

#include "yaml_document.hpp"

namespace imic3d::io {

/// Everything that does not fit the schema. valijson decides whether the document fits; the words are ours. In the
/// schema, `x-allowed` says in words what is allowed, and `x-unit` names the unit: `length`, `force`, `time`, quotients
/// of them with px, or any other unit as it is. Units are taken from the document's own `units`.
[[nodiscard]] std::vector<PlacedMistake> check_schema(const YamlDocument& document, std::string_view schema_text);

/// The one of `names` that is most like `name`, or "" if none is near.
[[nodiscard]] std::string nearest(const std::string& name, const std::vector<std::string>& names);

/// A value as a message shows it: numbers as they are, texts in quotes, lists and groups by their kind.
[[nodiscard]] std::string shown(const nlohmann::json& value);

}  // namespace imic3d::io
