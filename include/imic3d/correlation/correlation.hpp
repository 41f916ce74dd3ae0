#pragma once
// The optical operators M_DIC and b_DIC of one camera on a surface mesh (Eqs 5-9).

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/correlation/pixel_quadrature.hpp"
#include "imic3d/imaging/camera.hpp"

namespace imic3d::correlation {

/// Unknowns of a node that one telecentric camera sees: the displacement in its plane.
inline constexpr int in_plane = 2;

struct CorrelationOptions {
  int dofs_per_node = in_plane;  ///< 2: displacement (x, y); 3: (x, y, z)
  /// The residual is f - (gain * g + offset), with the gain and offset that give g(x + u) the mean and the standard
  /// deviation of f (zero-mean normalised).
  bool brightness = false;
  /// The same with a gain and an offset for each element: light or reflectance that change from place to place (stress
  /// whitening). An offset that is left in an element cancels between neighbours but pushes the nodes of the contour.
  bool local_brightness = false;
  /// Standard deviation of the Gaussian that smoothed both images [px]. It smooths the deformed image over lengths of
  /// the deformed specimen: f is compared as that would show it, with what sigma^2/2 (F^-1 F^-T - 1) : grad grad f adds
  /// (F the deformation gradient in the image, a mean of the element and those beside it, so that noise does not reach
  /// it; the first term of the wider or narrower Gaussian's series).
  double low_pass = 0.0;
  /// variance of grad F for unit noise of the reference (imaging::noise_response) [1/px^2]
  double slope_noise = 1.392;
  QuadratureOptions quadrature = {};
};

/// Which gradient stands for grad G in b.
enum class Gradient {
  reference,  ///< grad F: the modified algorithm of Eqs 8-9
  /// F^-T grad F, F the deformation gradient in the image at the element's centre: what f(x) = g(x + u) makes of it;
  /// the tangent at large strain, equal to `reference` where nothing is strained
  transported,
  /// grad g(x + u): b is then minus the exact derivative of the functional at this gain and offset (biased by noise)
  deformed
};

/// Of a pixel's displacement, of what is interpolated there, and of the sums over some pixels.
enum class Precision {
  single,  ///< 6e-8 px: more than images tell. b is then a function of U with steps of that size
  full     ///< b is as smooth as the spline, for whoever solves for U beyond that; takes 1.4 times as long
};

/// Sums over an element's pixels of N_i N_j (fx fx, fx fy, fy fy, 1) for i <= j.
using Gram = std::array<std::array<double, 4>, 10>;
struct ElementPixels;
struct ElementSums;

/// What an image answers to a displacement.
struct Evaluation {
  Eigen::VectorXd b;                             ///< N^T grad(F) (F - G), Eq. 9 [nodes * dofs, grey level^2/length]
  InImage in_image;                              ///< the same before it is projected [nodes x 2, grey level^2/px]
  double squares = 0.0;                          ///< sum of squared residuals [grey level^2]
  double pixels = 0.0;                           ///< number of pixels in the sums
  double dropped = 0.0;                          ///< pixels that have left the deformed image: in no sum
  double gain = 1.0, offset = 0.0;               ///< light that was fitted to all pixels: f = gain * g + offset
  Eigen::VectorXd element_gain, element_offset;  ///< light that was used [elements]
  /// correlation coefficient of f and g(x + u) over all pixels (local brightness: of their deviations from the
  /// elements' means)
  double coefficient = 0.0;
  Eigen::VectorXd element_squares;  ///< [elements, grey level^2]
  Eigen::VectorXd element_pixels;   ///< [elements] number of pixels in it
  Eigen::VectorXd element_rms;      ///< [elements, grey level]
  [[nodiscard]] double rms() const { return pixels > 0.0 ? std::sqrt(squares / pixels) : 0.0; }  ///< [grey level]
};

/// M_DIC and b_DIC of a camera. Displacements are physical, U [nodes * dofs, length], node by node:
/// U[node * dofs + component]. For a telecentric camera the displacement in the image is bilinear in each element. What
/// a perspective camera makes of the bilinear surface and of its displacement is not: there the pixels' local
/// coordinates and their displacement follow the biquadratic map through the projections of nine points of the element.
/// With the bilinear map of the projected nodes alone a motion by d pixels would be wrong by about d (h
/// sin(tilt)/Z)^2/4 from the perspective and 3/4 d k1 (h/f)^2 from the distortion, h the element's size.
///
/// Every rank holds all pixels; `group` says over which ranks a sum is split (contiguous blocks of elements with about
/// equal numbers of pixels), and such calls are collective over it. Sums do not depend on the number of threads.
class Correlation {
 public:
  /// `surface` [quad4], `reference` the spline of f. Throws InputError if the surface is no quad mesh or does not lie
  /// on the image. The result is the same on every rank; not collective.
  Correlation(const mesh::Mesh& surface, std::shared_ptr<const imaging::Camera> camera,
              const imaging::BSpline& reference, const CorrelationOptions& options = {});

  [[nodiscard]] const mesh::Mesh& surface() const { return surface_; }
  [[nodiscard]] const imaging::Camera& camera() const { return *camera_; }
  [[nodiscard]] const PixelQuadrature& quadrature() const { return quadrature_; }
  [[nodiscard]] int nodes() const { return static_cast<int>(surface_.nodes.rows()); }
  [[nodiscard]] int elements() const { return static_cast<int>(surface_.cells.rows()); }
  [[nodiscard]] int dofs_per_node() const { return dofs_; }
  [[nodiscard]] int unknowns() const { return nodes() * dofs_; }
  [[nodiscard]] const InImage& positions() const { return positions_; }  ///< of the nodes in the reference
  /// d(pixel)/d(in-plane displacement) in the middle of the surface [px/length]; everywhere for a telecentric camera.
  [[nodiscard]] Eigen::Matrix2d pixels_per_length() const;
  /// Mean of |grad F|^2 / 2 [grey level^2/px^2].
  [[nodiscard]] double mean_square_gradient() const;

  /// M_DIC of Eq. 8 [unknowns x unknowns, grey level^2/length^2], symmetric, both triangles stored.
  [[nodiscard]] Eigen::SparseMatrix<double> M() const;
  /// The same with the gradient transported by U (Gradient::transported). No pixel is visited again.
  /// `share`, if not empty [elements]: how much of each element counts, e.g. of its pixels that are still in the image.
  [[nodiscard]] Eigen::SparseMatrix<double> M(const Eigen::VectorXd& U, const Eigen::VectorXd& share = {}) const;

  /// What white noise in the reference adds to M [unknowns x unknowns, px^2/length^2]: E[M] = M of the noiseless image
  /// + variance * this, i.e. slope_noise N^T N. Counts where the speckle's contrast is poor; subtract it for the true
  /// tangent.
  [[nodiscard]] Eigen::SparseMatrix<double> gradient_noise() const;

  /// M before it is projected, times motions in the image [2 nodes x k, px, node by node]: [2 nodes x k, grey
  /// level^2/px].
  [[nodiscard]] Eigen::MatrixXd M_in_image(const Eigen::MatrixXd& motions) const;
  /// Of forces in the image [2 nodes x k] to those on the displacement [unknowns x k], at the nodes displaced by U, if
  /// given.
  [[nodiscard]] Eigen::MatrixXd projected(const Eigen::MatrixXd& in_image, const Eigen::VectorXd* U = nullptr) const;

  /// Residual f - g(x + u), b_DIC (Eq. 9) and sums of the deformed image `g` at U. `own`, if not empty: what the nodes
  /// move by in this image beside u [nodes x 2, px].
  [[nodiscard]] Evaluation evaluate(const imaging::BSpline& g, const Eigen::VectorXd& U, const Communicator& group,
                                    Gradient gradient = Gradient::reference, Precision precision = Precision::single,
                                    const InImage& own = {}) const;

  /// f - (gain * g(x + u) + offset) [pixels of the quadrature, grey level]; NaN where the pixel left the image. The
  /// gain and offset are fitted if the options say so. `own` as in `evaluate`. Not collective.
  [[nodiscard]] std::vector<float> residual(const imaging::BSpline& g, const Eigen::VectorXd& U,
                                            const InImage& own = {}) const;

  /// Displacement of the nodes in the image.
  [[nodiscard]] InImage pixel_displacement(const Eigen::VectorXd& U) const;
  /// Deformation gradient d(deformed px)/d(reference px) at the centre of every element [elements].
  [[nodiscard]] std::vector<Eigen::Matrix2d> deformation_gradient(const Eigen::VectorXd& U) const;

 private:
  void make_pattern();
  /// Sum over the elements of J_i^T block(element, sums of the pair) J_j; J at the nodes displaced by U, if given.
  using Block = std::function<Eigen::Matrix2d(int element, const std::array<double, 4>& sums)>;
  [[nodiscard]] Eigen::SparseMatrix<double> assemble(const Block& block, const Eigen::VectorXd* U) const;
  [[nodiscard]] Eigen::Vector3d displaced(int node, const Eigen::VectorXd& U) const;
  [[nodiscard]] Eigen::Matrix<double, 4, 2> of_element(const InImage& values, int element) const;
  [[nodiscard]] std::pair<int, int> share(const Communicator& group) const;
  [[nodiscard]] ElementPixels pixels_of(int element) const;
  /// The deformed image at the pixels of an element, NaN where they have left it. Kept from element to element of a
  /// thread.
  template <class Real>
  struct Seen {
    std::vector<Real> dx, dy;             // displacement less its whole pixels
    std::vector<Real> value;              // g(x + u)
    std::vector<float> slope_x, slope_y;  // grad g(x + u), if asked for
  };
  /// Deformation gradient that the low pass goes by: the mean of each element and those beside it [elements]; empty
  /// without one.
  [[nodiscard]] std::vector<Eigen::Matrix2d> smoothed_over(const std::vector<Eigen::Matrix2d>& F) const;
  /// The reference's grey levels at an element's pixels, smoothed over the lengths that smooth the deformed image (F:
  /// `smoothed_over`); `levels` may hold them.
  [[nodiscard]] const float* smoothed_alike(int element, const std::vector<Eigen::Matrix2d>& F,
                                            std::vector<float>& levels) const;
  /// `shift`: pixel_displacement(U).
  template <class Real>
  void interpolate(const imaging::BSpline& g, int element, const InImage& shift, const Eigen::VectorXd& U,
                   const InImage& own, bool slopes, Seen<Real>& seen) const;
  /// Sums of the elements begin ... end - 1.
  template <class Real>
  [[nodiscard]] std::vector<ElementSums> sums_of(int begin, int end, const imaging::BSpline& g, const InImage& shift,
                                                 const Eigen::VectorXd& U, const InImage& own,
                                                 const std::vector<Eigen::Matrix2d>& F, Gradient gradient) const;
  /// Projections of the middles of the edges and of the centre of an element displaced by U, if given.
  [[nodiscard]] Eigen::Matrix<double, 5, 2> inner_points(int element, const Eigen::VectorXd* U) const;
  void correct_local_coordinates();

  mesh::Mesh surface_;
  std::shared_ptr<const imaging::Camera> camera_;
  int dofs_;
  bool brightness_;
  bool local_brightness_;
  double slope_noise_;
  double low_pass_;
  imaging::BSpline reference_;  // if there is a low pass
  InImage positions_;
  PixelQuadrature quadrature_;
  float mean_grey_ = 0.0F;
  std::vector<Eigen::Matrix<double, 5, 2>> inner_;  // inner_points in the reference; empty for an affine camera
  std::vector<Gram> gram_;
  Eigen::SparseMatrix<double> pattern_;
  std::vector<int> slots_;  // of the element matrices' blocks in the pattern's values
};

}  // namespace imic3d::correlation
