#include <gtest/gtest.h>

#include "imic3d/mechanics/solver_choice.hpp"

namespace imic3d::mechanics {
namespace {

TEST(SolverChoice, MemoryIsWhatWasMeasured) {
  EXPECT_NEAR(memory_of_direct_solver(596568, true), 14.8e9, 0.1e9);
  EXPECT_NEAR(memory_of_direct_solver(76338, true), 1.30e9, 0.1e9);
  EXPECT_DOUBLE_EQ(memory_of_direct_solver(5e5, false), 2.0 * memory_of_direct_solver(5e5, true));
}

TEST(SolverChoice, IsDirectWhereTheMemorySuffices) {
  EXPECT_TRUE(solves_directly(3474, true, 1e9));
  EXPECT_TRUE(solves_directly(596568, true, 16e9));
  EXPECT_FALSE(solves_directly(596568, false, 16e9)) << "LU";
  EXPECT_FALSE(solves_directly(1e6, true, 16e9));
  EXPECT_TRUE(solves_directly(1e6, true, 2 * 16e9)) << "of two machines";
  EXPECT_TRUE(solves_directly(1e8, true, INFINITY));
}

}  // namespace
}  // namespace imic3d::mechanics
