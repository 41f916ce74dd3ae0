#pragma once
// The pixels of the reference image that a surface mesh covers, element by element.

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation {

/// Positions or displacements of nodes in an image [nodes x 2, px].
using InImage = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;

/// One row of pixels of an element.
struct PixelRow {
  int row, column, count;  ///< the pixels (column ... column + count - 1, row)
};

/// Pixel-wise quadrature: sums over pixels replace integrals. All pixels whose centre lies in the projected reference
/// element, each in exactly one element (those on a shared edge too), row by row, with their local coordinates (inverse
/// of the bilinear map), grey level and gradient in the reference.
struct PixelQuadrature {
  std::vector<std::size_t> first;      ///< [elements + 1] pixels of element e: first[e] ... first[e + 1] - 1
  std::vector<std::size_t> first_row;  ///< [elements + 1] rows of element e
  std::vector<PixelRow> rows;
  std::vector<float> xi, eta;    ///< [pixels] local coordinates in [-1, 1]
  std::vector<float> f, fx, fy;  ///< [pixels] reference grey level and gradient [grey level/px]

  [[nodiscard]] std::size_t pixels() const { return f.size(); }
  [[nodiscard]] int elements() const { return static_cast<int>(first.size()) - 1; }
  [[nodiscard]] std::size_t pixels_of(int e) const {
    return first[static_cast<std::size_t>(e) + 1] - first[static_cast<std::size_t>(e)];
  }
  [[nodiscard]] std::span<const PixelRow> rows_of(int e) const {
    const auto i = static_cast<std::size_t>(e);
    return {rows.data() + first_row[i], first_row[i + 1] - first_row[i]};
  }
};

struct QuadratureOptions {
  /// pixels whose level is 0 there are left out; same size as the reference
  const imaging::Image* mask = nullptr;
  /// pixels nearer than this to the mesh's contour are left out [px]: at the specimen's edge the spline rings, and that
  /// belongs to the background as much as to the specimen
  double border = 0.0;
  std::vector<char> left_out = {};  ///< elements that get no pixels [elements]; empty: none
  /// contour edges between two of these are where the specimen goes on: no border there
  std::vector<int> cut_nodes = {};
  bool clip = false;           ///< elements may reach beyond the reference image: the pixels there are left out
  std::string place = "mesh";  ///< what messages call the mesh or the entry that places it
};

/// The quadrature of quadrilaterals [m x 4, node numbers] whose nodes lie at `positions`. Throws InputError if the mesh
/// does not lie on the image (how many elements, on which side), or if an element is not convex in the image.
[[nodiscard]] PixelQuadrature quadrature(const mesh::Cells& cells, const InImage& positions,
                                         const imaging::BSpline& reference, const QuadratureOptions& options = {});

/// Variance of the reference's grey levels in each element [elements, grey level^2]; 0 without pixels.
[[nodiscard]] Eigen::VectorXd variance_of_elements(const PixelQuadrature& quadrature);

/// An image that is 255 where the quadrature has a pixel and 0 elsewhere, e.g. as a mask.
[[nodiscard]] imaging::Image footprint(const PixelQuadrature& quadrature, int width, int height);

}  // namespace imic3d::correlation
