#pragma once
// One self-contained page about a run.

#include <filesystem>
#include <string>
#include <vector>

#include "imic3d/io/results_file.hpp"

namespace imic3d::io {

/// A picture (PNG) of the report with the line below it.
struct ReportPicture {
  std::filesystem::path file;
  std::string caption;
};

/// Writes report.html from a results file: what is doubted (a sentence each), parameters with standard deviations,
/// curves, pictures (embedded), a table of the frames, the case file and the versions. Sections whose data the file
/// does not have are left out. A picture that cannot be read is left out. Throws InputError if the page cannot be
/// written.
void write_report(const std::filesystem::path& page, const ResultsFile& file,
                  const std::vector<ReportPicture>& pictures = {}, const std::vector<std::string>& doubts = {});

/// All .png files of a folder in natural order, captions from their names.
[[nodiscard]] std::vector<ReportPicture> pictures_in(const std::filesystem::path& folder);

}  // namespace imic3d::io
