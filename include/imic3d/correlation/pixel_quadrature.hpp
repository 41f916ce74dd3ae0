#pragma once
// The pixel-wise operators of image correlation for one camera on a surface mesh: N, grad F, M_DIC and b_DIC (Eqs 5-9).

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <array>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/camera.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation {

/// Unknowns of a node that one telecentric camera sees: the displacement in its plane.
inline constexpr int in_plane = 2;

/// Which gradient stands for grad G in b (and, transported, in M).
enum class Gradient {
  reference,    ///< grad F: the modified algorithm of Eqs 8-9
  transported,  ///< F^-T grad F, F the deformation gradient in the image (at the element's centre): the tangent at
                ///< large strain, as f(x) = g(x + u) makes it; equal to `reference` where nothing is strained
  deformed  ///< grad g(x + u): b is then minus the exact derivative of the functional (not for noise: biased)
};

struct QuadratureOptions {
  int dofs_per_node = in_plane;          ///< 2: displacement (x, y); 3: (x, y, z)
  const imaging::Image* mask = nullptr;  ///< pixels whose level is 0 there are left out; same size as the reference
  bool clip = false;          ///< elements may reach beyond the reference image: the pixels there are left out
  std::string name = "mesh";  ///< what messages call the mesh
};

struct EvaluationOptions {
  Gradient gradient = Gradient::reference;
  bool brightness = false;  ///< the residual is f - (gain * g + offset), with the gain and offset that fit this U best
};

/// What one image says about one displacement.
struct Evaluation {
  Eigen::VectorXd b;                ///< N^T grad(F) (F - G), Eq. 9 [nodes * dofs; grey level^2/length]
  double squares = 0.0;             ///< sum of squared residuals [grey level^2]
  double pixels = 0.0;              ///< number of pixels in the sums
  double dropped = 0.0;             ///< pixels that have left the deformed image: in no sum
  double gain = 1.0, offset = 0.0;  ///< brightness that was fitted
  Eigen::VectorXd element_squares;  ///< [elements] sum of squared residuals
  Eigen::VectorXd element_pixels;   ///< [elements] number of pixels in it
  [[nodiscard]] double rms() const { return pixels > 0.0 ? std::sqrt(squares / pixels) : 0.0; }  ///< [grey level]
};

/// One row of pixels of an element.
struct PixelRow {
  int row, column, count;  ///< the pixels (column ... column + count - 1, row)
};

/// All pixels whose centre lies in the projected reference elements, each in exactly one, with their local coordinates
/// (inverse of the bilinear map), reference grey level and gradient.
///
/// Displacements U [nodes * dofs, length] go node by node: U[node * dofs + component]. The displacement in the image is
/// bilinear in each element between the projected displacements of the nodes, which for a telecentric camera is exact.
/// The elements are split over the ranks of the communicator in contiguous blocks of about equal area; M and b are
/// summed over the ranks and the same on all. Sums do not depend on the number of threads. Methods named `local` are
/// not collective, all other ones that are given an image or return a matrix are.
class PixelQuadrature {
 public:
  /// `quads` [quad4; nodes x, y, z], `reference` the spline of f. Throws InputError on all ranks if the mesh does not
  /// lie on the image (how many elements, which part), is no quad mesh, or has an element that is not convex in the
  /// image.
  PixelQuadrature(const mesh::Mesh& quads, std::shared_ptr<const imaging::Camera> camera,
                  const imaging::BSpline& reference, const Communicator& communicator,
                  const QuadratureOptions& options = {});

  [[nodiscard]] int nodes() const { return static_cast<int>(positions_.rows()); }
  [[nodiscard]] int elements() const { return static_cast<int>(cells_.rows()); }
  [[nodiscard]] int dofs_per_node() const { return dofs_; }
  [[nodiscard]] int unknowns() const { return nodes() * dofs_; }
  [[nodiscard]] const Communicator& communicator() const { return communicator_; }
  [[nodiscard]] double pixels() const { return pixels_; }                                          ///< of all ranks
  [[nodiscard]] const Eigen::VectorXd& pixels_of_elements() const { return pixels_of_elements_; }  ///< [elements]
  [[nodiscard]] const Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>& node_positions() const {
    return positions_;  ///< [nodes x 2] in the reference image [px]
  }
  [[nodiscard]] const mesh::Cells& cells() const { return cells_; }

  /// M_DIC of Eq. 8 [unknowns x unknowns, grey level^2/length^2], symmetric, both triangles stored.
  [[nodiscard]] Eigen::SparseMatrix<double> matrix() const;
  /// The same with the gradient transported by the displacement U (Gradient::transported).
  [[nodiscard]] Eigen::SparseMatrix<double> matrix(const Eigen::VectorXd& U) const;

  /// Residual, b and sums of the deformed image `g` at U.
  [[nodiscard]] Evaluation evaluate(const imaging::BSpline& g, const Eigen::VectorXd& U,
                                    const EvaluationOptions& options = {}) const;

  /// Displacement of the nodes in the image [nodes x 2, px].
  [[nodiscard]] Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor> pixel_displacement(
      const Eigen::VectorXd& U) const;
  /// Deformation gradient in the image at the centre of every element [elements], d(deformed px)/d(reference px).
  [[nodiscard]] std::vector<Eigen::Matrix2d> deformation_gradient(const Eigen::VectorXd& U) const;

  // This rank's pixels, element by element, row by row.
  [[nodiscard]] int first_local_element() const { return first_; }
  [[nodiscard]] int local_elements() const { return static_cast<int>(pixel_begin_.size()) - 1; }
  [[nodiscard]] std::size_t local_pixels() const { return grey_.size(); }
  /// Pixels of local element k (0 ... local_elements() - 1) are [local_begin(k), local_begin(k + 1)).
  [[nodiscard]] std::size_t local_begin(int k) const { return pixel_begin_[static_cast<std::size_t>(k)]; }
  [[nodiscard]] std::span<const PixelRow> local_runs(int k) const {
    const auto i = static_cast<std::size_t>(k);
    return {runs_.data() + run_begin_[i], run_begin_[i + 1] - run_begin_[i]};
  }
  [[nodiscard]] std::span<const float> local_xi() const { return xi_; }            ///< [local pixels] in [-1, 1]
  [[nodiscard]] std::span<const float> local_eta() const { return eta_; }          ///< [local pixels]
  [[nodiscard]] std::span<const float> local_grey() const { return grey_; }        ///< f [local pixels]
  [[nodiscard]] std::span<const float> local_slope_x() const { return slope_x_; }  ///< df/dx [grey level/px]
  [[nodiscard]] std::span<const float> local_slope_y() const { return slope_y_; }  ///< df/dy [grey level/px]
  /// f - (gain * g(x + u) + offset) at this rank's pixels [local pixels, grey level]; NaN where the pixel left the
  /// image.
  [[nodiscard]] std::vector<float> local_residuals(const imaging::BSpline& g, const Eigen::VectorXd& U,
                                                   double gain = 1.0, double offset = 0.0) const;

 private:
  using InImage = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
  /// Sums of N_i N_j (fx fx, fx fy, fy fy) for i <= j.
  using Gram = std::array<std::array<double, 3>, 10>;

  void split();
  void place(const imaging::BSpline& reference, const QuadratureOptions& options);
  void collect_pixels(int element, const imaging::BSpline& reference, const imaging::Image* mask);
  void sum_gram();
  void make_pattern();
  [[nodiscard]] Eigen::SparseMatrix<double> assemble(const std::vector<Eigen::Matrix2d>* transport,
                                                     const Eigen::VectorXd* U) const;
  [[nodiscard]] Eigen::Vector3d displaced(int node, const Eigen::VectorXd& U) const;
  [[nodiscard]] Eigen::Matrix<double, 4, 2> of_element(const InImage& values, int element) const;
  /// g(x + u) at the pixels of a local element; false if some have left the image (NaN there).
  bool interpolate(const imaging::BSpline& g, int k, const InImage& shift, float* values, float* slope_x,
                   float* slope_y) const;

  Communicator communicator_;
  std::shared_ptr<const imaging::Camera> camera_;
  int dofs_ = in_plane;
  mesh::Nodes points_;
  mesh::Cells cells_;
  InImage positions_;
  double pixels_ = 0.0;
  Eigen::VectorXd pixels_of_elements_;

  int first_ = 0;  // this rank's elements are [first_, first_ + local_elements())
  std::vector<std::size_t> pixel_begin_, run_begin_;
  std::vector<PixelRow> runs_;
  std::vector<float> xi_, eta_, grey_, slope_x_, slope_y_;
  std::vector<Gram> gram_;
  Eigen::SparseMatrix<double> pattern_;
  std::vector<int> slots_;  // of the element matrices' entries in the pattern's values
};

}  // namespace imic3d::correlation
