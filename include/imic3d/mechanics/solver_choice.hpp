#pragma once
// Which solver is the default: the direct one is the faster at every size that was measured, but its memory grows faster than the unknowns.

#include <cmath>

namespace imic3d::mechanics {

/// Memory that a simulation in space takes with MUMPS's LDL^T [bytes], by plates of hex20 with 76,338 (17.8 kB an unknown) to 596,568 unknowns (24.8 kB,
/// docs/performance.md). LU keeps twice the factor of LDL^T. Sheets in plane stress take less.
[[nodiscard]] inline double memory_of_direct_solver(double unknowns, bool symmetric) {
  return (symmetric ? 1.0 : 2.0) * 24.8e3 * 596568.0 * std::pow(unknowns / 596568.0, 1.16);
}

/// MUMPS as long as it fits into the `available` memory [bytes] of all ranks that solve together, else CG (GMRES) with GAMG.
[[nodiscard]] inline bool solves_directly(double unknowns, bool symmetric, double available) {
  return memory_of_direct_solver(unknowns, symmetric) <= available;
}

}  // namespace imic3d::mechanics
