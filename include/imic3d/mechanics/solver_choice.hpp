#pragma once
// Which solver is the default: the direct one's time and memory grow faster than the unknowns.

#include <cmath>

namespace imic3d::mechanics {

/// Memory that a simulation in space takes with MUMPS's LDL^T [bytes], by plates of hex20 with 76,338 (17.8 kB an
/// unknown) to 596,568 unknowns (24.8 kB, docs/performance.md). LU keeps twice the factor of LDL^T. Sheets in plane
/// stress take less.
[[nodiscard]] inline double memory_of_direct_solver(double unknowns, bool symmetric) {
  return (symmetric ? 1.0 : 2.0) * 24.8e3 * 596568.0 * std::pow(unknowns / 596568.0, 1.16);
}

/// Beyond so many unknowns in space GMRES with two grids for quadratic elements (src/mechanics/corner_grid.hpp)
/// simulates one series in no more time than MUMPS (docs/performance.md). Where derivatives and further series make use
/// of factors MUMPS takes less at any size that fits.
constexpr double most_unknowns_of_direct_solver = 6e5;

/// MUMPS as long as it fits into the `available` memory [bytes] of all ranks that solve together and pays; else GMRES.
/// `once_by_two_grids`: whether two grids, for one series, are what there is else.
[[nodiscard]] inline bool solves_directly(double unknowns, bool symmetric, bool once_by_two_grids, double available) {
  return memory_of_direct_solver(unknowns, symmetric) <= available &&
         !(once_by_two_grids && unknowns > most_unknowns_of_direct_solver);
}

/// Whether MUMPS solves on the coarser of two grids, which has `corner_unknowns`, beside the 8 kB an unknown that the
/// finer one takes; else GAMG does.
[[nodiscard]] inline bool solves_corners_directly(double unknowns, double corner_unknowns, bool symmetric,
                                                  double available) {
  return 8e3 * unknowns + memory_of_direct_solver(corner_unknowns, symmetric) <= available;
}

}  // namespace imic3d::mechanics
