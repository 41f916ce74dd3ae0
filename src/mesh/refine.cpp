#include <numeric>
#include <set>
#include <utility>

#include "facets.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

namespace {

/// Numbers the new nodes in the order in which they are first met, and puts them in the mean of the nodes they divide.
class NewNodes {
 public:
  explicit NewNodes(const Mesh& coarse) : coarse_(coarse), next_(static_cast<int>(coarse.nodes.rows())) {}

  template <std::size_t N>
  int between(const std::array<int, N>& nodes) {
    const FacetKey key = facet_key(nodes, static_cast<int>(N));
    const auto [at, is_new] = number_.emplace(key, next_);
    if (is_new) {
      ++next_;
      places_.push_back(mean(nodes));
    }
    return at->second;
  }

  template <std::size_t N>
  int inside(const std::array<int, N>& nodes) {
    places_.push_back(mean(nodes));
    return next_++;
  }

  [[nodiscard]] int of(const FacetKey& key) const { return number_.at(key); }

  void move(int node, const Eigen::Vector2d& shift) {
    places_[static_cast<std::size_t>(node - coarse_.nodes.rows())].head<2>() += shift.transpose();
  }

  [[nodiscard]] Nodes all() const {
    Nodes nodes(next_, 3);
    nodes.topRows(coarse_.nodes.rows()) = coarse_.nodes;
    for (std::size_t i = 0; i < places_.size(); ++i)
      nodes.row(coarse_.nodes.rows() + static_cast<Eigen::Index>(i)) = places_[i];
    return nodes;
  }

 private:
  template <std::size_t N>
  Eigen::RowVector3d mean(const std::array<int, N>& nodes) const {
    Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
    for (int node : nodes) sum += coarse_.nodes.row(node);
    return sum / static_cast<double>(N);
  }

  const Mesh& coarse_;
  int next_;
  FacetMap<int> number_;
  std::vector<Eigen::RowVector3d> places_;
};

/// The 2 edges or 4 quads that a coarse boundary facet becomes, with its orientation.
std::vector<std::vector<int>> children_of_facet(const std::vector<int>& facet, const NewNodes& nodes) {
  if (facet.size() == 2) {
    const int middle = nodes.of(edge_key(facet[0], facet[1]));
    return {{facet[0], middle}, {middle, facet[1]}};
  }
  const int centre = nodes.of(facet_key(facet, 4));
  std::vector<std::vector<int>> children;
  for (std::size_t k = 0; k < 4; ++k)
    children.push_back({facet[k], nodes.of(edge_key(facet[k], facet[(k + 1) % 4])), centre,
                        nodes.of(edge_key(facet[k], facet[(k + 3) % 4]))});
  return children;
}

Cells refined(const Cells& facets, const NewNodes& nodes) {
  const Eigen::Index size = facets.cols();
  std::vector<int> flat;
  for (Eigen::Index f = 0; f < facets.rows(); ++f) {
    std::vector<int> facet(static_cast<std::size_t>(size));
    for (Eigen::Index k = 0; k < size; ++k) facet[static_cast<std::size_t>(k)] = facets(f, k);
    for (const auto& child : children_of_facet(facet, nodes)) flat.insert(flat.end(), child.begin(), child.end());
  }
  return Eigen::Map<const Cells>(flat.data(), static_cast<Eigen::Index>(flat.size()) / std::max<Eigen::Index>(size, 1),
                                 size);
}

/// Adds the new nodes on the boundary to the node groups.
void extend_node_groups(const Mesh& coarse, const NewNodes& nodes, bool face_nodes, Mesh& fine) {
  const auto add_from = [&](const Cells& facets, const auto& belongs, std::set<int>& group) {
    for (Eigen::Index f = 0; f < facets.rows(); ++f) {
      const auto size = facets.cols();
      bool all = true;
      for (Eigen::Index k = 0; k < size; ++k) {
        const int a = facets(f, k), b = facets(f, (k + 1) % size);
        all = all && belongs(a);
        if (belongs(a) && belongs(b)) group.insert(nodes.of(edge_key(a, b)));
      }
      if (size == 4 && face_nodes && all) group.insert(nodes.of(facet_key(facets.row(f), 4)));
    }
  };
  const Cells boundary = boundary_facets(coarse).nodes;
  for (const auto& node_group : coarse.node_groups) {
    const auto& name = node_group.first;
    const auto& members = node_group.second;
    std::set<int> group(members.begin(), members.end());
    const auto facets = coarse.facet_groups.find(name);
    if (facets != coarse.facet_groups.end())
      add_from(
          facets->second, [](int) { return true; }, group);
    else
      add_from(
          boundary, [&](int node) { return std::binary_search(members.begin(), members.end(), node); }, group);
    fine.node_groups[name].assign(group.begin(), group.end());
  }
}

Cells children_of_quad(const Mesh& coarse, Eigen::Index c, NewNodes& nodes) {
  std::array<int, 4> corner{}, middle{};
  for (std::size_t k = 0; k < 4; ++k) corner[k] = coarse.cells(c, static_cast<Eigen::Index>(k));
  for (std::size_t k = 0; k < 4; ++k) middle[k] = nodes.between(std::array{corner[k], corner[(k + 1) % 4]});
  const int centre = nodes.inside(corner);
  Cells children(4, 4);
  children << corner[0], middle[0], centre, middle[3],  //
      middle[0], corner[1], middle[1], centre,          //
      centre, middle[1], corner[2], middle[2],          //
      middle[3], centre, middle[2], corner[3];
  return children;
}

/// A hexahedron as a 3 x 3 x 3 lattice of nodes, of which each child takes 2 x 2 x 2.
Cells children_of_hex(const Mesh& coarse, Eigen::Index c, NewNodes& nodes) {
  constexpr std::array<std::array<int, 3>, 8> place{
      {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}}};
  const auto at = [](int i, int j, int k) { return static_cast<std::size_t>(9 * k + 3 * j + i); };
  std::array<int, 8> corner{};
  for (std::size_t k = 0; k < 8; ++k) corner[k] = coarse.cells(c, static_cast<Eigen::Index>(k));
  std::array<int, 27> lattice{};
  const auto lattice_node = [&](int i, int j, int k) {
    std::vector<int> parents;
    for (std::size_t p = 0; p < 8; ++p) {
      const auto matches = [](int x, int corner_place) { return x == 1 || x == 2 * corner_place; };
      if (matches(i, place[p][0]) && matches(j, place[p][1]) && matches(k, place[p][2])) parents.push_back(corner[p]);
    }
    if (parents.size() == 1) return parents[0];
    if (parents.size() == 2) return nodes.between(std::array{parents[0], parents[1]});
    if (parents.size() == 4) return nodes.between(std::array{parents[0], parents[1], parents[2], parents[3]});
    return nodes.inside(corner);
  };
  for (int k = 0; k < 3; ++k)
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i) lattice[at(i, j, k)] = lattice_node(i, j, k);
  Cells children(8, 8);
  for (Eigen::Index child = 0; child < 8; ++child)
    for (Eigen::Index p = 0; p < 8; ++p) {
      const auto& origin = place[static_cast<std::size_t>(child)];
      const auto& offset = place[static_cast<std::size_t>(p)];
      children(child, p) = lattice[at(origin[0] + offset[0], origin[1] + offset[1], origin[2] + offset[2])];
    }
  return children;
}

}  // namespace

Mesh refine(const Mesh& mesh) {
  if (mesh.type != CellType::quad4 && mesh.type != CellType::hex8)
    throw InputError("mesh to be refined", "line cells or quadratic ones", "quadrilaterals or 8-node hexahedra");
  const Eigen::Index children = mesh.type == CellType::quad4 ? 4 : 8;
  NewNodes nodes(mesh);
  Mesh fine;
  fine.type = mesh.type;
  fine.thickness = mesh.thickness;
  fine.cells.resize(children * mesh.cells.rows(), mesh.cells.cols());
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    fine.cells.middleRows(children * c, children) =
        mesh.type == CellType::quad4 ? children_of_quad(mesh, c, nodes) : children_of_hex(mesh, c, nodes);
  if (mesh.type == CellType::quad4)
    for (const Bulge& bulge : bulges(mesh)) nodes.move(nodes.of(edge_key(bulge.from, bulge.to)), bulge.shift);
  fine.nodes = nodes.all();

  extend_node_groups(mesh, nodes, true, fine);
  for (const auto& [name, members] : mesh.cell_groups) {
    auto& group = fine.cell_groups[name];
    for (int cell : members)
      for (int child = 0; child < children; ++child) group.push_back(static_cast<int>(children) * cell + child);
  }
  for (const auto& [name, facets] : mesh.facet_groups) fine.facet_groups[name] = refined(facets, nodes);
  if (mesh.front.rows() > 0) fine.front = refined(mesh.front, nodes);
  return fine;
}

Mesh quadratic(const Mesh& linear) {
  if (linear.type != CellType::hex8 && linear.type != CellType::quad4)
    throw InputError("mesh", name(linear.type), "8-node hexahedra or 4-node quadrilaterals");
  const bool solid = linear.type == CellType::hex8;
  const Eigen::Index corners = linear.cells.cols();
  NewNodes nodes(linear);
  Mesh result = linear;
  result.type = solid ? CellType::hex20 : CellType::quad8;
  result.nodes_per_layer = 0;
  result.cells.resize(linear.cells.rows(), nodes_per_cell(result.type));
  result.cells.leftCols(corners) = linear.cells;
  const auto add_middles = [&](const auto& edges) {
    for (Eigen::Index c = 0; c < linear.cells.rows(); ++c)
      for (std::size_t e = 0; e < edges.size(); ++e)
        result.cells(c, corners + static_cast<Eigen::Index>(e)) =
            nodes.between(std::array{linear.cells(c, edges[e][0]), linear.cells(c, edges[e][1])});
  };
  solid ? add_middles(hex_edges) : add_middles(quad_edges);

  Mesh face;  // with the curved contour
  face.type = CellType::quad4;
  const auto per_layer = solid ? linear.nodes_per_layer : static_cast<int>(linear.nodes.rows());
  if (per_layer > 0) {
    face.nodes = linear.nodes.topRows(per_layer);
    face.cells = solid ? linear.front : linear.cells;
    for (const Bulge& bulge : bulges(face))
      for (int node = 0; node < linear.nodes.rows(); node += per_layer)
        nodes.move(nodes.of(edge_key(node + bulge.from, node + bulge.to)), bulge.shift);
  }
  result.nodes = nodes.all();
  extend_node_groups(linear, nodes, false, result);
  return result;
}

Cells edge_middles(const Mesh& mesh) {
  const Eigen::Index corners = corners_per_cell(mesh.type), edges = nodes_per_cell(mesh.type) - corners;
  std::vector<char> seen(static_cast<std::size_t>(mesh.nodes.rows()), 0);
  Cells middles(mesh.cells.rows() * edges, 3);
  Eigen::Index count = 0;
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    for (Eigen::Index e = 0; e < edges; ++e) {
      const int node = mesh.cells(c, corners + e);
      if (std::exchange(seen[static_cast<std::size_t>(node)], 1) != 0) continue;
      const auto& ends =
          is_hexahedron(mesh.type) ? hex_edges[static_cast<std::size_t>(e)] : quad_edges[static_cast<std::size_t>(e)];
      middles.row(count++) << node, mesh.cells(c, ends[0]), mesh.cells(c, ends[1]);
    }
  middles.conservativeResize(count, 3);
  return middles;
}

}  // namespace imic3d::mesh
