#pragma once
// One function for each file of this folder.

#include <functional>
#include <memory>
#include <span>

#include "imic3d/loop/effect.hpp"

namespace imic3d::loop {

/// 1 at the hole's edge, 0 from the nearest edge of the surface on, smooth between.
[[nodiscard]] double near_hole(const Scene& scene, double distance);

/// What begins at `onset` (0 at the reference, 1 at the last frame) and stays: from 0 to 1 within a good half of a
/// frame.
[[nodiscard]] double begun(const Scene& scene, int t, double onset);
/// Onsets between the frames, up to `last` (clock time), `most` at most: Description::elsewhere of what begins at an
/// unknown moment.
[[nodiscard]] std::vector<std::vector<double>> moments(const Scene& scene, double last, Eigen::Index most);

using Points = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;  ///< [nodes, 2]

/// Adds what a mesh measures beyond the displacement U [components * nodes] if it does not lie on the points of the
/// specimen that it is taken for: at X is the specimen's point X - d(X), u(X - d) instead of u(X), to first order.
void see_beside(const Points& d, const Scene& scene, const Eigen::VectorXd& U, Eigen::VectorXd& error);

using Distortion = std::function<Eigen::Vector2d(const Eigen::Vector2d&)>;

/// Adds what a camera that shows a point x (from the lens's axis) at x + D(x), in the reference, too, makes of the
/// displacement U [2 * nodes]: what lies at the node X is the specimen's point X - d, d = D(X - d), and moves to
/// x + D(x), x = X - d + u(X - d).
void see_through(const Distortion& D, const Scene& scene, const Eigen::VectorXd& U, Eigen::VectorXd& error);

std::shared_ptr<const Effect> coarse_mesh();
std::shared_ptr<const Effect> large_increments();
std::shared_ptr<const Effect> interpolation_bias();
std::shared_ptr<const Effect> force_gain();
std::shared_ptr<const Effect> force_offset();
std::shared_ptr<const Effect> force_delay();
std::shared_ptr<const Effect> magnification_drift();
std::shared_ptr<const Effect> strain_gain();
std::shared_ptr<const Effect> strain_zero();
std::shared_ptr<const Effect> compliance();
std::shared_ptr<const Effect> group_gain();
std::shared_ptr<const Effect> parallax();
std::shared_ptr<const Effect> lens_distortion();
std::shared_ptr<const Effect> placement();
std::shared_ptr<const Effect> camera_tilt();
std::shared_ptr<const Effect> camera_bump();
std::shared_ptr<const Effect> light_gain();
std::shared_ptr<const Effect> light_offset();
std::shared_ptr<const Effect> light_gradient();
std::shared_ptr<const Effect> saturation();
std::shared_ptr<const Effect> noise_level();
std::shared_ptr<const Effect> aliasing();
std::shared_ptr<const Effect> speckle_debonding();
std::shared_ptr<const Effect> hole_radius();
std::shared_ptr<const Effect> hole_offset();
std::shared_ptr<const Effect> thickness();
std::shared_ptr<const Effect> taper();
std::shared_ptr<const Effect> preload();
std::shared_ptr<const Effect> residual_stress();
std::shared_ptr<const Effect> misalignment();
std::shared_ptr<const Effect> grip_slip();
std::shared_ptr<const Effect> friction();
std::shared_ptr<const Effect> stiff_region();

}  // namespace imic3d::loop
