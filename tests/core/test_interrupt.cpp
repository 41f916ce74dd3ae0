#include <gtest/gtest.h>

#include <csignal>
#include <utility>

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

TEST(Interrupt, EachSignalIsNamedAndForgottenAfterwards) {
  const Communicator world;
  for (const auto& [signal, name] :
       {std::pair{SIGTERM, "SIGTERM"}, {SIGUSR1, "SIGUSR1"}, {SIGINT, "SIGINT"}, {SIGHUP, "SIGHUP"}}) {
    {
      const SignalWatch watch;
      std::raise(signal);
      try {
        stop_if_asked(world);
        FAIL() << name;
      } catch (const Interrupted& stopped) {
        EXPECT_STREQ(stopped.what(), name);
      }
    }
    struct sigaction now {};
    sigaction(signal, nullptr, &now);
    EXPECT_EQ(now.sa_handler, SIG_DFL) << name;
    const SignalWatch watch;
    EXPECT_NO_THROW(stop_if_asked(world)) << name;
  }
}

TEST(Interrupt, TheSecondOfTheKeyboardEndsTheProcess) {
  const SignalWatch watch;
  std::raise(SIGINT);
  struct sigaction now {};
  sigaction(SIGINT, nullptr, &now);
  EXPECT_EQ(now.sa_handler, SIG_DFL);
}

TEST(Interrupt, WhatNohupIgnoresStaysIgnored) {
  const Communicator world;
  const auto before = std::signal(SIGHUP, SIG_IGN);
  {
    const SignalWatch watch;
    std::raise(SIGHUP);
    EXPECT_NO_THROW(stop_if_asked(world));
  }
  EXPECT_EQ(std::signal(SIGHUP, before), SIG_IGN);
}

TEST(Interrupt, KeepsItsTypeOnEveryRank) {
  const Communicator world;
  EXPECT_THROW(collectively(world,
                            [&] {
                              if (world.rank() == world.size() - 1) throw Interrupted("SIGTERM");
                            }),
               Interrupted);
}

}  // namespace test_interrupt
}  // namespace imic3d
