#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "imic3d/core/error.hpp"
#include "imic3d/core/groups.hpp"

namespace imic3d {
namespace test_parallel {

TEST(Collectively, AnErrorOnOneRankIsSeenOnAll) {
  const Communicator world;
  const int last = world.size() - 1;
  EXPECT_THROW(collectively(world,
                            [&] {
                              if (world.rank() == last) throw InputError("mesh", "nothing", "something");
                            }),
               InputError);
  try {
    collectively(world, [&] {
      if (world.rank() == last) throw ConvergenceError("step 3");
    });
    FAIL();
  } catch (const ConvergenceError& error) {
    EXPECT_STREQ(error.what(), "step 3");
  }
  EXPECT_NO_THROW(collectively(world, [] {}));
}

TEST(GroupLayout, AGroupForEachTask) {
  const Communicator world;
  for (int tasks : {1, 2, 5}) EXPECT_EQ(GroupLayout(world, tasks).groups(), std::min(tasks, world.size()));
}

TEST(GroupLayout, MoreGroupsThanRanksQueue) {
  const Communicator world;
  const GroupLayout layout(world, 10, world.size() + 1);
  EXPECT_EQ(layout.groups(), world.size());
  EXPECT_EQ(layout.group().size(), 1);
}

TEST(GroupPlan, TakesTheGroupsThatEndFirst) {
  // Perfect scaling: no split is faster than one group. None: as many groups as tasks.
  EXPECT_EQ(plan_groups(4, {.tasks = 4, .serial = 0.0}).groups(), 1);
  EXPECT_EQ(plan_groups(8, {.tasks = 4, .serial = 1.0}).groups(), 4);
  // Three tasks on two ranks at half serial: two rounds of one against three of 3/4. After a task of the first group
  // alone: three against four of 3/4, so one group is as fast, and the fewer are taken.
  EXPECT_EQ(plan_groups(2, {.tasks = 3, .serial = 0.5}).groups(), 2);
  EXPECT_EQ(plan_groups(2, {.tasks = 3, .serial = 0.5, .before = 1}).groups(), 1);
  const GroupPlan uneven = plan_groups(5, {.tasks = 4, .serial = 0.5, .before = 1}, 3);
  EXPECT_EQ(uneven.ranks, (std::vector<int>{2, 2, 1}));
  EXPECT_EQ(uneven.tasks, (std::vector<int>{2, 1, 1}));
  EXPECT_DOUBLE_EQ(uneven.time, 0.75 + 1.5);
  EXPECT_DOUBLE_EQ(uneven.idle[0], 0.0);
  EXPECT_DOUBLE_EQ(uneven.idle[1], 1.0 - 0.75 / 2.25);
  EXPECT_DOUBLE_EQ(uneven.idle[2], 1.0 - 1.0 / 2.25);
  EXPECT_EQ(plan_groups(2, {.tasks = 1}, 7).groups(), 2);
}

TEST(GroupPlan, IsThatOfTheLayout) {
  const Communicator world;
  for (int groups : {1, 2, 3, 7}) {
    const GroupLayout layout(world, 4, groups);
    const GroupPlan plan = plan_groups(world.size(), {.tasks = 4}, groups);
    ASSERT_EQ(plan.groups(), layout.groups());
    EXPECT_EQ(plan.ranks[static_cast<std::size_t>(layout.index())], layout.group().size());
  }
}

TEST(GroupClock, MeasuresWhoWaits) {
  const Communicator world;
  const GroupLayout layout(world, world.size());
  GroupClock clock(layout);
  clock.side_by_side([&] { std::this_thread::sleep_for(std::chrono::milliseconds(layout.index() == 0 ? 200 : 0)); });
  const auto times = clock.times();
  ASSERT_EQ(static_cast<int>(times.size()), world.size());
  EXPECT_GE(times[0].busy, 0.2);
  for (const auto& time : times) EXPECT_EQ(time.ranks, 1);
  for (std::size_t k = 1; k < times.size(); ++k) EXPECT_GT(times[k].idle, times[k].busy);
}

}  // namespace test_parallel
}  // namespace imic3d
