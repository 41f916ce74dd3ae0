#pragma once
// A finite-element mesh as a plain description in natural numbering, the same on every rank.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::mesh {

/// Cells in the usual finite-element order: a quad4 is numbered counter-clockwise, a hex8 has its bottom face first
/// (counter-clockwise seen from inside, i.e. positive volume), then the top face above it. A hex20 has its corners like
/// a hex8, then the middles of the bottom edges 01 12 23 30, of the top edges 45 56 67 74 and of the upright edges
/// 04 15 26 37; a quad8 its corners, then the middles of the edges 01 12 23 30.
enum class CellType { line2, quad4, quad8, hex8, hex20 };
[[nodiscard]] int nodes_per_cell(CellType type);
[[nodiscard]] int corners_per_cell(CellType type);
[[nodiscard]] int dimension(CellType type);
[[nodiscard]] std::string name(CellType type);  ///< as above

/// How a hex8 is integrated (imic3d/mechanics/hexahedron.hpp, one_point.hpp).
enum class Integration { full, one_point, one_point_stabilised };

using Nodes = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Cells = Eigen::Matrix<int, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Nodes [n x 3, length], cells [m x nodes per cell], and named groups.
struct Mesh {
  CellType type = CellType::quad4;
  Integration integration = Integration::full;  ///< hex meshes of 8 nodes
  Nodes nodes;
  Cells cells;
  /// sorted node numbers (of the group's nodes, edges or faces)
  std::map<std::string, std::vector<int>> node_groups;
  std::map<std::string, std::vector<int>> cell_groups;  ///< sorted cell numbers
  /// Boundary edges [k x 2] of a quad mesh or boundary quads [k x 4] of a hex mesh, as corner nodes with the outward
  /// orientation of `boundary_facets`. Every name here is a node group too.
  std::map<std::string, Cells> facet_groups;
  /// Hex meshes: the quadrilaterals that the cameras see [k x 4], counter-clockwise seen from outside, as node numbers.
  Cells front;
  /// Number of 2D nodes per layer if the mesh was extruded (layer 0 is the front face, node = layer * this + i); else
  /// 0.
  int nodes_per_layer = 0;
  /// Of each cell's section force and stiffness what counts [cells]; all of them if empty: a sheet whose thickness
  /// changes.
  Eigen::VectorXd section;
  /// Elastic logarithmic strain that each cell has before the test along `initial_axis` [cells]; none if empty.
  Eigen::VectorXd initial_strain;
  int initial_axis = 1;
  double thickness = 1.0;  ///< quad meshes: of the sheet that they stand for in plane stress [length]
};

/// Reads Gmsh 2.2 / 4.1 (ASCII) `.msh` or Abaqus `.inp` with named groups (physical names; *NSET, *ELSET).
/// Quadrilateral meshes are turned counter-clockwise, hexahedra to positive volume where the file's order is merely
/// reversed. Nodes that no cell uses are dropped; the others keep their order in the file, and so do the cells. `front`
/// of a hex mesh is the surface group `front` if there is one, else the boundary quads whose outward normal is within
/// 30 degrees of +z. Throws InputError (unreadable, no supported cells, inverted or degenerate cells with their
/// numbers).
[[nodiscard]] Mesh read(const std::filesystem::path& file);

/// Sets `front` of a hex mesh to the boundary quads of a facet group or, if `group` is a node group only, to the
/// boundary quads with all nodes in it. Throws InputError (unknown group, no boundary quad in it; says which groups
/// there are).
void choose_front(Mesh& mesh, const std::string& group);

/// Everything wrong with the cells: repeated nodes, zero or negative Jacobian at a corner, quads that do not lie in a
/// plane z = constant, neighbours that overlap (lie on the same side of the edge or face they share); with the cell's
/// number and place. At most 20 mistakes are listed.
[[nodiscard]] std::vector<Mistake> check(const Mesh& mesh, const std::string& name);

/// Extrudes a quad mesh lying at z = z0 (the camera's face, layer 0) to z = z0 - thickness with `layers` hexahedra.
/// Node groups are carried to all layers; the groups `front` and `back` are added; hexahedron = layer * quads + quad.
/// Throws InputError (thickness or layers not positive, not a quad mesh).
[[nodiscard]] Mesh extrude(const Mesh& quads, double thickness, int layers);

/// Moves the layers of an extruded mesh so that they grow away from the free faces: each is `ratio` times as thick as
/// its neighbour nearer to the face. With `one_face` they grow from the front to the back (mid-plane), else from both
/// faces to the middle. Throws InputError (not an extruded mesh, ratio not positive).
void grade_layers(Mesh& mesh, double ratio, bool one_face);

/// Uniform refinement: each quad into 4, each hex8 into 8. In a quad mesh the middles of edges on a curved contour are
/// put on a smooth curve through its nodes (`bulges`). New mid-edge nodes belong to a node group if both ends of
/// their edge do and the edge lies on the boundary (and, for a facet group, on one of its facets); mid-face nodes
/// likewise. Keeps the order: coarse nodes first, the children of cell c are 4c … 4c+3 (8c … 8c+7), child k at corner
/// k. `nodes_per_layer` of a refined hex mesh is 0: refine the quads before the extrusion to keep the layers.
[[nodiscard]] Mesh refine(const Mesh& mesh);

/// The hex20 mesh of a hex8 mesh, the quad8 mesh of a quad4 mesh: its nodes first, then the middles of the edges, which
/// belong to groups as those of `refine` do. In a quad mesh, and where a hex mesh was extruded, edges on a curved
/// contour get their middle on a smooth curve through its nodes.
[[nodiscard]] Mesh quadratic(const Mesh& linear);

/// The middles of a quadratic mesh's edges [k x 3]: node, and the corners at the ends of its edge; each once, by the
/// cells. None in a linear mesh.
[[nodiscard]] Cells edge_middles(const Mesh& mesh);

/// How far the middles of the boundary edges of a quad mesh lie off the straight edge if the contour is smooth.
struct Bulge {
  int from, to;           ///< the edge, in the direction of the contour
  Eigen::Vector2d shift;  ///< of its middle [length]
};
/// The curvature of a node is that of the circle through it and its neighbours, the curvature k of an edge the mean of
/// its ends' less 3/32 (k_before + k_after - k_from - k_to) by the nodes beside them (six points of a smooth contour:
/// sixth order); the mean alone near corners and straight parts. An edge with an end where the contour is straight is
/// straight; one next to such an edge begins an arc and has the curvature of its other end. A node where the contour
/// turns by more than 40 degrees is a corner and has no say. Straight edges are not listed.
[[nodiscard]] std::vector<Bulge> bulges(const Mesh& quads);

/// The facets that belong to one cell only, in the order of the cells, with the cell of each.
/// Edges run counter-clockwise around a quad mesh (the cell on their left); quads are counter-clockwise from outside.
struct Facets {
  Cells nodes;             ///< [k x 2] or [k x 4]
  std::vector<int> cells;  ///< [k]
};
[[nodiscard]] Facets boundary_facets(const Mesh& mesh);

/// Facets of a hex20 mesh with the middles of their edges: [k x 4] corners -> [k x 8]; of a quad8 mesh: [k x 2] -> [k x
/// 3]; for a linear mesh as they are.
[[nodiscard]] Cells with_middles(const Mesh& volume, const Cells& facets);

/// The quads seen by a camera as a mesh of their own: the front of a hex mesh, all of a quad mesh. A face of a hex20
/// and a quad8 are seen as four quads, whose common node is the centre.
struct Surface {
  Mesh mesh;
  /// a surface node's value from the volume's nodes' [surface x volume]
  Eigen::SparseMatrix<double, Eigen::RowMajor> weights;
};
[[nodiscard]] Surface front_surface(const Mesh& volume);

/// The other side of a hex mesh: its surface group `back` if there is one, else the boundary quads whose outward normal
/// is within 30 degrees of -z. Like the front it is counter-clockwise in x and y, i.e. seen through the specimen.
/// Throws InputError (no such face).
[[nodiscard]] Surface back_surface(const Mesh& volume);

/// Of a mesh of quadrilaterals, projected on the plane of x and y [length^2].
[[nodiscard]] double plane_area(const Mesh& quads);

/// Edges that belong to one cell only, as node numbers in order around each contour of a quad mesh
/// (outer contour counter-clockwise first, then the holes, clockwise). The last node is joined to the first.
[[nodiscard]] std::vector<std::vector<int>> contours(const Mesh& quads);

}  // namespace imic3d::mesh
