// imic3d report: the page of a run from its results file.

#include "imic3d/io/report.hpp"

#include <fmt/format.h>

#include <cmath>
#include <fstream>

#include "imic3d/app/program.hpp"
#include "imic3d/io/explain_page.hpp"
#include "imic3d/io/loop_page.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/results_file.hpp"

namespace imic3d::app {

namespace {

/// Numbers that are not finite have no other word in JSON.
void null_is_nan(nlohmann::json& json) {
  if (json.is_null()) json = std::nan("");
  if (json.is_structured())
    for (auto& one : json) null_is_nan(one);
}

/// The result.json beside a results.h5; nothing, if it cannot be read.
nlohmann::json result_in(const std::filesystem::path& folder) {
  auto summary = nlohmann::json::parse(std::ifstream(folder / "result.json"), nullptr, false);
  null_is_nan(summary);
  return summary.is_object() ? summary : nlohmann::json::object();
}

/// The page of a loop is made of its result.json and of the pictures beside it.
void report_loop(const std::filesystem::path& page, const std::filesystem::path& folder) {
  const auto summary = result_in(folder);
  if (!summary.contains("verdict"))
    throw InputError((folder / "result.json").string(), "cannot be read",
                     "the result.json that imic3d loop left beside results.h5");
  std::vector<io::ReportPicture> pictures;
  if (summary.contains("pictures"))
    for (const auto& picture : summary["pictures"])
      pictures.push_back({folder / picture["file"].get<std::string>(), picture["caption"].get<std::string>()});
  io::write_loop_page(page, summary, pictures);
}

void report_run(const std::filesystem::path& page, const io::ResultsFile& file) {
  const auto summary = result_in(file.path().parent_path());
  std::vector<std::string> doubts;
  if (summary.contains("doubts")) doubts = summary["doubts"].get<std::vector<std::string>>();
  if (summary.contains("difference_percent")) return io::write_explain_page(page, summary);
  io::draw_pictures(file, page.parent_path());
  io::write_report(page, file, io::pictures_in(page.parent_path()), doubts);
}

}  // namespace

void report(const Communicator& world, const CommandOptions& options) {
  collectively(world, [&] {
    if (!world.is_root()) return;
    const auto results =
        std::filesystem::is_directory(options.case_file) ? options.case_file / "results.h5" : options.case_file;
    const auto file = io::ResultsFile::open(results);
    const auto beside = results.has_parent_path() ? results.parent_path() : ".";
    const auto page = (options.output.empty() ? beside : options.output) / "report.html";
    std::filesystem::create_directories(page.parent_path());
    if (file.has("loop/frames"))
      report_loop(page, beside);
    else if (file.has("frames/number"))
      report_run(page, file);
    else
      throw InputError(results.string(), "nothing that a page is made of",
                       "results.h5 of imic3d identify on images, dic, simulate, virtual, explain or loop");
    fmt::print("{}\n", page.string());
  });
}

}  // namespace imic3d::app
