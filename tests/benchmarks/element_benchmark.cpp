// Time of one element with its law, plastic at all its points, and of the assembly of a plate, which inserts the
// tangents into PETSc's matrix (MatSetValuesCOO). Run: OMP_NUM_THREADS=1
// build/release/tests/benchmarks/benchmark_element
#include <benchmark/benchmark.h>
#include <petsc.h>

#include <cstdlib>

#include "imic3d/mechanics/assembler.hpp"
#include "imic3d/mechanics/hexahedron.hpp"
#include "imic3d/mechanics/quadrilateral.hpp"
#include "imic3d/mesh/petsc.hpp"
#include "waves.hpp"

namespace imic3d::mechanics {
namespace {

using mesh::CellType;
using mesh::Integration;

/// nx x ny elements of one unit of length, hexahedra in one layer.
mesh::Mesh plate(CellType type, Integration integration, int nx, int ny) {
  const bool plane = mesh::dimension(type) == 2;
  mesh::Mesh mesh = benchmarks::sheet(nx + 1, ny + 1, nx, ny, 0.0);
  if (!plane) mesh = mesh::extrude(mesh, 1.0, 1);
  if (type == CellType::hex20 || type == CellType::quad8) mesh = mesh::quadratic(mesh);
  mesh.integration = integration;
  return mesh;
}

/// The paper's steel.
std::shared_ptr<const material::FiniteStrainLaw> steel(bool plane) {
  return material::make_law({.plane_stress = plane});
}
const std::vector<double> parameters{198e3, 0.25, 284, 1480, 0.042, 7.16e-5};

/// A stretch with shear and a little bending, which yields everywhere.
double displacement(double x, double y, int axis) {
  constexpr double first = 0.02, second = -0.009;
  return axis == 0 ? first * x + 0.002 * y + 1e-5 * x * y : axis == 1 ? second * y : 0.0;
}

// ---- one element ----

/// After one plastic step, about to take a second one.
template <int nodes, int axes>
class Element {
 public:
  explicit Element(const mesh::Mesh& mesh)
      : integration_(mesh.integration), law_(steel(axes == 2)), elastic_(elastic_moduli(*law_, parameters)) {
    for (int a = 0; a < nodes; ++a)
      for (int i = 0; i < axes; ++i) {
        places_(a, i) = mesh.nodes(mesh.cells(0, a), i);
        u_[axes * a + i] = displacement(mesh.nodes(mesh.cells(0, a), 0), mesh.nodes(mesh.cells(0, a), 1), i);
      }
    const int points = axes == 2 ? quadrilateral_points : integration_ == Integration::full ? hexahedron_points : 1;
    HistoryField virgin(*law_, 1, points, integration_ == Integration::one_point_stabilised ? hourglass_state : 0);
    history_.assign(virgin.converged(0).begin(), virgin.converged(0).end());
    next_ = history_;
    if (!evaluate_it(false)) std::abort();
    history_ = next_;
    u_ *= 1.25;
    first_ = result.plastic_strain;
  }

  bool evaluate_it(bool with_tangent) {
    if constexpr (axes == 2) {
      return evaluate<nodes>(*law_, 1.0, parameters, 1.0, places_, u_, history_, next_, result, with_tangent);
    } else {
      if constexpr (nodes == 8)
        if (integration_ != Integration::full)
          return evaluate_one_point(*law_, parameters, 1.0, places_, u_, history_, next_, result, with_tangent,
                                    &elastic_);
      return evaluate(*law_, parameters, 1.0, places_, u_, history_, next_, result, with_tangent);
    }
  }
  [[nodiscard]] bool yields() const { return first_ > 0.0 && result.plastic_strain > first_; }

  ElementResult<nodes, axes> result;

 private:
  Integration integration_;
  std::shared_ptr<const material::FiniteStrainLaw> law_;
  ElasticModuli elastic_;
  ElementNodes<nodes, axes> places_;
  ElementVector<nodes, axes> u_;
  std::vector<double> history_, next_;
  double first_ = 0.0;
};

template <int nodes, int axes>
void element(benchmark::State& state, const mesh::Mesh& mesh, bool with_tangent) {
  Element<nodes, axes> made(mesh);
  for (auto _ : state) {
    if (!made.evaluate_it(with_tangent)) std::abort();
    benchmark::DoNotOptimize(made.result);
  }
  if (!made.yields()) state.SkipWithError("the element does not yield");
}
void hex20(benchmark::State& state, bool with_tangent) {
  element<20, 3>(state, plate(CellType::hex20, Integration::full, 1, 1), with_tangent);
}
void hex8(benchmark::State& state, bool with_tangent) {
  element<8, 3>(state, plate(CellType::hex8, Integration::full, 1, 1), with_tangent);
}
void hex8s(benchmark::State& state, bool with_tangent) {
  element<8, 3>(state, plate(CellType::hex8, Integration::one_point_stabilised, 1, 1), with_tangent);
}
void quad8(benchmark::State& state, bool with_tangent) {
  element<8, 2>(state, plate(CellType::quad8, Integration::full, 1, 1), with_tangent);
}
BENCHMARK_CAPTURE(hex20, force, false);
BENCHMARK_CAPTURE(hex20, force_and_tangent, true);
BENCHMARK_CAPTURE(hex8, force, false);
BENCHMARK_CAPTURE(hex8, force_and_tangent, true);
BENCHMARK_CAPTURE(hex8s, force, false);
BENCHMARK_CAPTURE(hex8s, force_and_tangent, true);
BENCHMARK_CAPTURE(quad8, force, false);
BENCHMARK_CAPTURE(quad8, force_and_tangent, true);

// ---- a plate ----

using OwnedVec = PetscOwner<Vec, VecDestroy>;
OwnedVec zeros(const Assembler& assembler) {
  OwnedVec made;
  IMIC3D_PETSC(MatCreateVecs(assembler.tangent(), made.put(), nullptr));
  return made;
}

OwnedVec displacement(const mesh::Mesh& mesh, const mesh::Partition& partition, const Assembler& assembler) {
  OwnedVec made = zeros(assembler);
  const int axes = assembler.axes();
  for (Eigen::Index node = 0; node < mesh.nodes.rows(); ++node)
    for (int i = 0; i < axes; ++i) {
      const PetscInt row = axes * partition.global_of_natural[static_cast<std::size_t>(node)] + i;
      IMIC3D_PETSC(VecSetValue(made, row, displacement(mesh.nodes(node, 0), mesh.nodes(node, 1), i), INSERT_VALUES));
    }
  IMIC3D_PETSC(VecAssemblyBegin(made));
  IMIC3D_PETSC(VecAssemblyEnd(made));
  return made;
}

/// Seconds of wall time that PETSc's log has of an event so far.
double spent_on(const char* event) {
  PetscEventPerfInfo info;
  IMIC3D_PETSC(PetscLogEventGetPerfInfo(PETSC_DETERMINE, LoggedEvent::named(event), &info));
  return info.time;
}

/// 20 x 20 elements beyond yield.
void assembly(benchmark::State& state, CellType type, Integration integration, bool with_tangent) {
  const mesh::Mesh mesh = plate(type, integration, 20, 20);
  const mesh::Partition partition = mesh::partition(mesh, Communicator{MPI_COMM_SELF});
  Assembler assembler(partition, mesh, steel(mesh::dimension(type) == 2),
                      std::vector<char>(static_cast<std::size_t>(3 * mesh.nodes.rows()), 0));
  const OwnedVec u = displacement(mesh, partition, assembler), force = zeros(assembler), increment = zeros(assembler),
                 lifting = zeros(assembler);
  const double all = spent_on("imic3dTangent"), insertion = spent_on("MatSetValuesCOO");
  for (auto _ : state)
    if (!assembler.assemble(u, 1.0, parameters, force, with_tangent ? increment.get() : nullptr, lifting)) std::abort();
  if (!(assembler.plastic_strain().minCoeff() > 0.0)) state.SkipWithError("the plate does not yield");
  PetscInt unknowns = 0;
  IMIC3D_PETSC(VecGetSize(u, &unknowns));
  state.counters["unknowns"] = static_cast<double>(unknowns);
  if (with_tangent)
    state.counters["insertion_share"] = (spent_on("MatSetValuesCOO") - insertion) / (spent_on("imic3dTangent") - all);
}
BENCHMARK_CAPTURE(assembly, hex20_forces, CellType::hex20, Integration::full, false)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(assembly, hex20_tangent, CellType::hex20, Integration::full, true)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(assembly, hex8s_tangent, CellType::hex8, Integration::one_point_stabilised, true)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(assembly, quad8_tangent, CellType::quad8, Integration::full, true)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace imic3d::mechanics

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (PetscInitialize(&argc, &argv, nullptr, nullptr) != 0 || PetscLogDefaultBegin() != 0) return 1;
  benchmark::RunSpecifiedBenchmarks();
  PetscFinalize();
}
