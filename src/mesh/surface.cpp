#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "facets.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

int nodes_per_cell(CellType type) {
  switch (type) {
    case CellType::line2:
      return 2;
    case CellType::quad4:
      return 4;
    case CellType::hex8:
      return 8;
  }
  return 0;
}

Facets boundary_facets(const Mesh& mesh) {
  const int size = facet_size(mesh.type), per_cell = facets_per_cell(mesh.type);
  FacetMap<int> times;
  times.reserve(static_cast<std::size_t>(mesh.cells.rows() * per_cell));
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    for (int f = 0; f < per_cell; ++f) ++times[facet_key(facet_nodes(mesh, c, f), size)];
  Facets boundary;
  boundary.nodes.resize(std::count_if(times.begin(), times.end(), [](const auto& facet) { return facet.second == 1; }),
                        size);
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    for (int f = 0; f < per_cell; ++f) {
      const auto nodes = facet_nodes(mesh, c, f);
      if (times[facet_key(nodes, size)] != 1) continue;
      const auto row = static_cast<Eigen::Index>(boundary.cells.size());
      for (int k = 0; k < size; ++k) boundary.nodes(row, k) = nodes[static_cast<std::size_t>(k)];
      boundary.cells.push_back(static_cast<int>(c));
    }
  return boundary;
}

void choose_front(Mesh& mesh, const std::string& group) {
  if (mesh.type != CellType::hex8) throw InputError("front", "a quadrilateral mesh", "a mesh of hexahedra");
  if (const auto facets = mesh.facet_groups.find(group); facets != mesh.facet_groups.end()) {
    mesh.front = facets->second;
    return;
  }
  const auto nodes = mesh.node_groups.find(group);
  if (nodes == mesh.node_groups.end()) {
    std::string known;
    for (const auto& [name, members] : mesh.node_groups) known += (known.empty() ? "" : ", ") + name;
    throw InputError("front", fmt::format("group \"{}\"", group), known.empty() ? "a mesh with named groups" : known);
  }
  const Facets boundary = boundary_facets(mesh);
  std::vector<Eigen::Index> rows;
  for (Eigen::Index f = 0; f < boundary.nodes.rows(); ++f) {
    const auto quad = boundary.nodes.row(f);
    if (std::all_of(quad.begin(), quad.end(),
                    [&](int n) { return std::binary_search(nodes->second.begin(), nodes->second.end(), n); }))
      rows.push_back(f);
  }
  if (rows.empty())
    throw InputError("front", fmt::format("group \"{}\" without a face of the boundary", group),
                     "a group of boundary faces");
  mesh.front.resize(static_cast<Eigen::Index>(rows.size()), 4);
  for (std::size_t i = 0; i < rows.size(); ++i)
    mesh.front.row(static_cast<Eigen::Index>(i)) = boundary.nodes.row(rows[i]);
}

Surface front_surface(const Mesh& volume) {
  if (volume.front.rows() == 0)
    throw InputError("mesh", "no face that the camera sees",
                     "boundary quadrilaterals that face +z, or a named front group");
  Surface surface;
  auto& seen = surface.nodes_of_volume;
  seen.assign(volume.front.data(), volume.front.data() + volume.front.size());
  std::sort(seen.begin(), seen.end());
  seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
  std::vector<int> number(static_cast<std::size_t>(volume.nodes.rows()), -1);
  for (std::size_t i = 0; i < seen.size(); ++i) number[static_cast<std::size_t>(seen[i])] = static_cast<int>(i);

  Mesh& quads = surface.mesh;
  quads.type = CellType::quad4;
  quads.nodes.resize(static_cast<Eigen::Index>(seen.size()), 3);
  for (std::size_t i = 0; i < seen.size(); ++i)
    quads.nodes.row(static_cast<Eigen::Index>(i)) = volume.nodes.row(seen[i]);
  quads.cells = volume.front.unaryExpr([&](int node) { return number[static_cast<std::size_t>(node)]; });

  for (const auto& [name, members] : volume.node_groups) {
    std::vector<int> group;
    for (int node : members)
      if (number[static_cast<std::size_t>(node)] >= 0) group.push_back(number[static_cast<std::size_t>(node)]);
    if (!group.empty()) quads.node_groups[name] = std::move(group);
  }
  // An edge belongs to the facet groups of the volume's faces that it bounds.
  const Facets edges = boundary_facets(quads);
  FacetMap<Eigen::Index> edge_at;
  for (Eigen::Index e = 0; e < edges.nodes.rows(); ++e)
    edge_at.emplace(
        edge_key(seen[static_cast<std::size_t>(edges.nodes(e, 0))], seen[static_cast<std::size_t>(edges.nodes(e, 1))]),
        e);
  FacetMap<int> in_front;
  for (Eigen::Index f = 0; f < volume.front.rows(); ++f)
    in_front.emplace(facet_key(volume.front.row(f), 4), static_cast<int>(f));
  for (const auto& [name, faces] : volume.facet_groups) {
    std::vector<Eigen::Index> group;
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      if (in_front.contains(facet_key(faces.row(f), 4))) continue;
      for (Eigen::Index k = 0; k < 4; ++k)
        if (const auto at = edge_at.find(edge_key(faces(f, k), faces(f, (k + 1) % 4))); at != edge_at.end())
          group.push_back(at->second);
    }
    if (group.empty()) continue;
    std::sort(group.begin(), group.end());
    group.erase(std::unique(group.begin(), group.end()), group.end());
    auto& rows = quads.facet_groups[name];
    rows.resize(static_cast<Eigen::Index>(group.size()), 2);
    for (std::size_t i = 0; i < group.size(); ++i) rows.row(static_cast<Eigen::Index>(i)) = edges.nodes.row(group[i]);
  }
  const Facets faces = boundary_facets(volume);
  std::vector<int> cell_of_quad(static_cast<std::size_t>(volume.front.rows()), -1);
  for (Eigen::Index f = 0; f < faces.nodes.rows(); ++f)
    if (const auto at = in_front.find(facet_key(faces.nodes.row(f), 4)); at != in_front.end())
      cell_of_quad[static_cast<std::size_t>(at->second)] = faces.cells[static_cast<std::size_t>(f)];
  for (const auto& [name, members] : volume.cell_groups) {
    std::vector<int> group;
    for (std::size_t q = 0; q < cell_of_quad.size(); ++q)
      if (std::binary_search(members.begin(), members.end(), cell_of_quad[q])) group.push_back(static_cast<int>(q));
    if (!group.empty()) quads.cell_groups[name] = std::move(group);
  }
  return surface;
}

std::vector<std::vector<int>> contours(const Mesh& quads) {
  const Cells edges = boundary_facets(quads).nodes;
  std::map<int, std::vector<int>> next;  // a node where two contours touch has two successors
  for (Eigen::Index e = 0; e < edges.rows(); ++e) next[edges(e, 0)].push_back(edges(e, 1));
  std::vector<std::pair<double, std::vector<int>>> found;
  while (!next.empty()) {
    std::vector<int> contour;
    double area = 0.0;
    int node = next.begin()->first;
    for (auto at = next.begin(); at != next.end(); at = next.find(node)) {
      const int successor = at->second.back();
      at->second.pop_back();
      if (at->second.empty()) next.erase(at);
      contour.push_back(node);
      area +=
          0.5 * (quads.nodes(node, 0) * quads.nodes(successor, 1) - quads.nodes(successor, 0) * quads.nodes(node, 1));
      node = successor;
    }
    found.emplace_back(area, std::move(contour));
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
    return (a.first > 0.0) != (b.first > 0.0) ? a.first > 0.0 : std::abs(a.first) > std::abs(b.first);
  });
  std::vector<std::vector<int>> ordered;
  for (auto& [area, nodes] : found) ordered.push_back(std::move(nodes));
  return ordered;
}

}  // namespace imic3d::mesh
