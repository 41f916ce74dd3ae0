#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "imic3d/mesh/partition.hpp"
#include "imic3d/mesh/petsc.hpp"
#include "meshes.hpp"

namespace imic3d::mesh {
namespace test_partition {

/// Everything that assembly relies on, on every rank.
void expect_consistent(const Mesh& mesh, const Partition& partition) {
  const Communicator world = partition.communicator;
  const auto nodes = static_cast<std::size_t>(mesh.nodes.rows()), cells = static_cast<std::size_t>(mesh.cells.rows());

  std::vector<double> times(cells, 0.0);
  for (int cell : partition.cells) times[static_cast<std::size_t>(cell)] += 1.0;
  world.sum(times);
  EXPECT_TRUE(std::all_of(times.begin(), times.end(), [](double n) { return n == 1.0; })) << "a cell not on one rank";
  EXPECT_TRUE(std::is_sorted(partition.cells.begin(), partition.cells.end()));

  // A permutation that is the same on every rank.
  ASSERT_EQ(partition.natural_of_global.size(), nodes);
  std::vector<double> global(nodes);
  for (std::size_t n = 0; n < nodes; ++n) {
    const int g = partition.global_of_natural[n];
    ASSERT_GE(g, 0);
    ASSERT_LT(g, static_cast<int>(nodes));
    EXPECT_EQ(partition.natural_of_global[static_cast<std::size_t>(g)], static_cast<int>(n));
    global[n] = g;
  }
  std::vector<double> of_root = global;
  world.broadcast(of_root);
  EXPECT_EQ(of_root, global);

  // Contiguous ownership, by a rank that has a cell at the node; connectivity in the mesh's corner order.
  ASSERT_EQ(partition.first_node.size(), static_cast<std::size_t>(world.size()) + 1);
  EXPECT_EQ(partition.first_node.front(), 0);
  EXPECT_EQ(partition.first_node.back(), static_cast<int>(nodes));
  std::set<int> touched;
  for (std::size_t c = 0; c < partition.cells.size(); ++c)
    for (Eigen::Index k = 0; k < mesh.cells.cols(); ++k) {
      const int g = partition.connectivity(static_cast<Eigen::Index>(c), k);
      touched.insert(g);
      EXPECT_EQ(partition.natural_of_global[static_cast<std::size_t>(g)], mesh.cells(partition.cells[c], k));
    }
  for (int g = partition.first_owned(); g < partition.first_owned() + partition.owned_nodes(); ++g)
    EXPECT_TRUE(touched.contains(g)) << "node " << g << " without a cell on its rank";
}

TEST(Partition, HexahedraAreSharedOutEvenly) {
  const Mesh mesh = extrude(grid(12, 10), 3.0, 3);
  const Partition parts = partition(mesh, Communicator{});
  expect_consistent(mesh, parts);
  const double mean = static_cast<double>(mesh.cells.rows()) / parts.communicator.size();
  EXPECT_NEAR(static_cast<double>(parts.cells.size()), mean, 0.1 * mean);
  const double owned = static_cast<double>(mesh.nodes.rows()) / parts.communicator.size();
  EXPECT_NEAR(parts.owned_nodes(), owned, 0.25 * owned);
}

TEST(Partition, QuadrilateralsAndTheGroupsOfASplitCommunicator) {
  const Mesh mesh = grid(9, 7);
  expect_consistent(mesh, partition(mesh, Communicator{}));
  const Mesh curved = quadratic(mesh);
  expect_consistent(curved, partition(curved, Communicator{}));
  const GroupLayout layout(Communicator{}, 2);
  expect_consistent(mesh, partition(mesh, layout.group()));
}

TEST(Partition, FewerCellsThanRanks) {
  const Mesh mesh = extrude(grid(2, 1), 1.0, 1);
  expect_consistent(mesh, partition(mesh, Communicator{}));
}

TEST(Partition, IsTheSameEveryTime) {
  const Mesh mesh = extrude(grid(15, 11), 3.0, 2);
  const Partition first = partition(mesh, Communicator{});
  for (int again = 0; again < 3; ++again) {
    const Partition other = partition(mesh, Communicator{});
    EXPECT_EQ(other.cells, first.cells);
    EXPECT_EQ(other.natural_of_global, first.natural_of_global);
  }
}

TEST(Petsc, AnErrorIsAnException) {
  PetscPushErrorHandler(PetscIgnoreErrorHandler, nullptr);
  EXPECT_THROW(IMIC3D_PETSC(PetscOptionsSetValue(nullptr, "no dash", "1")), std::runtime_error);
  PetscPopErrorHandler();
}

}  // namespace test_partition
}  // namespace imic3d::mesh
