#pragma once
// The images of a series as the identification sees them.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <functional>

#include "imic3d/core/parallel.hpp"

namespace imic3d::identification {

/// The images' answer to a surface displacement at one frame.
struct ImageEvaluation {
  Eigen::VectorXd b;            ///< b_DIC of Eq. 9 [unknowns, grey level^2/length], summed over the cameras
  double squares = 0.0;         ///< sum of squared residuals f - g(x + u), weighted like b [grey level^2]
  double pixels = 0.0;          ///< pixels in that sum
  Eigen::VectorXd element_rms;  ///< per element of the surface [grey level]
};

/// M_DIC and b_DIC of a series, of whatever cameras saw it: the sums over cameras of w_c M_c and w_c b_c, w_c =
/// noise^2/sigma_c^2, on the unknowns of the specimen's seen faces (specimen.hpp).
struct ImageData {
  /// M_DIC of Eq. 8 on the surface [unknowns x unknowns, grey level^2/length^2]
  Eigen::SparseMatrix<double> M;
  /// added to M where it is inverted: motions that no camera sees; may be empty
  Eigen::SparseMatrix<double> held;
  /// Evaluates frame t (index in the record) at a surface displacement [unknowns, length], the pixels split over the
  /// ranks of `group` (collective over it; any rank may call it alone with a group of its own).
  std::function<ImageEvaluation(int t, const Eigen::VectorXd& displacement, const Communicator& group)> evaluate;
  /// sigma of Eq. 14: of the white noise that moves M^-1 b as much [grey level]; several cameras: 1/noise^2 is the mean
  /// of theirs
  double noise = 1.0;
  /// standard deviation of each frame's noise over `noise` [frames of the record]; empty: 1
  Eigen::VectorXd frame_noise{};
  double pixels_per_length = 1.0;  ///< scale of the camera [px/length]
  /// displacements nearer than this to the DIC (rms, px) are judged by grey levels; the others, from where they
  /// mislead, by their distance to the DIC in the norm of M
  double reach = 1.0;
  /// Standard deviation of frame t's noise over `noise`.
  [[nodiscard]] double noise_of(Eigen::Index t) const { return t < frame_noise.size() ? frame_noise[t] : 1.0; }
  /// What the normal equations of frame t weigh, 1/(2 sigma_t^2) of Eq. 11 [1/grey level^2].
  [[nodiscard]] double weight_of(Eigen::Index t) const { return 0.5 / (noise * noise_of(t) * noise * noise_of(t)); }
  /// M-weighted mean square of the distance to the DIC displacement [px^2].
  [[nodiscard]] double distance(const Eigen::VectorXd& gap, const Eigen::VectorXd& Mgap) const {
    return 2.0 * gap.dot(Mgap) / M.diagonal().sum() * pixels_per_length * pixels_per_length;
  }
};

}  // namespace imic3d::identification
