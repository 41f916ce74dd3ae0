// imic3d simulate: the equilibrium path under prescribed displacement or force.

#include <fmt/format.h>

#include <chrono>

#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/simulation.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

void simulate(const Communicator& world, const CommandOptions& options) {
  const io::Case test = read_case(options, {"specimen", "material", "simulate"}, false);
  refuse_effects(test, "simulate");
  const Material material = make_material(test);
  const identification::Specimen specimen = make_specimen(test);
  SimulationOutput output(world, output_folder(test, options, world), test, specimen);
  if (world.is_root()) fmt::print("{}\n  frame  {:>14}  {:>14}\n", test.title, test.simulate->control, "force");
  run_simulation(world, test, specimen, material, [&](int frame, const mechanics::FrameState& state, double force) {
    output.frame(frame, state, force);
    if (world.is_root())
      fmt::print("  {:5}  {:14.6g}  {:14.6g}\n", frame, test.simulate->value[static_cast<std::size_t>(frame)], force);
  });
  output.finish();
}

}  // namespace imic3d::app
