#pragma once
// What the assembler gets from an element, whatever its shape.

#include <Eigen/Core>

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
  ElementVector<nodes, axes> force;                            ///< internal forces [force]
  Eigen::Matrix<double, axes * nodes, axes * nodes> tangent;   ///< d(force)/d(displacement) [force/length]
  material::Vector6 cauchy_stress;                             ///< volume average of the Cauchy stress [stress]
  double plastic_strain = 0.0;                                 ///< volume average of the accumulated plastic strain [-]
};

}  // namespace imic3d::mechanics
