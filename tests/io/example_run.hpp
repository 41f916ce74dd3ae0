#pragma once
// A small made-up run, for the tests of what a run leaves behind.

#include <cmath>
#include <vector>

#include "imic3d/io/run_results.hpp"

namespace imic3d::io {

/// A strip of 4 x 8 squares of 1 mm (x, y), one hexahedron thick.
inline mesh::Mesh example_mesh(bool solid) {
  constexpr int nx = 4, ny = 8;
  const auto node = [](int i, int j, int k) { return k * (nx + 1) * (ny + 1) + j * (nx + 1) + i; };
  mesh::Mesh mesh;
  mesh.type = solid ? mesh::CellType::hex8 : mesh::CellType::quad4;
  const int layers = solid ? 2 : 1;
  mesh.nodes.resize(layers * (nx + 1) * (ny + 1), 3);
  for (int k = 0; k < layers; ++k)
    for (int j = 0; j <= ny; ++j)
      for (int i = 0; i <= nx; ++i) mesh.nodes.row(node(i, j, k)) << i, j, solid ? k - 1 : 0;
  mesh.cells.resize(nx * ny, solid ? 8 : 4);
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      auto cell = mesh.cells.row(j * nx + i);
      for (int k = 0; k < layers; ++k) {
        const int corner = 4 * k;
        cell(corner) = node(i, j, k);
        cell(corner + 1) = node(i + 1, j, k);
        cell(corner + 2) = node(i + 1, j + 1, k);
        cell(corner + 3) = node(i, j + 1, k);
      }
    }
  }
  const int last = node(0, ny, 0);
  mesh.node_groups["bottom"] = {0, 1, 2, 3, 4};
  mesh.node_groups["top"] = {last, last + 1, last + 2, last + 3, last + 4};
  return mesh;
}

/// Writes a run of `frames` frames whose loads, fields and iterations look like those of a tension test.
inline ResultsFile example_run(const std::filesystem::path& folder, int frames = 12) {
  Case test;
  test.file = "case.yaml";
  test.text = "title: Strip <of> steel & copper\nspecimen: {mesh: strip.msh}\n";
  test.title = "Strip <of> steel & copper";
  for (int i = 0; i < frames; ++i) {
    test.frames.push_back(2 * i);
    const double strain = 0.002 * i;
    test.loads.records.push_back({.frame = 2 * i,
                                  .time = static_cast<double>(i),
                                  .force = 4000.0 * std::tanh(300 * strain) + 10.0 * std::sin(12.0 * i),
                                  .image = {},
                                  .line = i + 2});
  }
  test.specimen.held = "bottom";
  test.specimen.loaded = "top";
  test.identify.stages = {{{"E"}, {0, 2, 4}}, {{"S_y"}, {0, 2, 4, 6, 8, 10}}};
  test.identify.held_out = {2 * frames - 2};
  test.material.parameters = {{"E", {180e3, {}, {}}}, {"S_y", {250.0, {}, {}}}, {"nu", {0.3, {}, {}}}};
  const auto volume = example_mesh(true), surface = example_mesh(false);
  RunPlan plan;
  plan.versions = {{"imic3d", "0.1.0"}, {"git_revision", "0000000"}, {"PETSc", "3.18.5"}};
  plan.volume = &volume;
  plan.surface = &surface;
  plan.parameters = {{"E", "MPa", "", 0, 1e7, {}}, {"S_y", "MPa", "", 0, 1e7, {}}, {"nu", "-", "", 0, 0.5, {}}};
  auto file = create_results(folder, test, plan);

  write_noise(file, 2.0);
  const auto cells = static_cast<std::size_t>(volume.cells.rows());
  for (int i = 0; i < frames - 1; ++i) {  // the last frame is missing: as if the run had been killed
    const double strain = 0.002 * i;
    const auto field = [&](const mesh::Mesh& mesh) {
      std::vector<double> u;
      for (Eigen::Index n = 0; n < mesh.nodes.rows(); ++n) {
        u.push_back(-0.3 * strain * mesh.nodes(n, 0));
        u.push_back(strain * mesh.nodes(n, 1));
        u.push_back(-0.3 * strain * mesh.nodes(n, 2));
      }
      return u;
    };
    const auto u = field(volume), v = field(surface);
    const std::vector<double> stress(cells * 6, 300 * strain), scalar(cells, strain);
    std::vector<double> rms(cells);
    for (std::size_t c = 0; c < cells; ++c) rms[c] = 2.0 + 0.05 * static_cast<double>(c) * strain * 50;
    const auto index = static_cast<std::size_t>(i);
    const double force = 4000.0 * std::tanh(290 * strain);
    write_simulation_frame(file, index,
                           {.displacement = u,
                            .cauchy_stress = stress,
                            .von_mises = scalar,
                            .plastic_strain = scalar,
                            .reaction = {0.0, force, 0.0},
                            .force = force});
    write_dic_frame(file, index, v, 2.0 + 0.01 * i, rms);
    write_model_residual(file, index, 2.0 + 0.03 * i, rms);
  }
  write_iteration(file, 0, 0, std::vector<double>{180e3, 250, 0.3}, std::nan(""), 40.0);
  write_iteration(file, 0, 1, std::vector<double>{195e3, 250, 0.3}, 0.08, 11.0);
  write_iteration(file, 0, 2, std::vector<double>{198e3, 250, 0.3}, 0.0005, 9.0);
  write_iteration(file, 1, 0, std::vector<double>{198e3, 250, 0.3}, std::nan(""), 9.0);
  write_iteration(file, 1, 1, std::vector<double>{198e3, 281, 0.3}, 0.12, 1.2);
  write_iteration(file, 1, 2, std::vector<double>{198e3, 284, 0.3}, 0.0009, 1.02);
  const double n = std::nan("");
  write_identified(file, std::vector<double>{198e3, 284, 0.3}, std::vector<double>{4e4, 10, n, 10, 0.25, n, n, n, n});
  return file;
}

}  // namespace imic3d::io
