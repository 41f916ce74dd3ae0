#pragma once
// Several cameras on one surface mesh (Secs 3.2 and 3.3).

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "imic3d/correlation/correlation.hpp"

namespace imic3d::correlation {

/// What the images of all cameras answer to a displacement.
struct JointEvaluation {
  Eigen::VectorXd b;                ///< sum of w_c b_c [nodes * dofs, grey level^2/length]
  std::vector<Evaluation> cameras;  ///< each camera's own, not weighted
  double pixels = 0.0, dropped = 0.0;
  double rms = 0.0;             ///< sqrt(sum of w_c squares_c / pixels) [grey level]
  double coefficient = 0.0;     ///< mean of the cameras' correlation coefficients, weighted by their pixels
  double least = 0.0;           ///< the smallest of the cameras' coefficients
  Eigen::VectorXd element_rms;  ///< weighted like rms [elements, grey level]
  Eigen::VectorXd b_epipolar;   ///< sum of w_c modes_c^T b_c, b_c in the image [epipolar modes, grey level^2]
};

/// M = sum of w_c M_c and b = sum of w_c b_c, the projection P_c being part of M_c and b_c (Eqs 8, 9 and 16). The
/// weight of a camera is w_c = s^2/sigma_c^2, sigma_c the noise of its images and 1/s^2 the mean of 1/sigma_c^2: the
/// most probable displacement of white noises that differ. One camera has the weight 1.
class Cameras {
 public:
  /// All with the same mesh and the same unknowns. `noise` [grey level]: only the ratios matter; empty: all alike.
  explicit Cameras(std::vector<std::shared_ptr<const Correlation>> cameras, const std::vector<double>& noise = {});

  [[nodiscard]] int size() const { return static_cast<int>(cameras_.size()); }
  [[nodiscard]] const Correlation& operator[](int c) const { return *cameras_[static_cast<std::size_t>(c)]; }
  [[nodiscard]] double weight(int c) const { return weights_[static_cast<std::size_t>(c)]; }
  [[nodiscard]] const mesh::Mesh& surface() const { return cameras_.front()->surface(); }
  [[nodiscard]] int nodes() const { return cameras_.front()->nodes(); }
  [[nodiscard]] int elements() const { return cameras_.front()->elements(); }
  [[nodiscard]] int dofs_per_node() const { return cameras_.front()->dofs_per_node(); }
  [[nodiscard]] int unknowns() const { return cameras_.front()->unknowns(); }
  /// Pixels of all cameras in an element.
  [[nodiscard]] std::size_t pixels_of(int element) const;

  [[nodiscard]] Eigen::SparseMatrix<double> M() const;
  /// With gradients transported by U; `shares` [cameras, elements]: how much of each element each camera still sees.
  [[nodiscard]] Eigen::SparseMatrix<double> M(const Eigen::VectorXd& U,
                                              const std::vector<Eigen::VectorXd>& shares) const;
  /// sum of factor_c M_c.
  [[nodiscard]] Eigen::SparseMatrix<double> sum_of_M(std::span<const double> factors) const;
  /// sum of factor_c gradient_noise_c.
  [[nodiscard]] Eigen::SparseMatrix<double> sum_of_gradient_noise(std::span<const double> factors) const;

  /// Motions in the images that are none of the surface: where cameras see it in space, the 2 n components of a node's
  /// motion in n images are more than the 3 of its displacement. A camera that is pushed, whose lens changes, or that
  /// records at another moment than the others moves points off their epipolar lines; taken for motion of the surface
  /// that is noise of the speckle's size. Across the epipolar lines, of second degree over the surface: at most 6 (2 n
  /// - 3) modes.
  [[nodiscard]] Eigen::Index epipolar_modes() const { return modes_.empty() ? 0 : modes_.front().cols(); }
  /// What the nodes move by in the image of a camera beside their displacement, `epipolar` the size of each mode:
  /// [nodes x 2, px]; empty if that is.
  [[nodiscard]] InImage off_epipolar(int c, const Eigen::VectorXd& epipolar) const;
  /// The same of each camera.
  [[nodiscard]] std::vector<InImage> off_epipolar(const Eigen::VectorXd& epipolar) const;
  /// How far the nodes lie off their epipolar lines in the image of each camera, rms [cameras, px].
  [[nodiscard]] std::vector<double> rms_off_epipolar(const Eigen::VectorXd& epipolar) const;
  /// The modes that are nearest to motions [cameras] of [nodes x 2, px].
  [[nodiscard]] Eigen::VectorXd epipolar_of(const std::vector<InImage>& off) const;
  /// Keeps those modes that displacement does not make up for: of the square of what they change in the images no more
  /// than half, `solve` being M^-1 [unknowns x k]. They are then orthogonal to one another: sum of w_c modes_c^T M_c
  /// modes_c is the identity [grey level^2].
  void find_epipolar_modes(const std::function<Eigen::MatrixXd(const Eigen::MatrixXd&)>& solve);

  /// `g`: the spline of each camera's deformed image; `off`, if not empty: `off_epipolar`. Collective over `group`.
  [[nodiscard]] JointEvaluation evaluate(std::span<const imaging::BSpline> g, const Eigen::VectorXd& U,
                                         const Communicator& group, Gradient gradient = Gradient::reference,
                                         const std::vector<InImage>& off = {}) const;

  /// Deformation gradients in the images, camera by camera [cameras * elements].
  [[nodiscard]] std::vector<Eigen::Matrix2d> deformation_gradient(const Eigen::VectorXd& U) const;
  /// Longest way in an image that a node goes from U to U + update, of the cameras that see it [nodes, px].
  [[nodiscard]] Eigen::VectorXd steps(const Eigen::VectorXd& U, const Eigen::VectorXd& update) const;

  /// The displacement that brings the nodes to `moved` in the images [per camera: nodes x 2, px from the reference], by
  /// least squares: with two cameras and three unknowns the triangulation. What the cameras that are given do not see
  /// stays as in U.
  [[nodiscard]] Eigen::VectorXd displacement(const std::vector<std::optional<InImage>>& moved,
                                             const Eigen::VectorXd& U) const;

  /// Smoothing weight (smoothing.hpp) of all cameras together.
  [[nodiscard]] double smoothing_weight(double cut_off) const;

  /// Nodes of which some direction is not seen (along the line of sight of the one camera that sees the node), or
  /// hardly: of the two extreme eigenvalues of the node's block of M the ratio is below a tenth of what it is at
  /// well-seen nodes.
  [[nodiscard]] std::vector<int> hardly_seen(const Eigen::SparseMatrix<double>& M) const;

 private:
  std::vector<std::shared_ptr<const Correlation>> cameras_;
  std::vector<double> weights_;
  std::vector<std::vector<char>> sees_;  // [cameras][nodes] whether a pixel of the camera depends on the node
  std::vector<Eigen::MatrixXd> modes_;   // [cameras][2 nodes x modes, px]
};

}  // namespace imic3d::correlation
