#pragma once
// Tables of the effects that a loop looked for.

#include <nlohmann/json.hpp>
#include <string>

namespace imic3d::io {

/// A text of a report, made safe for HTML.
[[nodiscard]] std::string escaped(const nlohmann::json& one, const char* key);

/// Names in a row; "none" of none.
[[nodiscard]] std::string joined(const nlohmann::json& names);

/// What a trial leaves, or why it is not plausible.
[[nodiscard]] std::string left_after(const nlohmann::json& trial);

/// The candidates under a model, the largest score first: size with its interval, predicted and achieved drop, what
/// came of the trial.
[[nodiscard]] std::string candidate_table(const nlohmann::json& model);

/// What a test cannot see under a model, with the bias that it would cause; the smallest sizes of the rest that would
/// be found; what was not tested.
[[nodiscard]] std::string blind_spots(const nlohmann::json& model);

}  // namespace imic3d::io
