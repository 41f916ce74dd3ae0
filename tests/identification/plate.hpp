#pragma once
// A small plate whose "images" are linear: grey levels that answer to a displacement u with M (target - u). What a test
// finds with it comes from the mechanics and the algebra of the identification alone.

#include <memory>

#include "imic3d/identification/gauss_newton.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::identification::testing {

/// A tapered strip, 6 x 8 mm, along y, 1 mm thick, half of it through the thickness.
inline mesh::Mesh strip(int columns = 3, int rows = 4) {
  mesh::Mesh quads;
  quads.type = mesh::CellType::quad4;
  quads.nodes.setZero((columns + 1) * (rows + 1), 3);
  quads.cells.resize(columns * rows, 4);
  const auto id = [&](int i, int j) { return j * (columns + 1) + i; };
  for (int j = 0; j <= rows; ++j)
    for (int i = 0; i <= columns; ++i) {
      const double y = 8.0 * j / rows, half_width = 2.0 + 0.0625 * (y - 4.0) * (y - 4.0);
      quads.nodes.row(id(i, j)) << half_width * (2.0 * i / columns - 1.0), y, 0.0;
      if (j == 0) quads.node_groups["bottom"].push_back(id(i, j));
      if (j == rows) quads.node_groups["top"].push_back(id(i, j));
    }
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns; ++i)
      quads.cells.row(j * columns + i) << id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1);
  return quads;
}

struct Plate {
  Specimen specimen = make_specimen(mesh::extrude(strip(), 0.5, 1), "bottom", "top", 1, true);
  std::shared_ptr<const material::FiniteStrainLaw> law =
      material::make_law({.law = "j2", .hardening = "power_linear", .tie_initial_modulus = true, .table_strain = {}});
  std::vector<double> truth = {198e3, 0.25, 284.0, 1480.0, 0.042};
  Record record;
  ImageData images;

  /// The record of a specimen with the true parameters whose top moves by `stretch` [mm] in each frame.
  explicit Plate(const std::vector<double>& stretch, Communicator world = {}) { pull(stretch, world); }
  /// The same with another law.
  Plate(const std::vector<double>& stretch, std::shared_ptr<const material::FiniteStrainLaw> other,
        std::vector<double> values, Communicator world = {}) {
    law = std::move(other), truth = std::move(values);
    pull(stretch, world);
  }
  /// The same with faces as the cameras see them.
  Plate(const std::vector<double>& stretch, Specimen seen) : specimen(std::move(seen)) { pull(stretch, {}); }

 private:
  void pull(const std::vector<double>& stretch, Communicator world) {
    const auto frames = static_cast<Eigen::Index>(stretch.size());
    record.time = Eigen::VectorXd::LinSpaced(frames, 1.0, static_cast<double>(frames));
    record.force.setZero(frames);
    record.surface_displacement.setZero(specimen.projection.rows(), frames);
    for (Eigen::Index t = 0; t < frames; ++t) {
      record.frames.push_back(static_cast<int>(t) + 1);
      for (const Face& face : specimen.faces)
        for (Eigen::Index i = 0; i < face.nodes(); ++i)
          record.surface_displacement(face.first_unknown + face.components * i + 1, t) =
              stretch[static_cast<std::size_t>(t)] * face.surface.mesh.nodes(i, 1) / 8.0;
    }
    record.driving = record.surface_displacement;
    ForwardModel model(world, specimen, law, record, {.with_fields = false}, 1, 1);
    const Path path = model.simulate(Control::displacement, {{.parameters = truth}}, static_cast<int>(frames)).front();
    record.surface_displacement = record.driving = path.surface;
    record.force = path.reaction;

    images.M.resize(path.surface.rows(), path.surface.rows());
    for (Eigen::Index i = 0; i < path.surface.rows(); ++i)
      images.M.insert(i, i) = 4e8 * (1.0 + 0.3 * static_cast<double>(i % 3));
    images.pixels_per_length = 50.0;
    images.evaluate = [this](int t, const Eigen::VectorXd& u, const Communicator&) {
      const Eigen::VectorXd gap = record.surface_displacement.col(t) - u;
      ImageEvaluation seen;
      seen.b = images.M * gap;
      seen.squares = gap.dot(seen.b);
      seen.pixels = 1.0;
      return seen;
    };
  }
};

inline const std::vector<ParameterInfo>& information(const Plate& plate) { return plate.law->parameters(); }

}  // namespace imic3d::identification::testing
