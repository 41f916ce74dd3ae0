#include <gtest/gtest.h>

#include "imic3d/core/interrupt.hpp"

namespace imic3d {
namespace test_interrupt {

TEST(Interrupt, ASignalOnOneRankStopsAll) {
  const Communicator world;
  const SignalWatch watch;
  EXPECT_NO_THROW(stop_if_asked(world));
  if (world.rank() == world.size() - 1) std::raise(SIGTERM);
  for (int again = 0; again < 2; ++again) {
    try {
      stop_if_asked(world);
      FAIL();
    } catch (const Interrupted& stopped) {
      EXPECT_STREQ(stopped.what(), "SIGTERM");
    }
  }
}

TEST(Interrupt, TheSignalIsNamedAndForgottenAfterwards) {
  const Communicator world;
  {
    const SignalWatch watch;
    std::raise(SIGUSR1);
    try {
      stop_if_asked(world);
      FAIL();
    } catch (const Interrupted& stopped) {
      EXPECT_STREQ(stopped.what(), "SIGUSR1");
    }
  }
  struct sigaction now {};
  sigaction(SIGUSR1, nullptr, &now);
  EXPECT_EQ(now.sa_handler, SIG_DFL);
  const SignalWatch watch;
  EXPECT_NO_THROW(stop_if_asked(world));
}

TEST(Interrupt, KeepsItsTypeOnEveryRank) {
  const Communicator world;
  EXPECT_THROW(collectively(world, [&] { if (world.rank() == world.size() - 1) throw Interrupted("SIGTERM"); }), Interrupted);
}

}  // namespace test_interrupt
}  // namespace imic3d
