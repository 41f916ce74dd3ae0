#pragma once
// A bar pulled along its axis, with no other stress: a material point under mixed control.

#include <Eigen/Core>
#include <span>
#include <vector>

#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::material {

/// Where the strain turned back, or went on at another rate.
struct BarTurn {
  Eigen::Index row;  ///< that of the turn, or the one after it
  bool between;      ///< it lies between that row and the one before it, and is passed through
  double time, strain;
  /// standard deviation of what it went further by than `strain`, beside the noise of a row
  double deviation = 0.0;
  bool back = true;  ///< else only the rate changed
};

/// What is prescribed: the logarithmic strain of the gauge at times, from the virgin state at time[0].
struct BarHistory {
  Eigen::VectorXd time;    ///< [rows, time], not descending
  Eigen::VectorXd strain;  ///< ln(length / length_0) [rows, -]
  /// of the bar in the plane of the law's axes x, y, counter-clockwise from x [degree]
  double direction = 0.0;
  std::vector<BarTurn> turns = {};  ///< in order
  /// Of grips and load train between the gauge's ends: what it shows of the length over length_0 beyond the bar's own,
  /// per engineering stress [length^2/force].
  double compliance = 0.0;
};

struct BarOptions {
  /// of the strain; longer ones are divided, and those in which more than a tenth of a back-stress would fade (into 8
  /// at most)
  double largest_step = 2e-3;
  /// of a step whose lateral strains could not be found, or in which the plastic strain rate changes
  int most_halvings = 12;
  /// these are not shortened for a rate or a back-stress: differences of two paths would have the choices in them
  bool given_steps = false;
};

/// At the rows that could be reached.
struct BarResponse {
  Eigen::Index rows = 0;  ///< all of them, or those before the law could not follow
  Eigen::VectorXd
      /// axial Kirchhoff stress [rows]: the force over the first section, times length/length_0 that the gauge shows
      kirchhoff;
  Eigen::VectorXd engineering;     ///< force over the first section [rows]
  Eigen::MatrixXd lateral;         ///< logarithmic strains across, in the plane and out of it [rows x 2]
  Eigen::VectorXd plastic_strain;  ///< accumulated, 0 for an elastic law [rows]
  /// d(kirchhoff)/d(parameter), those of `free` [rows x free]; of `engineering`: over length/length_0
  Eigen::MatrixXd derivatives;
};

/// The deformation gradient in the bar's axes is [e^strain, g, 0; 0, e^a, 0; 0, 0, e^b]; a, b and the shear g, which
/// an anisotropic bar needs, are found by Newton's method with the consistent tangent so that tau_22 = tau_33 = tau_12
/// = 0. The derivatives are those of the whole path, by direct differentiation. law: not one of plane stress. `free`:
/// parameters by index. Where a back-stress or heat has to be integrated, the response is that of halved steps less
/// what these err by, the difference to whole ones (Richardson): the error falls with the square of the step. The
/// stress of a rate is that of a step's mean rate: steps are short where the plastic strain rate changes, at the onset
/// of flow, in a hold, after a jump of the rate.
[[nodiscard]] BarResponse pull_bar(const FiniteStrainLaw& law, std::span<const double> parameters,
                                   const BarHistory& history, std::span<const int> free = {},
                                   const BarOptions& options = {});

}  // namespace imic3d::material
