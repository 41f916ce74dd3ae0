#pragma once
// What the assembler gets from an element, whatever its shape.

#include <Eigen/Core>
#include <array>
#include <span>

#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::mechanics {

/// Positions of an element's nodes [nodes x axes, length]; values of its degrees of freedom, node by node x, y (, z).
template <int nodes, int axes = 3>
using ElementNodes = Eigen::Matrix<double, nodes, axes>;
template <int nodes, int axes = 3>
using ElementVector = Eigen::Matrix<double, axes * nodes, 1>;

/// Internal force, consistent tangent and cell averages of one element.
template <int nodes, int axes = 3>
struct ElementResult {
  ElementVector<nodes, axes> force;                           ///< internal forces [force]
  Eigen::Matrix<double, axes * nodes, axes * nodes> tangent;  ///< d(force)/d(displacement) [force/length]
  material::Vector6 cauchy_stress;                            ///< volume average of the Cauchy stress [stress]
  /// volume average of the accumulated plastic strain [-]
  double plastic_strain = 0.0;
};

/// Directions in which displacement, parameters and old history of a step all move; elements take up to this many at
/// once.
inline constexpr int most_directions = 4;

/// Values of an element's degrees of freedom in each direction [dofs x n].
template <int nodes, int axes = 3>
using ElementColumns =
    Eigen::Matrix<double, axes * nodes, Eigen::Dynamic, Eigen::ColMajor, axes * nodes, most_directions>;

/// The parameters and the history of an element in each of n directions, as FiniteStrainLaw::directional_derivatives
/// takes them.
struct ElementDirections {
  std::span<const double> parameters;   ///< [n x number of parameters]
  std::span<const double> history_old;  ///< [points x n x history_size]
  std::span<double> history_new;        ///< [points x n x history_size]
};

/// Derivatives of a point's deformation gradient and of its Kirchhoff stress in n directions. L = dF F^-1.
struct PointDirections {
  std::array<material::Matrix3, most_directions> L, dF;
  std::array<material::Vector6, most_directions> d_kirchhoff;
  material::Vector6 kirchhoff;
  /// From dF to the stresses and the new history.
  [[nodiscard]] bool update(const material::FiniteStrainLaw& law, const material::Matrix3& F, double time_increment,
                            std::span<const double> parameters, std::span<const double> history_old, std::size_t point,
                            std::size_t n, const ElementDirections& along) noexcept {
    const auto size = static_cast<std::size_t>(law.history_size());
    return law.directional_derivatives(
        F, std::span(dF).first(n), time_increment, parameters, along.parameters,
        history_old.subspan(point * size, size), along.history_old.subspan(point * n * size, n * size), kirchhoff,
        std::span(d_kirchhoff).first(n), along.history_new.subspan(point * n * size, n * size));
  }
};

/// A symmetric tensor of its components 11, 22, 33, 12, 23, 13.
[[nodiscard]] inline Eigen::Matrix3d tensor(const material::Vector6& v) {
  Eigen::Matrix3d t;
  t << v[0], v[3], v[5], v[3], v[1], v[4], v[5], v[4], v[2];
  return t;
}

}  // namespace imic3d::mechanics
