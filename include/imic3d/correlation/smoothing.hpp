#pragma once
// Regularisation of the measured displacement.

#include <Eigen/SparseCore>

#include "imic3d/correlation/cameras.hpp"
#include "imic3d/correlation/correlation.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation {

/// The energy u^T C u = integral of |grad grad u|^2 of every in-plane component on a quad mesh [unknowns x unknowns,
/// 1/length^2]: jumps of the gradient between neighbouring elements and the hourglass mode inside each. Any affine
/// motion is free, up to the mesh's edge: rigid motion and uniform strain of any size are not biased. `only`, if not empty
/// [elements]: elements that take part; the others do with the edges that they share with these.
[[nodiscard]] Eigen::SparseMatrix<double> curvature_energy(const mesh::Mesh& surface, int dofs_per_node,
                                                           const std::vector<char>& only = {});

/// Weight of that energy at which it equals the optical term for waves of length `cut_off` [length]: shorter ones are
/// smoothed, with the fourth power of the ratio (like the mechanical regularisation of Réthoré, Hild and Roux 2009).
[[nodiscard]] double smoothing_weight(const Correlation& correlation, double cut_off);

/// Displacements U [unknowns x frames, length] without the waves shorter than `cut_off` [length]: least squares in the norm
/// of M_DIC with that energy. `held`, if not empty, here and below: what is added to M for motions that no camera sees
/// (GlobalDic::held).
[[nodiscard]] Eigen::MatrixXd smooth(const Cameras& cameras, const Eigen::MatrixXd& U, double cut_off, const Eigen::SparseMatrix<double>& held = {});

/// Random displacements of covariance sigma^2 M^-1 [unknowns x draws, length], the same on every rank.
[[nodiscard]] Eigen::MatrixXd noise_draws(const Cameras& cameras, double sigma, int draws, const Eigen::SparseMatrix<double>& held = {});

/// Every frame's displacement U [unknowns x frames, length], smoothed with the longest cut-off up to `longest` at which
/// what the smoothing takes away at `nodes` is no more than what it takes away of noise (the discrepancy principle; 1.5
/// times in the mean square). `sigma`: the white noise of a frame and the reference together that moves M^-1 b as much
/// [grey level]; its share is taken from draws with the covariance sigma^2 M^-1. `cut_offs` tells what was chosen.
[[nodiscard]] Eigen::MatrixXd smoothed_within_noise(const Cameras& cameras, const Eigen::MatrixXd& U, const std::vector<int>& nodes, double sigma,
                                                    double longest, std::vector<double>* cut_offs = nullptr,
                                                    const Eigen::SparseMatrix<double>& held = {});

}  // namespace imic3d::correlation
