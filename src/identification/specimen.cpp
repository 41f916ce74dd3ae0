#include "imic3d/identification/specimen.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "imic3d/core/error.hpp"

namespace imic3d::identification {

namespace {

const std::vector<int>& group(const mesh::Mesh& mesh, const std::string& name, const std::string& place) {
  const auto found = mesh.node_groups.find(name);
  if (found != mesh.node_groups.end() && !found->second.empty()) return found->second;
  std::string names;
  for (const auto& [known, nodes] : mesh.node_groups) names += (names.empty() ? "" : ", ") + known;
  throw InputError(place, fmt::format("group \"{}\" is not in the mesh", name), "one of " + names);
}

struct LocalPoint {
  double xi = 0.0, eta = 0.0, outside = std::numeric_limits<double>::infinity();
};

std::array<double, 4> shape(double xi, double eta) {
  return {0.25 * (1 - xi) * (1 - eta), 0.25 * (1 + xi) * (1 - eta), 0.25 * (1 + xi) * (1 + eta),
          0.25 * (1 - xi) * (1 + eta)};
}

/// Inverse of the bilinear map by Newton; `outside` is the distance of the clamped point, in the mesh's unit.
LocalPoint locate(const mesh::Mesh& quads, Eigen::Index cell, const Eigen::Vector2d& point) {
  Eigen::Matrix<double, 2, 4> corners;
  for (int a = 0; a < 4; ++a) corners.col(a) = quads.nodes.row(quads.cells(cell, a)).head<2>().transpose();
  Eigen::Vector2d local = Eigen::Vector2d::Zero();
  for (int iteration = 0; iteration < 20; ++iteration) {
    const auto n = shape(local[0], local[1]);
    const Eigen::Vector2d gap = point - corners * Eigen::Map<const Eigen::Vector4d>(n.data());
    Eigen::Matrix<double, 4, 2> dn;
    dn << -(1 - local[1]), -(1 - local[0]), 1 - local[1], -(1 + local[0]), 1 + local[1], 1 + local[0], -(1 + local[1]),
        1 - local[0];
    const Eigen::Matrix2d jacobian = 0.25 * corners * dn;
    const Eigen::Vector2d step = jacobian.inverse() * gap;
    local = (local + step).cwiseMax(-3.0).cwiseMin(3.0);
    if (step.norm() < 1e-13) break;
  }
  const Eigen::Vector2d clamped = local.cwiseMax(-1.0).cwiseMin(1.0);
  const auto n = shape(clamped[0], clamped[1]);
  return {clamped[0], clamped[1], (point - corners * Eigen::Map<const Eigen::Vector4d>(n.data())).norm()};
}

}  // namespace

Eigen::SparseMatrix<double> interpolation(const mesh::Mesh& quads,
                                          const Eigen::Matrix<double, Eigen::Dynamic, 2>& points) {
  std::vector<Eigen::Triplet<double>> weights;
  const Eigen::Index cells = quads.cells.rows();
  std::vector<std::array<double, 4>> boxes;  // low x, high x, low y, high y
  for (Eigen::Index cell = 0; cell < cells; ++cell) {
    auto& box = boxes.emplace_back(std::array<double, 4>{INFINITY, -INFINITY, INFINITY, -INFINITY});
    for (int a = 0; a < 4; ++a)
      for (std::size_t i = 0; i < 2; ++i) {
        const double x = quads.nodes(quads.cells(cell, a), static_cast<Eigen::Index>(i));
        box[2 * i] = std::min(box[2 * i], x), box[2 * i + 1] = std::max(box[2 * i + 1], x);
      }
  }
  for (Eigen::Index k = 0; k < points.rows(); ++k) {
    LocalPoint best;
    Eigen::Index owner = 0;
    const double x = points(k, 0), y = points(k, 1);
    for (Eigen::Index cell = 0; cell < cells; ++cell) {
      const auto& box = boxes[static_cast<std::size_t>(cell)];
      const double dx = std::max({box[0] - x, x - box[1], 0.0}), dy = std::max({box[2] - y, y - box[3], 0.0});
      if (dx >= best.outside || dy >= best.outside || std::hypot(dx, dy) >= best.outside) continue;
      const LocalPoint local = locate(quads, cell, points.row(k).transpose());
      if (local.outside < best.outside) best = local, owner = cell;
      if (best.outside < 1e-12) break;
    }
    const auto n = shape(best.xi, best.eta);
    for (int a = 0; a < 4; ++a)
      if (std::abs(n[static_cast<std::size_t>(a)]) > 1e-14)
        weights.emplace_back(static_cast<int>(k), quads.cells(owner, a), n[static_cast<std::size_t>(a)]);
  }
  Eigen::SparseMatrix<double> matrix(points.rows(), quads.nodes.rows());
  matrix.setFromTriplets(weights.begin(), weights.end());
  return matrix;
}

Eigen::SparseMatrix<double> means_over_squares(const mesh::Mesh& quads,
                                               const Eigen::Matrix<double, Eigen::Dynamic, 2>& points, double side) {
  if (side == 0.0) return interpolation(quads, points);
  const std::array<std::pair<double, double>, 3> gauss{
      {{-0.5 * std::sqrt(0.6), 5.0 / 18.0},
       {0.0, 8.0 / 18.0},
       {0.5 * std::sqrt(0.6), 5.0 / 18.0}}};  // place in the side, weight
  Eigen::SparseMatrix<double> matrix(points.rows(), quads.nodes.rows());
  for (const auto& [x, along] : gauss)
    for (const auto& [y, across] : gauss)
      matrix += along * across * interpolation(quads, points.rowwise() + side * Eigen::RowVector2d(x, y));
  return matrix;
}

Eigen::SparseMatrix<double> of_components(const Eigen::SparseMatrix<double>& scalar, int components) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int column = 0; column < scalar.outerSize(); ++column)
    for (Eigen::SparseMatrix<double>::InnerIterator entry(scalar, column); entry; ++entry)
      for (int i = 0; i < components; ++i)
        entries.emplace_back(components * static_cast<int>(entry.row()) + i, components * column + i, entry.value());
  Eigen::SparseMatrix<double> matrix(components * scalar.rows(), components * scalar.cols());
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

namespace {

/// The faces one after the other as one mesh.
mesh::Surface joined(const std::vector<Face>& faces) {
  if (faces.size() == 1) return faces.front().surface;
  mesh::Surface all;
  all.mesh.type = mesh::CellType::quad4;
  Eigen::Index nodes = 0, cells = 0;
  for (const Face& face : faces) nodes += face.nodes(), cells += face.surface.mesh.cells.rows();
  all.mesh.nodes.resize(nodes, 3);
  all.mesh.cells.resize(cells, 4);
  std::vector<Eigen::Triplet<double>> weights;
  for (const Face& face : faces) {
    const mesh::Mesh& own = face.surface.mesh;
    all.mesh.nodes.middleRows(face.first_node, own.nodes.rows()) = own.nodes;
    all.mesh.cells.middleRows(face.first_cell, own.cells.rows()) =
        own.cells.array() + static_cast<int>(face.first_node);
    for (const auto& [name, members] : own.node_groups)
      for (const int node : members) all.mesh.node_groups[name].push_back(node + static_cast<int>(face.first_node));
    for (int i = 0; i < face.surface.weights.outerSize(); ++i)
      for (decltype(face.surface.weights)::InnerIterator entry(face.surface.weights, i); entry; ++entry)
        weights.emplace_back(static_cast<int>(face.first_node) + i, static_cast<int>(entry.col()), entry.value());
  }
  all.weights.resize(nodes, faces.front().surface.weights.cols());
  all.weights.setFromTriplets(weights.begin(), weights.end());
  return all;
}

/// Faces and P of Eq. 15. With mid-plane symmetry the back moves as the front does, z turned.
void see(Specimen& specimen, const std::vector<SeenFace>& seen, bool mid_plane_symmetry) {
  const double mid_plane = specimen.volume.nodes.col(2).minCoeff();
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::Index nodes = 0, cells = 0, unknowns = 0;
  for (const SeenFace& which : seen) {
    const bool mirrored = which.back && mid_plane_symmetry;
    Face face{which,
              which.back && !mirrored ? mesh::back_surface(specimen.volume) : mesh::front_surface(specimen.volume),
              nodes, cells, unknowns};
    if (mirrored) face.surface.mesh.nodes.col(2) = 2.0 * mid_plane - face.surface.mesh.nodes.col(2).array();
    for (int i = 0; i < face.surface.weights.outerSize(); ++i)
      for (decltype(face.surface.weights)::InnerIterator entry(face.surface.weights, i); entry; ++entry)
        for (int component = 0; component < face.components; ++component)
          entries.emplace_back(static_cast<int>(unknowns) + face.components * i + component,
                               3 * static_cast<int>(entry.col()) + component,
                               mirrored && component == 2 ? -entry.value() : entry.value());
    nodes += face.nodes(), cells += face.surface.mesh.cells.rows(), unknowns += face.unknowns();
    specimen.faces.push_back(std::move(face));
  }
  specimen.surface = joined(specimen.faces);
  specimen.projection.resize(unknowns, 3 * specimen.volume.nodes.rows());
  specimen.projection.setFromTriplets(entries.begin(), entries.end());
}

/// Displacement of `dofs` from that of the seen surface.
Eigen::SparseMatrix<double> from_surface(const Specimen& specimen, const std::vector<int>& dofs,
                                         bool mid_plane_symmetry) {
  const auto& nodes = specimen.volume.nodes;
  Eigen::Matrix<double, Eigen::Dynamic, 2> points(static_cast<Eigen::Index>(dofs.size()), 2);
  for (std::size_t i = 0; i < dofs.size(); ++i)
    points.row(static_cast<Eigen::Index>(i)) = nodes.row(dofs[i] / 3).head<2>();
  const double front = nodes.col(2).maxCoeff(), back = nodes.col(2).minCoeff();
  std::vector<Eigen::Triplet<double>> entries;
  for (const Face& face : specimen.faces) {
    const auto weights = interpolation(face.surface.mesh, points);
    for (int column = 0; column < weights.outerSize(); ++column)
      for (Eigen::SparseMatrix<double>::InnerIterator entry(weights, column); entry; ++entry) {
        const int dof = dofs[static_cast<std::size_t>(entry.row())], component = dof % 3;
        if (component > 1) continue;
        const double depth = mid_plane_symmetry ? 0.5 : (front - nodes(dof / 3, 2)) / (front - back);
        const double share = specimen.faces.size() == 1 ? 1.0 : face.back ? depth : 1.0 - depth;
        if (share != 0.0)
          entries.emplace_back(static_cast<int>(entry.row()),
                               static_cast<int>(face.first_unknown) + face.components * column + component,
                               share * entry.value());
      }
  }
  Eigen::SparseMatrix<double> matrix(static_cast<Eigen::Index>(dofs.size()), specimen.projection.rows());
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

}  // namespace

Eigen::VectorXd Specimen::project(const Eigen::VectorXd& displacement) const { return projection * displacement; }

bool Specimen::out_of_plane() const {
  return std::any_of(faces.begin(), faces.end(), [](const Face& face) { return face.components == 3; });
}

Eigen::VectorXd Specimen::three_components(const Eigen::VectorXd& displacement, double unseen) const {
  Eigen::VectorXd all = Eigen::VectorXd::Constant(3 * surface.mesh.nodes.rows(), unseen);
  for (const Face& face : faces)
    for (Eigen::Index i = 0; i < face.nodes(); ++i)
      all.segment(3 * (face.first_node + i), face.components) =
          displacement.segment(face.first_unknown + face.components * i, face.components);
  return all;
}

Specimen make_specimen(mesh::Mesh volume, const std::string& held, const std::string& loaded, int axis,
                       bool mid_plane_symmetry, const std::string& case_place, const std::vector<SeenFace>& seen) {
  Specimen specimen;
  specimen.volume = std::move(volume);
  see(specimen, seen, mid_plane_symmetry);
  specimen.axis = axis;
  specimen.section_factor = mid_plane_symmetry ? 2.0 : 1.0;
  const auto& nodes = specimen.volume.nodes;
  specimen.held = group(specimen.volume, held, case_place + ".held");
  specimen.loaded = group(specimen.volume, loaded, case_place + ".loaded");

  // Nodes for the supports on the front: the middles of both ends, and a corner of the held one. The middle of the
  // loaded end, guided across the axis, keeps the specimen from turning: held at one end alone it would buckle under a
  // quarter of the force. Corners would yield under what a specimen in compression asks of them.
  const int across = 1 - axis;
  const double front = nodes.col(2).maxCoeff();
  const auto extreme = [&](const std::vector<int>& candidates, auto measure) {
    int best = -1;
    double value = -std::numeric_limits<double>::infinity();
    for (int node : candidates) {
      const double m = measure(node) + (nodes(node, 2) > front - 1e-9 * (1 + std::abs(front)) ? 1e6 : 0.0);
      if (m > value) value = m, best = node;
    }
    return best;
  };
  const double middle = 0.5 * (nodes.col(across).maxCoeff() + nodes.col(across).minCoeff());
  const int a = extreme(specimen.held, [&](int n) { return -std::abs(nodes(n, across) - middle); });
  const int b = extreme(specimen.held, [&](int n) { return nodes(n, across); });
  const int c = extreme(specimen.loaded, [&](int n) { return -std::abs(nodes(n, across) - middle); });

  const bool guided = std::abs(nodes(c, axis) - nodes(a, axis)) > 0.25 * std::abs(nodes(b, across) - nodes(a, across));
  std::set<int> displacement_dofs, force_dofs = {3 * a, 3 * a + 1, guided ? 3 * c + across : 3 * b + axis};
  for (const auto* end : {&specimen.held, &specimen.loaded})
    for (int node : *end) displacement_dofs.insert({3 * node, 3 * node + 1});
  const bool plane = mesh::dimension(specimen.volume.type) == 2;
  if (mid_plane_symmetry) {
    for (int node : group(specimen.volume, "back", case_place + ".mid_plane_symmetry")) {
      displacement_dofs.insert(3 * node + 2);
      force_dofs.insert(3 * node + 2);
    }
  } else if (!plane) {
    displacement_dofs.insert(3 * a + 2);
    force_dofs.insert({3 * a + 2, 3 * b + 2, 3 * c + 2});
  }
  specimen.displacement_dofs.assign(displacement_dofs.begin(), displacement_dofs.end());
  specimen.force_dofs.assign(force_dofs.begin(), force_dofs.end());
  for (int dof : force_dofs)  // one camera sees every motion in its plane, several see those through it too
    if (dof % 3 == 2 && (mid_plane_symmetry || !specimen.out_of_plane())) specimen.images_dofs.push_back(dof);

  specimen.displacement_from_surface = from_surface(specimen, specimen.displacement_dofs, mid_plane_symmetry);
  specimen.force_from_surface = from_surface(specimen, specimen.force_dofs, mid_plane_symmetry);
  specimen.images_from_surface = from_surface(specimen, specimen.images_dofs, mid_plane_symmetry);
  return specimen;
}

Eigen::SparseMatrix<double> between(const mesh::Mesh& from, const mesh::Mesh& to, int components) {
  return of_components(interpolation(from, to.nodes.leftCols<2>()), components);
}

}  // namespace imic3d::identification
