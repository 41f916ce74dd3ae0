#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "imic3d/core/memory.hpp"

namespace imic3d {
namespace test_memory {

void write(const std::filesystem::path& file, const std::string& text) {
  std::filesystem::create_directories(file.parent_path());
  std::ofstream(file) << text;
}

TEST(Memory, IsTheLeastThatMachineAndControlGroupsAllow) {
  const auto root = std::filesystem::temp_directory_path() / ("imic3d_memory_" + std::to_string(Communicator{}.rank()));
  std::filesystem::remove_all(root);
  EXPECT_EQ(available_memory(root), INFINITY);
  write(root / "proc/meminfo",
        "MemTotal:       24000 kB\nMemFree:  1000 kB\nMemAvailable:   20000 kB\nBuffers: 3 kB\n");
  EXPECT_EQ(available_memory(root), 20000.0 * 1024.0);
  write(root / "proc/self/cgroup", "1:name=systemd:/elsewhere\n0::/job/step\n");
  write(root / "sys/fs/cgroup/job/step/memory.max", "max\n");
  EXPECT_EQ(available_memory(root), 20000.0 * 1024.0);
  write(root / "sys/fs/cgroup/job/memory.max", "8000000\n");
  EXPECT_EQ(available_memory(root), 8e6);
  std::filesystem::remove_all(root);
}

TEST(Memory, IsSharedByTheRanksOfAMachine) {
  const Communicator world, alone{MPI_COMM_SELF};
  const double share = memory_of_a_rank(world), all = memory_of_a_rank(alone);
  EXPECT_GT(share, 0.0);
  EXPECT_NEAR(share * world.size() / all, 1.0, 0.2) << "all ranks on one machine";
}

}  // namespace test_memory
}  // namespace imic3d
