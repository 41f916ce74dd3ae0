#pragma once
// The specimen as the identification sees it: the volume, the faces that cameras see, and its two ends.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <string>
#include <vector>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::identification {

/// How a simulation is driven (Secs 3.4 and 4.3).
enum class Control {
  displacement,  ///< the DIC displacement is prescribed on both ends
  force,         ///< nodal forces with the measured resultant on both ends; only rigid-body modes are held
  /// the same forces and the images' pull (Eq. 7, finite alpha): held is only what no camera sees
  images
};

/// A face that cameras see, and which components of its displacement they do.
struct SeenFace {
  bool back = false;   ///< the face towards -z
  int components = 2;  ///< 2: x, y; 3: x, y, z
};

/// One of the seen faces and its place among the unknowns of all.
struct Face : SeenFace {
  mesh::Surface surface;
  Eigen::Index first_node = 0, first_cell = 0, first_unknown = 0;
  [[nodiscard]] Eigen::Index nodes() const { return surface.mesh.nodes.rows(); }
  [[nodiscard]] Eigen::Index unknowns() const { return components * nodes(); }
};

/// Volume, seen faces and ends of a specimen. The displacement of the seen surface is that of its faces one after the
/// other, each with its components node by node: [unknowns]; with one face and two components [2 * surface nodes].
/// Degrees of freedom: 3 * node + component, natural numbering. In plane stress the volume is the quad mesh itself,
/// whose nodes do not move along z.
struct Specimen {
  mesh::Mesh volume;
  mesh::Surface surface;                   ///< the seen faces as one mesh
  std::vector<Face> faces;                 ///< front before back
  Eigen::SparseMatrix<double> projection;  ///< P of Eq. 15 [unknowns x 3 * nodes]
  int axis = 1;                            ///< direction of the load: 0 (x) or 1 (y)
  /// measured force / force on the simulated part (2 with mid-plane symmetry)
  double section_factor = 1.0;
  std::vector<int> held, loaded;       ///< volume nodes of the two ends
  std::vector<int> displacement_dofs;  ///< constrained under Control::displacement, ascending
  std::vector<int> force_dofs;         ///< constrained under Control::force: a statically determinate support
  /// constrained under Control::images: those of force_dofs that P does not see
  std::vector<int> images_dofs;
  /// Displacement of the constrained degrees from that of the seen surface [dofs x unknowns]: x and y of the face at
  /// the same place; where both faces are seen linear from one to the other.
  Eigen::SparseMatrix<double> displacement_from_surface, force_from_surface, images_from_surface;
  [[nodiscard]] const std::vector<int>& dofs(Control control) const {
    return control == Control::displacement ? displacement_dofs : control == Control::force ? force_dofs : images_dofs;
  }
  [[nodiscard]] const Eigen::SparseMatrix<double>& from_surface(Control control) const {
    return control == Control::displacement ? displacement_from_surface
           : control == Control::force      ? force_from_surface
                                            : images_from_surface;
  }
  /// Whether cameras see how the specimen moves along z.
  [[nodiscard]] bool out_of_plane() const;
  /// Displacement of the seen surface [unknowns] out of a volume displacement [3 * nodes]: Eq. 15.
  [[nodiscard]] Eigen::VectorXd project(const Eigen::VectorXd& displacement) const;
  /// Three components of every surface node [3 * surface nodes] from [unknowns]; `unseen` where no camera sees one.
  [[nodiscard]] Eigen::VectorXd three_components(const Eigen::VectorXd& displacement, double unseen = 0.0) const;
};

/// Builds the specimen. `mid_plane_symmetry`: the volume is the front half, its nodes of group `back` cannot move
/// through the thickness (not in plane stress), and the back is the front's mirror image. Throws InputError if a group
/// is unknown or empty.
[[nodiscard]] Specimen make_specimen(mesh::Mesh volume, const std::string& held, const std::string& loaded, int axis,
                                     bool mid_plane_symmetry, const std::string& case_place = "specimen",
                                     const std::vector<SeenFace>& seen = {SeenFace{}});

/// Values of a quad mesh's nodal field at points [k x 2]: sparse weights [k x nodes], from the nearest element.
[[nodiscard]] Eigen::SparseMatrix<double> interpolation(const mesh::Mesh& quads,
                                                        const Eigen::Matrix<double, Eigen::Dynamic, 2>& points);

/// Means of a quad mesh's nodal field over squares of this side about points [k x 2], by Gauss's three points along
/// each edge: sparse weights [k x nodes]. What a subset that is correlated by itself takes for the displacement of its
/// centre.
[[nodiscard]] Eigen::SparseMatrix<double> means_over_squares(const mesh::Mesh& quads,
                                                             const Eigen::Matrix<double, Eigen::Dynamic, 2>& points,
                                                             double side);

/// A matrix for one number a node [k x n] as that for several components a node [components * k x components * n].
[[nodiscard]] Eigen::SparseMatrix<double> of_components(const Eigen::SparseMatrix<double>& scalar, int components = 2);

/// A nodal field of several components of one quad mesh at the nodes of another [components * nodes of `to` x
/// components * nodes of `from`].
[[nodiscard]] Eigen::SparseMatrix<double> between(const mesh::Mesh& from, const mesh::Mesh& to, int components);

}  // namespace imic3d::identification
