#pragma once
// The page of imic3d loop for a test engineer.

#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "imic3d/io/report.hpp"

namespace imic3d::io {

/// Writes the self-contained page from the loop's summary (the contents of its result.json): the sentence and the
/// verdict first; pictures of the residual; the misfit of each frame before and after with the null's band, the load
/// above, the force residual; the candidates ranked; what was tried; what the data cannot tell apart; the parameters
/// before and after; what the test cannot see; what to measure next. Throws InputError if it cannot be written.
void write_loop_page(const std::filesystem::path& page, const nlohmann::json& summary,
                     const std::vector<ReportPicture>& pictures);

}  // namespace imic3d::io
