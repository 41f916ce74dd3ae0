#pragma once
// The optical operators M_DIC and b_DIC of one camera on a surface mesh (Eqs 5-9).

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <string>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/camera.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation {

/// The pixels of the reference image that the mesh covers, element by element: each pixel whose centre lies in the
/// projected reference element, once. Pixel-wise quadrature: sums over pixels replace integrals.
struct PixelQuadrature {
  std::vector<std::size_t> first;  ///< pixels of element e: first[e] … first[e + 1] - 1
  std::vector<float> xi, eta;      ///< local coordinates in the element
  std::vector<float> x, y;         ///< column and row [px]
  std::vector<float> f, fx, fy;    ///< grey level and gradient [grey level/px] of the reference there
  [[nodiscard]] std::size_t pixels() const { return x.size(); }
};

/// What an image answers to a displacement.
struct Evaluation {
  Eigen::VectorXd b;        ///< b_DIC [2 * nodes, grey level^2/length]
  double squares = 0.0;     ///< sum of squared residuals
  double pixels = 0.0;      ///< pixels that took part (those that left the deformed image do not)
  double gain = 1.0, offset = 0.0;  ///< light: f = gain * g + offset
  Eigen::VectorXd element_rms;      ///< per element [grey level]
};

/// Displacements are physical, in the plane of the image: U [2 * nodes, length]. Only the camera's in-plane part acts.
class Correlation {
 public:
  /// Throws InputError if the mesh does not lie on the image, naming the elements. brightness: fit gain and offset of
  /// every deformed image together with the displacement.
  Correlation(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera, const imaging::BSpline& reference,
              bool brightness, const std::string& place);

  [[nodiscard]] const PixelQuadrature& quadrature() const { return quadrature_; }
  [[nodiscard]] const mesh::Mesh& surface() const { return surface_; }
  [[nodiscard]] const Eigen::Matrix2d& pixels_per_length() const { return linear_; }

  /// Grey-level gradient per pixel to linearise with: grad F, or F^-T grad F at displacement U where strains are large.
  struct Gradient {
    std::vector<float> x, y;  ///< [grey level/px]; empty: that of the reference
  };
  [[nodiscard]] Gradient deformed_gradient(const Eigen::VectorXd& U) const;

  /// M_DIC = N^T grad F grad F N (Eq. 8) [2n x 2n, grey level^2/length^2].
  [[nodiscard]] Eigen::SparseMatrix<double> M(const Gradient& gradient = {}) const;

  /// Residual f - g(x + u) and b_DIC (Eq. 9). Elements are split over the ranks of `group`; sums do not depend on the
  /// number of threads.
  [[nodiscard]] Evaluation evaluate(const imaging::BSpline& g, const Eigen::VectorXd& U, const Communicator& group,
                                    const Gradient& gradient = {}) const;

  /// Residual of every pixel, in the order of the quadrature; NaN where the pixel left the image.
  [[nodiscard]] std::vector<float> residual(const imaging::BSpline& g, const Eigen::VectorXd& U) const;

  /// Stiffness of grad u : grad u on the surface [2n x 2n, -], for regularisation.
  [[nodiscard]] Eigen::SparseMatrix<double> gradient_energy() const;
  /// Mean of |grad F|^2 / 2 per covered area [grey level^2/length^2 per length^2].
  [[nodiscard]] double optical_density() const;

 private:
  mesh::Mesh surface_;
  Eigen::Matrix2d linear_;
  bool brightness_;
  PixelQuadrature quadrature_;
};

}  // namespace imic3d::correlation
