#include <gtest/gtest.h>

#include "../../src/mechanics/corner_grid.hpp"
#include "../../src/mechanics/numbering.hpp"
#include "box.hpp"

namespace imic3d::mechanics {
namespace test_corner_grid {

using OwnedVec = PetscOwner<Vec, VecDestroy>;

/// A displacement that is linear in space moves the middles as its corners do; constrained ones stay, and no other goes
/// with a constrained corner.
TEST(CornerGrid, MovesTheMiddlesLinearly) {
  mesh::Mesh mesh = mesh::quadratic(testing::box({3, 2, 4}, {3.0, 1.5, 2.0}, 0.2));
  const auto corners = static_cast<int>(testing::box({3, 2, 4}, {3.0, 1.5, 2.0}).nodes.rows());
  const mesh::Partition partition = mesh::partition(mesh, {});
  const Numbering numbering(partition, 3);
  const auto linear = [&](int node, int component) {
    return mesh.nodes.row(node).dot(Eigen::RowVector3d(0.3, -0.2, 0.1)) + component;
  };
  std::vector<int> constrained;
  for (int node : mesh.node_groups.at("left")) constrained.push_back(3 * node + 1);
  std::sort(constrained.begin(), constrained.end());
  CornerGrid grid(partition, mesh, constrained, 3);
  ASSERT_EQ(grid.unknowns(), 3 * corners);

  OwnedVec coarse, fine;
  IMIC3D_PETSC(MatCreateVecs(grid.interpolation(), coarse.put(), fine.put()));
  PetscScalar* values = nullptr;
  IMIC3D_PETSC(VecGetArray(coarse, &values));
  int own = 0;
  for (int global = partition.first_owned(); global < partition.first_owned() + partition.owned_nodes(); ++global)
    if (const int node = partition.natural_of_global[static_cast<std::size_t>(global)]; node < corners) {
      for (int i = 0; i < 3; ++i) values[3 * own + i] = linear(node, i);
      ++own;
    }
  IMIC3D_PETSC(VecRestoreArray(coarse, &values));
  IMIC3D_PETSC(MatMult(grid.interpolation(), coarse, fine));
  const Eigen::VectorXd moved = numbering.to_natural(fine);

  const auto held = [&](int node, int i) {
    return std::binary_search(constrained.begin(), constrained.end(), 3 * node + i);
  };
  for (int node = 0; node < corners; ++node)
    for (int i = 0; i < 3; ++i) EXPECT_DOUBLE_EQ(moved[3 * node + i], linear(node, i));
  const mesh::Cells middles = mesh::edge_middles(mesh);
  ASSERT_EQ(middles.rows(), mesh.nodes.rows() - corners);
  for (Eigen::Index k = 0; k < middles.rows(); ++k)
    for (int i = 0; i < 3; ++i) {
      double expected = held(middles(k, 0), i) ? 0.0 : linear(middles(k, 0), i);
      if (!held(middles(k, 0), i))
        for (const int end : {middles(k, 1), middles(k, 2)})
          if (held(end, i)) expected -= 0.5 * linear(end, i);
      EXPECT_NEAR(moved[3 * middles(k, 0) + i], expected, 1e-14);
    }
}

/// The stiffness of the corners is that of the tangent as it is now: twice as large for twice the tangent.
TEST(CornerGrid, FollowsTheTangent) {
  const mesh::Mesh mesh = mesh::quadratic(testing::box({2, 2, 2}, {1.0, 1.0, 1.0}));
  const mesh::Partition partition = mesh::partition(mesh, {});
  CornerGrid grid(partition, mesh, {}, 3);
  PetscOwner<Mat, MatDestroy> tangent;
  PetscOwner<KSP, KSPDestroy> solver;
  const PetscInt own = 3 * partition.owned_nodes();
  IMIC3D_PETSC(MatCreateAIJ(partition.communicator.handle, own, own, PETSC_DETERMINE, PETSC_DETERMINE, 1, nullptr, 0,
                            nullptr, tangent.put()));
  IMIC3D_PETSC(MatSetBlockSize(tangent, 3));
  for (PetscInt row = 3 * partition.first_owned(); row < 3 * partition.first_owned() + own; ++row)
    IMIC3D_PETSC(MatSetValue(tangent, row, row, 1.0, INSERT_VALUES));
  IMIC3D_PETSC(MatAssemblyBegin(tangent, MAT_FINAL_ASSEMBLY));
  IMIC3D_PETSC(MatAssemblyEnd(tangent, MAT_FINAL_ASSEMBLY));
  IMIC3D_PETSC(KSPCreate(partition.communicator.handle, solver.put()));
  grid.use(solver, true, true);
  const auto stiffness = [&] {
    PC cycle = nullptr;
    KSP corners = nullptr;
    Mat matrix = nullptr;
    double norm = 0.0;
    IMIC3D_PETSC(KSPGetPC(solver, &cycle));
    IMIC3D_PETSC(PCMGGetCoarseSolve(cycle, &corners));
    IMIC3D_PETSC(KSPGetOperators(corners, &matrix, nullptr));
    IMIC3D_PETSC(MatNorm(matrix, NORM_FROBENIUS, &norm));
    return norm;
  };
  grid.update(tangent);
  const double once = stiffness();
  IMIC3D_PETSC(MatScale(tangent, 2.0));
  grid.update(tangent);
  EXPECT_GT(once, 1.0);
  EXPECT_NEAR(stiffness(), 2.0 * once, 1e-12 * once);
}

}  // namespace test_corner_grid
}  // namespace imic3d::mechanics
