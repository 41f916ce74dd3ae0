#include <gtest/gtest.h>

#include "imic3d/core/error.hpp"
#include "imic3d/core/parallel.hpp"

namespace imic3d {
namespace {

TEST(Collectively, AnErrorOnOneRankIsSeenOnAll) {
  const Communicator world;
  const int last = world.size() - 1;
  EXPECT_THROW(collectively(world, [&] { if (world.rank() == last) throw InputError("mesh", "nothing", "something"); }),
               InputError);
  try {
    collectively(world, [&] { if (world.rank() == last) throw ConvergenceError("step 3"); });
    FAIL();
  } catch (const ConvergenceError& error) {
    EXPECT_STREQ(error.what(), "step 3");
  }
  EXPECT_NO_THROW(collectively(world, [] {}));
}

TEST(GroupLayout, EveryTaskIsDoneOnceByOneGroup) {
  const Communicator world;
  for (int tasks : {1, 2, 5}) {
    const GroupLayout layout(world, tasks);
    std::vector<double> done(static_cast<std::size_t>(tasks), 0.0);
    if (layout.group().is_root())
      for (int task : layout.tasks_of_group(tasks)) done[static_cast<std::size_t>(task)] += 1.0;
    world.sum(done);
    for (double times : done) EXPECT_EQ(times, 1.0);
    EXPECT_EQ(layout.groups(), std::min(tasks, world.size()));
  }
}

TEST(GroupLayout, MoreGroupsThanRanksIsRefused) {
  const Communicator world;
  EXPECT_THROW(GroupLayout(world, 10, world.size() + 1), InputError);
}

}  // namespace
}  // namespace imic3d
