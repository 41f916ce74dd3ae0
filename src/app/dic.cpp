// imic3d dic: the displacement of every frame by global finite-element correlation.

#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <map>

#include "imic3d/app/observation.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/core/log.hpp"
#include "several_cameras.hpp"

namespace imic3d::app {

void dic(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const io::Case test = read_case(options, {"cameras"}, true);
  if (several_cameras(test)) {
    dic_with_several(world, options, test);
    return;
  }
  const identification::Specimen specimen = make_specimen(test);
  Observation seen = observe(test, specimen);
  RunOutput output(world, output_folder(test, options, world), test, specimen, Material{}, seen);
  spdlog::info("{}: {} frames, {} elements", test.title, seen.places.size(), specimen.surface.mesh.cells.rows());
  GroupTimes times;
  correlate(seen, test, world,
            [&](int place, const correlation::DicFrame& frame) {
              output.dic_frame(place, frame);
              spdlog::info("  frame {}: residual {:.3f} grey levels, {} iterations{}",
                           test.frames[static_cast<std::size_t>(place)], frame.rms, frame.iterations,
                           frame.converged ? "" : ", not converged");
            },
            {.reached = [&](std::size_t, const correlation::DicSeries& series) {
              times["correlation"] = series.group_times;
            }});
  say(times);
  output.noise(seen.noise);
  output.finish(Material{}, {}, {}, std::nan(""),
                std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), times);
}

}  // namespace imic3d::app
