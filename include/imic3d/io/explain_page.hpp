#pragma once
// The page of imic3d explain.

#include <filesystem>
#include <nlohmann/json.hpp>

namespace imic3d::io {

/// Writes the self-contained page from what imic3d explain found (the contents of its result.json): the sentence, the
/// two sets, what each effect explains of the difference and leaves, and of those that fit what would tell them.
/// Throws InputError if it cannot be written.
void write_explain_page(const std::filesystem::path& page, const nlohmann::json& found);

}  // namespace imic3d::io
