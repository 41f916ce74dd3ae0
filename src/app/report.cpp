// imic3d report: the page of a run from its results file.

#include "imic3d/io/report.hpp"

#include <fmt/format.h>

#include "imic3d/app/program.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/results_file.hpp"

namespace imic3d::app {

void report(const Communicator& world, const CommandOptions& options) {
  collectively(world, [&] {
    if (!world.is_root()) return;
    const auto file = io::ResultsFile::open(options.case_file);
    const auto folder = options.output.empty() ? options.case_file.parent_path() : options.output;
    std::filesystem::create_directories(folder.empty() ? "." : folder);
    io::draw_pictures(file, folder);
    io::write_report(folder / "report.html", file, io::pictures_in(folder));
    fmt::print("{}\n", (folder / "report.html").string());
  });
}

}  // namespace imic3d::app
