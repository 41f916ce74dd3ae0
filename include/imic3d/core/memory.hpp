#pragma once
// How much memory there is for this program.

#include <filesystem>

#include "imic3d/core/parallel.hpp"

namespace imic3d {

/// What the machine can give to new work, as its kernel counts it (MemAvailable), no more than the control group of
/// this process may have (containers, batch systems) [bytes]; infinite where neither is known. `root`: of the system's
/// folders proc and sys.
[[nodiscard]] double available_memory(const std::filesystem::path& root = "/");

/// Of it, the share of this rank among the communicator's on this machine [bytes]. Collective.
[[nodiscard]] double memory_of_a_rank(const Communicator& communicator);

}  // namespace imic3d
