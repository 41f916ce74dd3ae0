#pragma once
// imic3d loop on the stress-strain curves of bars.

#include "imic3d/app/program.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// Collective.
void loop_on_curves(const Communicator& world, const CommandOptions& options, const io::Case& test);

}  // namespace imic3d::app
