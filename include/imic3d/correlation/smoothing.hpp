#pragma once
// Regularisation of the measured displacement.

#include <Eigen/SparseCore>
#include <functional>
#include <vector>

#include "imic3d/correlation/cameras.hpp"
#include "imic3d/correlation/correlation.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation {

/// The energy u^T C u = integral of |grad grad u|^2 of every in-plane component on a quad mesh [unknowns x unknowns,
/// 1/length^2]: jumps of the gradient between neighbouring elements and the hourglass mode inside each. Any affine
/// motion is free, up to the mesh's edge: rigid motion and uniform strain of any size are not biased. `only`, if not
/// empty [elements]: elements that take part; the others do with the edges that they share with these.
[[nodiscard]] Eigen::SparseMatrix<double> curvature_energy(const mesh::Mesh& surface, int dofs_per_node,
                                                           const std::vector<char>& only = {});

/// Weight of that energy at which it equals the optical term for waves of length `cut_off` [length]: shorter ones are
/// smoothed, with the fourth power of the ratio (like the mechanical regularisation of Réthoré, Hild and Roux 2009).
[[nodiscard]] double smoothing_weight(const Correlation& correlation, double cut_off);

/// How a displacement of a quad mesh was measured: its white noise has the covariance sigma^2 M^-1.
struct Measure {
  mesh::Mesh surface;
  int dofs_per_node = 2;
  /// of Eq. 8, with what holds motions that nothing shows [unknowns x unknowns]
  Eigen::SparseMatrix<double> M;
  /// The weight of the curvature's energy at which it equals M's term for waves of length `cut_off` [length].
  std::function<double(double cut_off)> smoothing_weight;
};
/// By cameras. `held`, if not empty: added to M for motions that no camera sees (GlobalDic::held).
[[nodiscard]] Measure measured_by(const Cameras& cameras, const Eigen::SparseMatrix<double>& held = {});

/// Displacements U [unknowns x frames, length] without the waves shorter than `cut_off` [length]: least squares in the
/// norm of M with that energy, and what that takes away smoothed and put back (Tukey's twicing): of a wave of which
/// least squares leave the part S, 1 - (1 - S)^2 is left.
[[nodiscard]] Eigen::MatrixXd smooth(const Measure& measure, const Eigen::MatrixXd& U, double cut_off);

/// The same with a cut-off for each frame; 0: as it is. Frames beyond the list of cut-offs stay, too.
[[nodiscard]] Eigen::MatrixXd smooth(const Measure& measure, Eigen::MatrixXd U, const std::vector<double>& cut_offs);

/// Random displacements of covariance sigma^2 M^-1 [unknowns x draws, length], the same on every rank.
[[nodiscard]] Eigen::MatrixXd noise_draws(const Measure& measure, double sigma, int draws);

/// The cut-off of each frame, 0 or from `longest` [length] down to a 128th of it in steps of sqrt(2), with which
/// `smooth` leaves the least error at `nodes`, by an unbiased estimate of it (Stein 1981, Ann. Statist. 9, Eq. 2.2; of
/// a linear smoother Mallows' C_L): the sum over the nodes' unknowns, each in units of its noise, and over the frame
/// with two on either side. U: measured [unknowns x frames, length], with white noise `sigma` of each frame and the
/// reference together [frames, in the unit that goes with M], whose covariance is sigma^2 M^-1.
[[nodiscard]] std::vector<double> cut_offs_of_least_error(const Measure& measure, const Eigen::MatrixXd& U,
                                                          const std::vector<int>& nodes, const Eigen::VectorXd& sigma,
                                                          double longest);

/// Cut-offs of least error that are shorter than `longest`, once more by sqrt(2). What smoothing bends is, where the
/// error is least, not far below the noise that it leaves, alike in all frames, and in no draw of the noise; so it is a
/// third of that, for noise that is 1.4 times larger.
[[nodiscard]] std::vector<double> undersmoothed(std::vector<double> cut_offs, double longest);

}  // namespace imic3d::correlation
