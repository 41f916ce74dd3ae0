// What holds a specimen under forces.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_support {

/// Motions in the plane that the support leaves, and how many of its directions are on the loaded end.
std::pair<Eigen::Index, int> free_and_guided(const Specimen& specimen) {
  Eigen::MatrixXd motions(0, 3);
  int guided = 0;
  for (const int dof : specimen.force_dofs) {
    const int node = dof / 3, component = dof % 3;
    if (component == 2) continue;
    motions.conservativeResize(motions.rows() + 1, 3);
    const auto& at = specimen.volume.nodes;
    motions.bottomRows(1) << (component == 0 ? 1.0 : 0.0), (component == 1 ? 1.0 : 0.0),
        (component == 0 ? -at(node, 1) : at(node, 0));
    guided += std::binary_search(specimen.loaded.begin(), specimen.loaded.end(), node) ? 1 : 0;
  }
  EXPECT_EQ(motions.rows(), 3) << "statically determinate";
  return {3 - Eigen::FullPivLU<Eigen::MatrixXd>(motions).rank(), guided};
}

/// A specimen that is held at one end alone buckles under a quarter of the compression that one bears whose other end
/// is guided.
TEST(Support, GuidesTheLoadedEnd) {
  const auto [left, guided] =
      free_and_guided(make_specimen(mesh::extrude(testing::strip(), 0.5, 1), "bottom", "top", 1, true));
  EXPECT_EQ(left, 0);
  EXPECT_EQ(guided, 1);
}

/// Where the ends are beside each other their distance along the axis keeps nothing from turning.
TEST(Support, HoldsAShortSpecimen) {
  mesh::Mesh quads = testing::strip();
  quads.nodes.col(1) *= 0.02;
  const auto [left, guided] = free_and_guided(make_specimen(mesh::extrude(quads, 0.5, 1), "bottom", "top", 1, true));
  EXPECT_EQ(left, 0);
  EXPECT_EQ(guided, 0);
}

}  // namespace test_support
}  // namespace imic3d::identification
