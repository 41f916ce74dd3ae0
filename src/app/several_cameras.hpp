#pragma once
// imic3d dic with perspective cameras, one or several.

#include <string>

#include "imic3d/app/program.hpp"
#include "imic3d/core/parallel.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// Whether a case has several cameras, or a perspective one.
[[nodiscard]] bool several_cameras(const io::Case& test);

/// The displacement of every frame; writes results.h5, results.xdmf, result.json, motion.csv, pictures; cameras on both
/// faces: a folder for each, `front` and `back`.
void dic_with_several(const Communicator& world, const CommandOptions& options, const io::Case& test);

}  // namespace imic3d::app
