#include "imic3d/core/memory.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <string>

namespace imic3d {

namespace {

namespace fs = std::filesystem;

/// "MemAvailable:   23456 kB"
double available_of_machine(const fs::path& root) {
  std::ifstream file(root / "proc/meminfo");
  std::string name, unit;
  for (double value = 0.0; file >> name >> value; std::getline(file, unit))
    if (name == "MemAvailable:") return 1024.0 * value;
  return INFINITY;
}

/// The least limit of the control group of this process ("0::/path", version 2) and of those that it is in; a group
/// without one says "max".
double limit_of_groups(const fs::path& root) {
  double least = INFINITY;
  std::ifstream file(root / "proc/self/cgroup");
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("0::/")) continue;
    for (fs::path group = line.substr(4);; group = group.parent_path()) {
      double limit = 0.0;
      if (std::ifstream(root / "sys/fs/cgroup" / group / "memory.max") >> limit) least = std::min(least, limit);
      if (group.empty()) break;
    }
  }
  return least;
}

}  // namespace

double available_memory(const fs::path& root) { return std::min(available_of_machine(root), limit_of_groups(root)); }

double memory_of_a_rank(const Communicator& communicator) {
  Communicator machine;
  MPI_Comm_split_type(communicator.handle, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &machine.handle);
  const double share = -machine.max(-available_memory()) / machine.size();
  MPI_Comm_free(&machine.handle);
  return share;
}

}  // namespace imic3d
