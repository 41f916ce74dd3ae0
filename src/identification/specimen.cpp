#include "imic3d/identification/specimen.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <fmt/format.h>
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
  return {0.25 * (1 - xi) * (1 - eta), 0.25 * (1 + xi) * (1 - eta), 0.25 * (1 + xi) * (1 + eta), 0.25 * (1 - xi) * (1 + eta)};
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
    const Eigen::Vector2d step = jacobian.fullPivLu().solve(gap);
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
  Eigen::MatrixXd low(cells, 2), high(cells, 2);
  for (Eigen::Index cell = 0; cell < cells; ++cell) {
    low.row(cell).setConstant(std::numeric_limits<double>::infinity());
    high.row(cell).setConstant(-std::numeric_limits<double>::infinity());
    for (int a = 0; a < 4; ++a) {
      const auto corner = quads.nodes.row(quads.cells(cell, a)).head<2>();
      low.row(cell) = low.row(cell).cwiseMin(corner);
      high.row(cell) = high.row(cell).cwiseMax(corner);
    }
  }
  for (Eigen::Index k = 0; k < points.rows(); ++k) {
    LocalPoint best;
    Eigen::Index owner = 0;
    for (Eigen::Index cell = 0; cell < cells; ++cell) {
      const double away = (low.row(cell) - points.row(k)).cwiseMax(points.row(k) - high.row(cell)).cwiseMax(0.0).norm();
      if (away >= best.outside) continue;
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

Eigen::SparseMatrix<double> two_components(const Eigen::SparseMatrix<double>& scalar) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int column = 0; column < scalar.outerSize(); ++column)
    for (Eigen::SparseMatrix<double>::InnerIterator entry(scalar, column); entry; ++entry)
      for (int i = 0; i < 2; ++i)
        entries.emplace_back(2 * static_cast<int>(entry.row()) + i, 2 * column + i, entry.value());
  Eigen::SparseMatrix<double> matrix(2 * scalar.rows(), 2 * scalar.cols());
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

Eigen::VectorXd Specimen::project(const Eigen::VectorXd& displacement) const { return projection * displacement; }

Specimen make_specimen(mesh::Mesh volume, const std::string& held, const std::string& loaded, int axis,
                       bool mid_plane_symmetry, const std::string& case_place) {
  Specimen specimen;
  specimen.volume = std::move(volume);
  specimen.surface = mesh::front_surface(specimen.volume);
  std::vector<Eigen::Triplet<double>> seen;
  for (int i = 0; i < specimen.surface.weights.outerSize(); ++i)
    for (decltype(specimen.surface.weights)::InnerIterator entry(specimen.surface.weights, i); entry; ++entry)
      for (int component = 0; component < 2; ++component)
        seen.emplace_back(2 * i + component, 3 * static_cast<int>(entry.col()) + component, entry.value());
  specimen.projection.resize(2 * specimen.surface.mesh.nodes.rows(), 3 * specimen.volume.nodes.rows());
  specimen.projection.setFromTriplets(seen.begin(), seen.end());
  specimen.axis = axis;
  specimen.section_factor = mid_plane_symmetry ? 2.0 : 1.0;
  const auto& nodes = specimen.volume.nodes;
  specimen.held = group(specimen.volume, held, case_place + ".held");
  specimen.loaded = group(specimen.volume, loaded, case_place + ".loaded");

  // Nodes for the supports: the ends of the held edge on the camera's face, and the middle of the loaded one.
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
  const int a = extreme(specimen.held, [&](int n) { return -nodes(n, across); });
  const int b = extreme(specimen.held, [&](int n) { return nodes(n, across); });
  const int c = extreme(specimen.loaded, [&](int n) { return -std::abs(nodes(n, across) - middle); });

  std::set<int> displacement_dofs, force_dofs = {3 * a, 3 * a + 1, 3 * b + axis};
  for (const auto* end : {&specimen.held, &specimen.loaded})
    for (int node : *end) displacement_dofs.insert({3 * node, 3 * node + 1});
  if (mid_plane_symmetry) {
    for (int node : group(specimen.volume, "back", case_place + ".mid_plane_symmetry")) {
      displacement_dofs.insert(3 * node + 2);
      force_dofs.insert(3 * node + 2);
    }
  } else {
    displacement_dofs.insert(3 * a + 2);
    force_dofs.insert({3 * a + 2, 3 * b + 2, 3 * c + 2});
  }
  specimen.displacement_dofs.assign(displacement_dofs.begin(), displacement_dofs.end());
  specimen.force_dofs.assign(force_dofs.begin(), force_dofs.end());
  for (int dof : force_dofs)  // one camera sees every motion in its plane
    if (dof % 3 == 2) specimen.images_dofs.push_back(dof);

  for (Control control : {Control::displacement, Control::force, Control::images}) {
    const auto& dofs = specimen.dofs(control);
    Eigen::Matrix<double, Eigen::Dynamic, 2> points(static_cast<Eigen::Index>(dofs.size()), 2);
    for (std::size_t i = 0; i < dofs.size(); ++i) points.row(static_cast<Eigen::Index>(i)) = nodes.row(dofs[i] / 3).head<2>();
    const auto weights = interpolation(specimen.surface.mesh, points);
    std::vector<Eigen::Triplet<double>> entries;
    for (int column = 0; column < weights.outerSize(); ++column)
      for (Eigen::SparseMatrix<double>::InnerIterator entry(weights, column); entry; ++entry) {
        const int component = dofs[static_cast<std::size_t>(entry.row())] % 3;
        if (component < 2) entries.emplace_back(static_cast<int>(entry.row()), 2 * column + component, entry.value());
      }
    auto& matrix = control == Control::displacement ? specimen.displacement_from_surface
                   : control == Control::force      ? specimen.force_from_surface
                                                    : specimen.images_from_surface;
    matrix.resize(static_cast<Eigen::Index>(dofs.size()), 2 * specimen.surface.mesh.nodes.rows());
    matrix.setFromTriplets(entries.begin(), entries.end());
  }
  return specimen;
}

}  // namespace imic3d::identification
