#pragma once
// A strip in tension as a loop::FieldExperiment, its displacement known without noise.

#include <algorithm>

#include "../identification/plate.hpp"
#include "imic3d/loop/field_experiment.hpp"

namespace imic3d::loop::testing {

/// The strip of identification/plate.hpp, measured without noise, with a load cell that reads `offset` without load.
struct Strip {
  FieldData data;
  DeclaredModel model;

  explicit Strip(double offset) {
    const identification::testing::Plate plate({0.002, 0.004, 0.02, 0.05});
    data.faces = {{.surface = plate.specimen.surface.mesh, .M = plate.images.M}};
    data.displacement = data.driving = plate.record.surface_displacement;
    data.smooth = [](Eigen::MatrixXd field) { return field; };
    data.frames = plate.record.frames, data.time = plate.record.time;
    data.force = plate.record.force.array() + offset;
    data.force_noise = 5.0;
    model.law = plate.law, model.information = plate.law->parameters(), model.values = plate.truth;
    model.priors.assign(plate.truth.size(), 0.0), model.free.assign(plate.truth.size(), 0);
    model.free[0] = 1;
    model.specimen = [](const MeshChange& change) {
      mesh::Mesh mesh = mesh::extrude(identification::testing::strip(), 0.5 * change.thickness, 1);
      if (change.section) mesh.section = of_cells(mesh, change.section);
      return identification::make_specimen(std::move(mesh), "bottom", "top", 1, true);
    };
  }

  [[nodiscard]] FieldExperiment experiment() const { return {Communicator{}, data, model, {.modes = 12}}; }
};

inline int place_of(const FieldExperiment& experiment, const std::string& name) {
  for (std::size_t j = 0; j < experiment.parameters().size(); ++j)
    if (experiment.parameters()[j].info.name == name) return static_cast<int>(j);
  return -1;
}

inline bool is_candidate(const FieldExperiment& experiment, const std::string& name) {
  return std::any_of(experiment.candidates().begin(), experiment.candidates().end(),
                     [&](const auto& one) { return one.name == name; });
}

inline std::vector<double> declared(const FieldExperiment& experiment) {
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.value);
  return values;
}

}  // namespace imic3d::loop::testing
