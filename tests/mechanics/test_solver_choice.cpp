#include <gtest/gtest.h>

#include "imic3d/mechanics/solver_choice.hpp"

namespace imic3d::mechanics {
namespace test_solver_choice {

TEST(SolverChoice, MemoryIsWhatWasMeasured) {
  EXPECT_NEAR(memory_of_direct_solver(596568, true), 14.8e9, 0.1e9);
  EXPECT_NEAR(memory_of_direct_solver(76338, true), 1.30e9, 0.1e9);
  EXPECT_DOUBLE_EQ(memory_of_direct_solver(5e5, false), 2.0 * memory_of_direct_solver(5e5, true));
}

TEST(SolverChoice, IsDirectWhereTheMemorySuffices) {
  EXPECT_TRUE(solves_directly(3474, true, false, 1e9));
  EXPECT_TRUE(solves_directly(596568, true, false, 16e9));
  EXPECT_FALSE(solves_directly(596568, false, false, 16e9)) << "LU";
  EXPECT_FALSE(solves_directly(1e6, true, false, 16e9));
  EXPECT_TRUE(solves_directly(1e6, true, false, 2 * 16e9)) << "of two machines";
  EXPECT_TRUE(solves_directly(1e8, true, false, INFINITY));
}

TEST(SolverChoice, IsTwoGridsWhereTheyTakeLessTime) {
  EXPECT_TRUE(solves_directly(0.99 * most_unknowns_of_direct_solver, true, true, INFINITY));
  EXPECT_FALSE(solves_directly(1.01 * most_unknowns_of_direct_solver, true, true, INFINITY));
  EXPECT_TRUE(solves_corners_directly(1e6, 2.6e5, true, 16e9));
  EXPECT_FALSE(solves_corners_directly(1e6, 2.6e5, true, 10e9));
}

}  // namespace test_solver_choice
}  // namespace imic3d::mechanics
