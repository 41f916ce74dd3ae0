#pragma once
// A direct simulation as the case file's `simulate` declares it.

#include <functional>

#include "imic3d/app/setup.hpp"
#include "imic3d/mechanics/equilibrium.hpp"

namespace imic3d::app {

/// Runs frames 1, 2, … of `simulate` (frame 0 is the virgin state) and hands each to `done` on every rank, with the
/// resultant force on the loaded end [force]. Throws ConvergenceError at the first frame that cannot be reached;
/// frames before it were handed on. A specimen with an initial strain comes to rest first: that is frame 0, handed on
/// too. `beyond(frame, z)`: what is added to the prescribed displacement along the axis of a node of the loaded end, z
/// from the front face [length]. Collective.
void run_simulation(const Communicator& world, const io::Case& test, const identification::Specimen& specimen,
                    const Material& material,
                    const std::function<void(int frame, const mechanics::FrameState& state, double force)>& done,
                    const std::function<double(int frame, double z)>& beyond = {});

}  // namespace imic3d::app
