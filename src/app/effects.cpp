// imic3d effects: the effects that the loop knows and virtual tests can have.

#include <fmt/format.h>

#include "imic3d/app/program.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

void effects(const Communicator& world, const CommandOptions& options) {
  const io::Units units =
      options.case_file.empty() ? io::Units{.length = "length", .force = "force", .time = "time"} : read_case(options, {}, false).units;
  if (!world.is_root()) return;
  for (const auto& effect : loop::all_effects()) {
    const auto description = effect->describe(unit_scene());
    fmt::print("{} ({}): {}\n", loop::key_of(description.name), name(description.link), description.sentence);
    for (const auto& q : description.quantities)
      fmt::print("    {:24} null {:<4g} [{}]  {}\n", q.name, q.null, unit_in(q.unit, units), q.description);
    if (!description.confused_with.empty())
      fmt::print("    confused with {}; told apart by {}\n", description.confused_with, description.separated_by);
    if (effect->of_each_camera()) fmt::print("    with cameras on both faces: front_{0}, back_{0}\n", loop::key_of(description.name));
  }
  fmt::print("Every parameter of the material's law that has a null value, and Poisson's ratio where it is not free, is a candidate too.\n");
}

}  // namespace imic3d::app
