#include "imic3d/mesh/partition.hpp"

#include <petscdmplex.h>
#include <petscsf.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "imic3d/mesh/petsc.hpp"

namespace imic3d::mesh {

namespace {

using OwnedDM = PetscOwner<DM, DMDestroy>;
using OwnedSF = PetscOwner<PetscSF, PetscSFDestroy>;

/// All of the mesh on rank 0: points 0 … cells - 1 are the cells, the next ones are their corners, in natural order.
OwnedDM plex_on_root(const Mesh& mesh, Communicator communicator) {
  const bool root = communicator.is_root();
  const int corners = corners_per_cell(mesh.type), dim = dimension(mesh.type);
  std::vector<PetscInt> cells;
  std::vector<PetscReal> coordinates;
  if (root) {
    std::vector<PetscInt> vertex(static_cast<std::size_t>(mesh.nodes.rows()), -1);
    for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
      for (int k = 0; k < corners; ++k) vertex[static_cast<std::size_t>(mesh.cells(c, k))] = 0;
    PetscInt vertices = 0;
    for (std::size_t i = 0; i < vertex.size(); ++i) {
      if (vertex[i] < 0) continue;
      vertex[i] = vertices++;
      for (int d = 0; d < dim; ++d) coordinates.push_back(mesh.nodes(static_cast<Eigen::Index>(i), d));
    }
    for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
      for (int k = 0; k < corners; ++k) cells.push_back(vertex[static_cast<std::size_t>(mesh.cells(c, k))]);
    if (dim == 3)  // DMPlex runs the other way round the bottom face
      for (std::size_t c = 0; c < cells.size(); c += 8) std::swap(cells[c + 1], cells[c + 3]);
  }
  OwnedDM plex;
  IMIC3D_PETSC(DMPlexCreateFromCellListPetsc(communicator.handle, dim,
                                             static_cast<PetscInt>(root ? mesh.cells.rows() : 0),
                                             static_cast<PetscInt>(coordinates.size()) / dim, corners, PETSC_TRUE,
                                             cells.data(), dim, coordinates.data(), plex.put()));
  return plex;
}

/// Recursive coordinate bisection: cuts the cells begin … end across their longest extent into `parts` parts, numbered
/// from `first`, whose numbers of cells differ by one at most. Equal coordinates are told apart by the other two.
void bisect(const Nodes& centres, std::vector<PetscInt>::iterator begin, std::vector<PetscInt>::iterator end, int parts,
            int first, std::vector<PetscInt>& sizes) {
  if (parts == 1) {
    sizes[static_cast<std::size_t>(first)] = static_cast<PetscInt>(end - begin);
    return;
  }
  Eigen::RowVector3d low = Eigen::RowVector3d::Constant(INFINITY), high = -low;
  for (auto cell = begin; cell != end; ++cell) {
    low = low.cwiseMin(centres.row(*cell));
    high = high.cwiseMax(centres.row(*cell));
  }
  const Eigen::RowVector3d extent = high - low;
  std::array<int, 3> axes{0, 1, 2};
  std::stable_sort(axes.begin(), axes.end(), [&](int a, int b) { return extent[a] > extent[b]; });
  const double unit = std::max(1e-6 * extent.maxCoeff(), 1e-300);
  const auto place = [&](PetscInt cell) {
    const auto along = [&](int axis) { return std::llround((centres(cell, axis) - low[axis]) / unit); };
    return std::array<long long, 4>{along(axes[0]), along(axes[1]), along(axes[2]), cell};
  };
  const int parts_below = parts / 2;
  const auto cut = begin + (end - begin) * parts_below / parts;
  std::nth_element(begin, cut, end, [&](PetscInt a, PetscInt b) { return place(a) < place(b); });
  bisect(centres, begin, cut, parts_below, first, sizes);
  bisect(centres, cut, end, parts - parts_below, first + parts_below, sizes);
}

/// Rank 0's proposal for `partitioner`: recursive bisection. The library partitioners that PETSc may have been built
/// with differ from call to call (Scotch goes on with its random numbers), which must not be.
void propose_bisection(const Mesh& mesh, Communicator communicator, PetscPartitioner partitioner) {
  std::vector<PetscInt> sizes(static_cast<std::size_t>(communicator.size()), 0), cells;
  if (communicator.is_root()) {
    Nodes centres = Nodes::Zero(mesh.cells.rows(), 3);
    for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
      for (int node : mesh.cells.row(c))
        centres.row(c) += mesh.nodes.row(node) / static_cast<double>(mesh.cells.cols());
    cells.resize(static_cast<std::size_t>(mesh.cells.rows()));
    std::iota(cells.begin(), cells.end(), 0);
    bisect(centres, cells.begin(), cells.end(), communicator.size(), 0, sizes);
  }
  IMIC3D_PETSC(PetscPartitionerSetType(partitioner, PETSCPARTITIONERSHELL));
  IMIC3D_PETSC(PetscPartitionerShellSetPartition(partitioner, communicator.size(), sizes.data(), cells.data()));
}

/// The natural numbers of this rank's cells, in ascending order.
std::vector<int> distributed_cells(const Mesh& mesh, Communicator communicator, const std::string& prefix) {
  const OwnedDM serial = plex_on_root(mesh, communicator);
  PetscPartitioner partitioner = nullptr;
  IMIC3D_PETSC(DMPlexGetPartitioner(serial, &partitioner));
  IMIC3D_PETSC(PetscObjectSetOptionsPrefix(reinterpret_cast<PetscObject>(partitioner), prefix.c_str()));
  propose_bisection(mesh, communicator, partitioner);
  IMIC3D_PETSC(PetscPartitionerSetFromOptions(partitioner));
  OwnedSF migration;
  OwnedDM parallel;
  IMIC3D_PETSC(DMPlexDistribute(serial, 0, migration.put(), parallel.put()));
  if (parallel.get() == nullptr) throw std::runtime_error("DMPlexDistribute made no parallel mesh");

  // The migration says where each local point came from: a cell's number on rank 0 is its natural number.
  PetscInt roots = 0, leaves = 0, cell_begin = 0, cell_end = 0;
  const PetscInt* local = nullptr;
  const PetscSFNode* origin = nullptr;
  IMIC3D_PETSC(PetscSFGetGraph(migration, &roots, &leaves, &local, &origin));
  IMIC3D_PETSC(DMPlexGetHeightStratum(parallel, 0, &cell_begin, &cell_end));
  std::vector<int> cells;
  for (PetscInt i = 0; i < leaves; ++i) {
    const PetscInt point = local != nullptr ? local[i] : i;
    if (point >= cell_begin && point < cell_end) cells.push_back(static_cast<int>(origin[i].index));
  }
  std::sort(cells.begin(), cells.end());
  return cells;
}

/// The rank of every cell, on every rank.
std::vector<int> ranks_of_cells(const Mesh& mesh, Communicator communicator, const std::vector<int>& mine) {
  std::vector<int> rank(static_cast<std::size_t>(mesh.cells.rows()), -1);
  for (int cell : mine) rank[static_cast<std::size_t>(cell)] = communicator.rank();
  MPI_Allreduce(MPI_IN_PLACE, rank.data(), static_cast<int>(rank.size()), MPI_INT, MPI_MAX, communicator.handle);
  return rank;
}

/// The owner of every node: the only rank that has cells at it or, of several, the one that owns the fewest so far.
std::vector<int> owners_of_nodes(const Mesh& mesh, const std::vector<int>& rank_of_cell, int ranks) {
  std::vector<std::vector<int>> candidates(static_cast<std::size_t>(mesh.nodes.rows()));
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    for (int node : mesh.cells.row(c)) {
      auto& at_node = candidates[static_cast<std::size_t>(node)];
      const int rank = rank_of_cell[static_cast<std::size_t>(c)];
      if (std::find(at_node.begin(), at_node.end(), rank) == at_node.end()) at_node.push_back(rank);
    }
  std::vector<int> owner(candidates.size(), -1), owned(static_cast<std::size_t>(ranks), 0);
  for (const bool shared : {false, true})
    for (std::size_t n = 0; n < candidates.size(); ++n) {
      if (candidates[n].empty()) throw std::runtime_error("mesh::partition: a node belongs to no cell");
      if ((candidates[n].size() > 1) != shared) continue;
      owner[n] = *std::min_element(candidates[n].begin(), candidates[n].end(), [&](int a, int b) {
        const int of_a = owned[static_cast<std::size_t>(a)], of_b = owned[static_cast<std::size_t>(b)];
        return of_a != of_b ? of_a < of_b : a < b;
      });
      ++owned[static_cast<std::size_t>(owner[n])];
    }
  return owner;
}

}  // namespace

Partition partition(const Mesh& mesh, Communicator communicator, const std::string& prefix) {
  const int ranks = communicator.size();
  Partition result;
  result.communicator = communicator;
  if (ranks > 1) {
    result.cells = distributed_cells(mesh, communicator, prefix);
  } else {
    result.cells.resize(static_cast<std::size_t>(mesh.cells.rows()));
    std::iota(result.cells.begin(), result.cells.end(), 0);
  }

  const std::vector<int> owner = owners_of_nodes(mesh, ranks_of_cells(mesh, communicator, result.cells), ranks);
  result.first_node.assign(static_cast<std::size_t>(ranks) + 1, 0);
  for (int rank : owner) ++result.first_node[static_cast<std::size_t>(rank) + 1];
  std::partial_sum(result.first_node.begin(), result.first_node.end(), result.first_node.begin());
  std::vector<int> next(result.first_node.begin(), result.first_node.end() - 1);
  result.global_of_natural.resize(owner.size());
  result.natural_of_global.resize(owner.size());
  for (std::size_t n = 0; n < owner.size(); ++n) {
    const int global = next[static_cast<std::size_t>(owner[n])]++;
    result.global_of_natural[n] = global;
    result.natural_of_global[static_cast<std::size_t>(global)] = static_cast<int>(n);
  }

  result.connectivity.resize(static_cast<Eigen::Index>(result.cells.size()), mesh.cells.cols());
  for (std::size_t c = 0; c < result.cells.size(); ++c)
    for (Eigen::Index k = 0; k < mesh.cells.cols(); ++k)
      result.connectivity(static_cast<Eigen::Index>(c), k) =
          result.global_of_natural[static_cast<std::size_t>(mesh.cells(result.cells[c], k))];
  return result;
}

}  // namespace imic3d::mesh
