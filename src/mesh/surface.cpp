#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "facets.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

int nodes_per_cell(CellType type) {
  switch (type) {
    case CellType::line2: return 2;
    case CellType::quad4: return 4;
    case CellType::quad8:
    case CellType::hex8: return 8;
    case CellType::hex20: return 20;
  }
  return 0;
}

int corners_per_cell(CellType type) {
  if (type == CellType::quad8) return 4;
  return type == CellType::hex20 ? 8 : nodes_per_cell(type);
}

int dimension(CellType type) {
  if (type == CellType::line2) return 1;
  return is_hexahedron(type) ? 3 : 2;
}

std::string name(CellType type) {
  const bool line = type == CellType::line2;
  return fmt::format("{}{}", line ? "line" : is_hexahedron(type) ? "hex" : "quad", nodes_per_cell(type));
}

Cells with_middles(const Mesh& volume, const Cells& facets) {
  if (volume.type != CellType::hex20 && volume.type != CellType::quad8) return facets;
  FacetMap<int> middle;
  const auto add_edges = [&](const auto& edges) {
    for (Eigen::Index c = 0; c < volume.cells.rows(); ++c)
      for (std::size_t e = 0; e < edges.size(); ++e)
        middle.emplace(edge_key(volume.cells(c, edges[e][0]), volume.cells(c, edges[e][1])),
                       volume.cells(c, corners_per_cell(volume.type) + static_cast<Eigen::Index>(e)));
  };
  is_hexahedron(volume.type) ? add_edges(hex_edges) : add_edges(quad_edges);
  if (facets.cols() == 2) {
    Cells all(facets.rows(), 3);
    for (Eigen::Index f = 0; f < facets.rows(); ++f)
      all.row(f) << facets(f, 0), facets(f, 1), middle.at(edge_key(facets(f, 0), facets(f, 1)));
    return all;
  }
  Cells all(facets.rows(), 8);
  for (Eigen::Index f = 0; f < facets.rows(); ++f)
    for (Eigen::Index k = 0; k < 4; ++k) {
      all(f, k) = facets(f, k);
      all(f, 4 + k) = middle.at(edge_key(facets(f, k), facets(f, (k + 1) % 4)));
    }
  return all;
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
  if (!is_hexahedron(mesh.type)) throw InputError("front", "a quadrilateral mesh", "a mesh of hexahedra");
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
  const bool plane = dimension(volume.type) == 2;  // the mesh is what the camera sees
  if (!plane && volume.front.rows() == 0)
    throw InputError("mesh", "no face that the camera sees",
                     "boundary quadrilaterals that face +z, or a named front group");
  const Cells faces_seen = plane ? volume.cells : with_middles(volume, volume.front);
  const bool split = faces_seen.cols() == 8;  // each face into four around its centre
  std::vector<int> seen(faces_seen.data(), faces_seen.data() + faces_seen.size());
  std::sort(seen.begin(), seen.end());
  seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
  std::vector<int> number(static_cast<std::size_t>(volume.nodes.rows()), -1);
  for (std::size_t i = 0; i < seen.size(); ++i) number[static_cast<std::size_t>(seen[i])] = static_cast<int>(i);

  Surface surface;
  Mesh& quads = surface.mesh;
  quads.type = CellType::quad4;
  const auto on_volume = static_cast<Eigen::Index>(seen.size()), front = faces_seen.rows();
  std::vector<Eigen::Triplet<double>> weights;
  for (Eigen::Index i = 0; i < on_volume; ++i)
    weights.emplace_back(static_cast<int>(i), seen[static_cast<std::size_t>(i)], 1.0);
  const auto at = [&](Eigen::Index face, Eigen::Index k) {
    return number[static_cast<std::size_t>(faces_seen(face, k))];
  };
  quads.cells.resize(split ? 4 * front : front, 4);
  for (Eigen::Index f = 0; f < front; ++f) {
    if (!split) {
      for (Eigen::Index k = 0; k < 4; ++k) quads.cells(f, k) = at(f, k);
      continue;
    }
    const auto centre = static_cast<int>(on_volume + f);
    for (Eigen::Index k = 0; k < 4; ++k) {  // the serendipity shape functions at the centre
      weights.emplace_back(centre, faces_seen(f, k), -0.25);
      weights.emplace_back(centre, faces_seen(f, 4 + k), 0.5);
    }
    quads.cells.middleRows(4 * f, 4) << at(f, 0), at(f, 4), centre, at(f, 7),  //
        at(f, 4), at(f, 1), at(f, 5), centre,                                  //
        centre, at(f, 5), at(f, 2), at(f, 6),                                  //
        at(f, 7), centre, at(f, 6), at(f, 3);
  }
  surface.weights.resize(split ? on_volume + front : on_volume, volume.nodes.rows());
  surface.weights.setFromTriplets(weights.begin(), weights.end());
  quads.nodes = surface.weights * volume.nodes;

  for (const auto& [name, members] : volume.node_groups) {
    std::vector<int> group;
    for (int node : members)
      if (number[static_cast<std::size_t>(node)] >= 0) group.push_back(number[static_cast<std::size_t>(node)]);
    if (!group.empty()) quads.node_groups[name] = std::move(group);
  }
  // An edge belongs to the facet groups of the volume's faces that it bounds; in a quad mesh it is the facet.
  const Facets edges = boundary_facets(quads);
  FacetMap<Eigen::Index> edge_at;
  for (Eigen::Index e = 0; e < edges.nodes.rows(); ++e)
    edge_at.emplace(edge_key(edges.nodes(e, 0), edges.nodes(e, 1)), e);
  FacetMap<int> in_front;
  for (Eigen::Index f = 0; !plane && f < front; ++f)
    in_front.emplace(facet_key(volume.front.row(f), 4), static_cast<int>(f));
  for (const auto& [name, faces] : volume.facet_groups) {
    std::vector<Eigen::Index> group;
    const Cells whole = with_middles(volume, faces);
    const auto add = [&](int a, int b) {
      const int on_a = number[static_cast<std::size_t>(a)], on_b = number[static_cast<std::size_t>(b)];
      if (on_a < 0 || on_b < 0) return;
      if (const auto found = edge_at.find(edge_key(on_a, on_b)); found != edge_at.end()) group.push_back(found->second);
    };
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      if (!plane && in_front.contains(facet_key(faces.row(f), 4))) continue;
      for (Eigen::Index k = 0; k < (plane ? 1 : 4); ++k) {
        const int a = faces(f, k), b = faces(f, (k + 1) % faces.cols());
        if (!split) add(a, b);
        if (split) add(a, whole(f, faces.cols() + k)), add(whole(f, faces.cols() + k), b);
      }
    }
    if (group.empty()) continue;
    std::sort(group.begin(), group.end());
    group.erase(std::unique(group.begin(), group.end()), group.end());
    auto& rows = quads.facet_groups[name];
    rows.resize(static_cast<Eigen::Index>(group.size()), 2);
    for (std::size_t i = 0; i < group.size(); ++i) rows.row(static_cast<Eigen::Index>(i)) = edges.nodes.row(group[i]);
  }
  const Facets faces = boundary_facets(volume);
  std::vector<int> cell_of_face(static_cast<std::size_t>(front), -1);
  if (plane) std::iota(cell_of_face.begin(), cell_of_face.end(), 0);
  for (Eigen::Index f = 0; !plane && f < faces.nodes.rows(); ++f)
    if (const auto found = in_front.find(facet_key(faces.nodes.row(f), 4)); found != in_front.end())
      cell_of_face[static_cast<std::size_t>(found->second)] = faces.cells[static_cast<std::size_t>(f)];
  const int children = split ? 4 : 1;
  for (const auto& [name, members] : volume.cell_groups) {
    std::vector<int> group;
    for (std::size_t f = 0; f < cell_of_face.size(); ++f)
      if (std::binary_search(members.begin(), members.end(), cell_of_face[f]))
        for (int child = 0; child < children; ++child) group.push_back(children * static_cast<int>(f) + child);
    if (!group.empty()) quads.cell_groups[name] = std::move(group);
  }
  return surface;
}

Surface back_surface(const Mesh& volume) {
  Mesh turned = volume;
  if (volume.node_groups.contains("back")) {
    choose_front(turned, "back");
  } else {
    const Facets boundary = boundary_facets(volume);
    std::vector<Eigen::Index> rows;
    for (Eigen::Index f = 0; dimension(volume.type) == 3 && f < boundary.nodes.rows(); ++f) {
      const auto at = [&](int k) -> Eigen::Vector3d { return volume.nodes.row(boundary.nodes(f, k)).transpose(); };
      const Eigen::Vector3d normal = (at(2) - at(0)).cross(at(3) - at(1)).normalized();
      if (normal[2] < -std::cos(M_PI / 6.0)) rows.push_back(f);
    }
    turned.front = boundary.nodes(rows, Eigen::all);
  }
  if (turned.front.rows() == 0)
    throw InputError("mesh", "no face that a camera at the back sees",
                     "boundary quadrilaterals that face -z, or a named back group");
  const Eigen::VectorXi second = turned.front.col(1);
  turned.front.col(1) = turned.front.col(3);
  turned.front.col(3) = second;
  return front_surface(turned);
}

double plane_area(const Mesh& quads) {
  double area = 0.0;
  for (Eigen::Index e = 0; e < quads.cells.rows(); ++e) {
    const auto diagonal = [&](int a, int b) {
      return Eigen::Vector2d((quads.nodes.row(quads.cells(e, b)) - quads.nodes.row(quads.cells(e, a))).head<2>());
    };
    const Eigen::Vector2d p = diagonal(0, 2), q = diagonal(1, 3);
    area += 0.5 * std::abs(p.x() * q.y() - p.y() * q.x());
  }
  return area;
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

std::vector<Bulge> bulges(const Mesh& quads) {
  constexpr double
      corner = 40.0 / 180.0 * M_PI,
      straight = 1e-6,
      level = 1e-4;  // level: curvature times edge of a contour that is straight but for the digits of its nodes
  std::vector<Bulge> found;
  for (const auto& contour : contours(quads)) {
    const std::size_t n = contour.size();
    const auto place = [&](std::size_t i) -> Eigen::Vector2d {
      return quads.nodes.row(contour[i % n]).head<2>().transpose();
    };
    const auto cross = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); };
    // Of the circle through a node and its neighbours; to the left is positive, NaN at a corner.
    const auto curvature = [&](std::size_t i) {
      const Eigen::Vector2d in = place(i) - place(i + n - 1), out = place(i + 1) - place(i);
      const double turn = std::atan2(cross(in, out), in.dot(out));
      if (std::abs(turn) > corner) return std::nan("");
      return 2.0 * cross(in, out) / (in.norm() * out.norm() * (in + out).norm());
    };
    for (std::size_t i = 0; i < n; ++i) {
      const double reach = (place(i + 1) - place(i)).norm();
      const auto is_straight = [&](double bent) { return std::abs(bent) * reach < level; };
      double a = curvature(i), b = curvature(i + 1);
      if (std::isnan(a) && std::isnan(b)) continue;
      if (std::isnan(a)) a = b;
      if (std::isnan(b)) b = a;
      if (is_straight(a) || is_straight(b)) continue;
      // Where a straight part meets an arc the circle through the last node has half the arc's curvature: the other end
      // knows it.
      const bool after_straight = is_straight(curvature(i + n - 1)), before_straight = is_straight(curvature(i + 2));
      double bent = after_straight && !before_straight ? b : before_straight && !after_straight ? a : 0.5 * (a + b);
      // Of sixth order by the neighbours' curvature, if that is the smooth contour's, too: six points, of which the
      // outer ones lie on no straight part.
      const double before = curvature(i + n - 1), after = curvature(i + 2);
      const auto smooth = [&](double neighbour, double beyond) {
        return !std::isnan(neighbour) && !is_straight(neighbour) && !is_straight(beyond);
      };
      if (n > 6 && smooth(before, curvature(i + n - 2)) && smooth(after, curvature(i + 3)))
        bent -= 3.0 / 32.0 * (before + after - a - b);
      const Eigen::Vector2d edge = place(i + 1) - place(i);
      const double length = edge.norm();
      if (std::abs(bent) * length < straight) continue;
      const double radius = 1.0 / std::abs(bent);
      const double rise = radius - std::sqrt(std::max(0.0, radius * radius - 0.25 * length * length));
      const Eigen::Vector2d right(edge.y() / length, -edge.x() / length);
      found.push_back({contour[i], contour[(i + 1) % n], (bent > 0.0 ? rise : -rise) * right});
    }
  }
  return found;
}

}  // namespace imic3d::mesh
