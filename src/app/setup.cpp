#include "imic3d/app/setup.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "imic3d/core/log.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::app {

namespace {

material::LawChoice choice(const io::MaterialCase& declared, bool plane_stress = false) {
  return {.law = declared.law,
          .hardening = declared.hardening,
          .tie_initial_modulus = declared.tie_initial_modulus,
          .plane_stress = plane_stress,
          .cauchy_yield = declared.yield_stress == "cauchy",
          .effects = declared.effects,
          .table_strain = declared.table_strain};
}

}  // namespace

std::string unit_in(std::string unit, const io::Units& units) {
  const auto replace = [&](const std::string& word, const std::string& by) {
    if (const auto at = unit.find(word); at != std::string::npos) unit.replace(at, word.size(), by);
  };
  replace("stress", io::stress_unit(units));
  replace("time", units.time);
  return unit;
}

int Material::index(const std::string& name) const {
  std::string names;
  for (std::size_t i = 0; i < information.size(); ++i) {
    if (information[i].name == name) return static_cast<int>(i);
    names += (names.empty() ? "" : ", ") + information[i].name;
  }
  throw InputError("identify.stages.free", name, "one of " + names);
}

io::Case read_case(const CommandOptions& options, std::vector<std::string> sections, bool images) {
  return io::read_case(options.case_file,
                       {.parameters_of = [](const io::MaterialCase& m) { return material::make_law(choice(m))->parameters(); },
                        .read_mesh = [](const std::filesystem::path& file) { return mesh::read(file); },
                        .sections = std::move(sections),
                        .images = images});
}

Material make_material(const io::Case& test) {
  Material result;
  result.law = material::make_law(choice(test.material, test.specimen.plane_stress()));
  for (ParameterInfo info : result.law->parameters()) {
    const auto& declared = test.material.parameters.at(info.name);
    if (declared.lower) info.lower = std::max(info.lower, *declared.lower);
    if (declared.upper) info.upper = std::min(info.upper, *declared.upper);
    info.scale = usual_size(info, result.values.empty() ? declared.value : result.values.front());  // E is every law's first
    info.unit = unit_in(info.unit, test.units);
    result.values.push_back(declared.value);
    result.information.push_back(std::move(info));
  }
  return result;
}

identification::Specimen make_specimen(const io::Case& test) {
  const auto& declared = test.specimen;
  mesh::Mesh mesh = mesh::read(declared.mesh);
  for (int i = 0; i < declared.refine; ++i) mesh = mesh::refine(mesh);
  if (declared.plane_stress()) {
    mesh.thickness = declared.thickness;
    for (const auto& key : declared.unused) spdlog::info("specimen.{} says nothing in plane stress", key);
  } else if (mesh.type == mesh::CellType::quad4) {
    const double thickness = declared.mid_plane_symmetry ? 0.5 * declared.thickness : declared.thickness;
    mesh = mesh::extrude(mesh, thickness, declared.layers);
    if (declared.layer_ratio != 1.0) mesh::grade_layers(mesh, declared.layer_ratio, declared.mid_plane_symmetry);
  } else if (mesh.node_groups.contains(declared.front)) {
    mesh::choose_front(mesh, declared.front);
  }
  if (declared.quadratic()) mesh = mesh::quadratic(mesh);
  return identification::make_specimen(std::move(mesh), declared.held, declared.loaded, declared.axis == "x" ? 0 : 1,
                                       declared.mid_plane_symmetry && !declared.plane_stress());
}

std::filesystem::path output_folder(const io::Case& test, const CommandOptions& options, const Communicator& world) {
  const std::filesystem::path folder = options.output.empty() ? test.output : options.output;
  collectively(world, [&] {
    if (!world.is_root()) return;
    std::error_code failed;
    std::filesystem::create_directories(folder, failed);
    if (failed) throw InputError("output", folder.string() + ": " + failed.message(), "a folder that can be written");
  });
  return folder;
}

}  // namespace imic3d::app
