#pragma once
// The specimen as the identification sees it: the volume, the surface that the camera sees, and its two ends.

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
  images         ///< the same forces and the images' pull (Eq. 7, finite alpha): held is only what no camera sees
};

/// Volume, camera surface and ends of a specimen. Degrees of freedom: 3 * node + component, natural numbering.
struct Specimen {
  mesh::Mesh volume;
  mesh::Surface surface;            ///< the camera's face of the volume
  Eigen::SparseMatrix<double> projection;  ///< P of Eq. 15 [2 * surface nodes x 3 * nodes]
  int axis = 1;                     ///< direction of the load: 0 (x) or 1 (y)
  double section_factor = 1.0;      ///< measured force / force on the simulated part (2 with mid-plane symmetry)
  std::vector<int> held, loaded;    ///< volume nodes of the two ends
  std::vector<int> displacement_dofs;  ///< constrained under Control::displacement, ascending
  std::vector<int> force_dofs;         ///< constrained under Control::force: a statically determinate support
  std::vector<int> images_dofs;        ///< constrained under Control::images: those of force_dofs that P does not see
  /// Displacement of the constrained degrees from a surface displacement [2 * surface nodes]: [dofs x 2 surface nodes].
  Eigen::SparseMatrix<double> displacement_from_surface, force_from_surface, images_from_surface;
  [[nodiscard]] const std::vector<int>& dofs(Control control) const {
    return control == Control::displacement ? displacement_dofs : control == Control::force ? force_dofs : images_dofs;
  }
  [[nodiscard]] const Eigen::SparseMatrix<double>& from_surface(Control control) const {
    return control == Control::displacement ? displacement_from_surface
           : control == Control::force      ? force_from_surface
                                            : images_from_surface;
  }
  /// In-plane displacement of the surface nodes [2 * surface nodes] out of a volume displacement [3 * nodes]: Eq. 15.
  [[nodiscard]] Eigen::VectorXd project(const Eigen::VectorXd& displacement) const;
};

/// Builds the specimen. `mid_plane_symmetry`: the volume is the camera's half, its nodes of group `back` cannot move
/// through the thickness. Throws InputError if a group is unknown or empty.
[[nodiscard]] Specimen make_specimen(mesh::Mesh volume, const std::string& held, const std::string& loaded, int axis,
                                     bool mid_plane_symmetry, const std::string& case_place = "specimen");

/// Values of a quad mesh's nodal field at points [k x 2]: sparse weights [k x nodes], from the nearest element.
[[nodiscard]] Eigen::SparseMatrix<double> interpolation(const mesh::Mesh& quads,
                                                        const Eigen::Matrix<double, Eigen::Dynamic, 2>& points);

/// The same for two components per node: [2k x 2 nodes].
[[nodiscard]] Eigen::SparseMatrix<double> two_components(const Eigen::SparseMatrix<double>& scalar);

}  // namespace imic3d::identification
