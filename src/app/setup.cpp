#include "imic3d/app/setup.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>

#include "imic3d/core/log.hpp"
#include "imic3d/imaging/compression.hpp"
#include "imic3d/mesh/connectivity.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

/// Young's modulus and the yield stress are declared within this factor of what they are, if units are as they should
/// be.
constexpr double largest_change = 5.0;

/// Layers of elements of half the thickness, where a specimen that is declared in plane stress is simulated in space.
constexpr int layers_in_space = 2;

material::LawChoice choice(const io::MaterialCase& declared, bool plane_stress = false) {
  return {.law = declared.law,
          .hardening = declared.hardening,
          .tie_initial_modulus = declared.tie_initial_modulus,
          .plane_stress = plane_stress,
          .cauchy_yield = declared.yield_stress == "cauchy",
          .effects = declared.effects,
          .table_strain = declared.table_strain};
}

mesh::Mesh read_mesh(const std::filesystem::path& file) {
  mesh::Mesh mesh = mesh::read(file);
  if (const auto pairs = mesh::nodes_at_one_place(mesh); !pairs.empty()) {
    const auto [a, b] = pairs.front();
    spdlog::warn(
        "{}: {} pair{} of nodes at one place, the first at ({:.4g}, {:.4g}, {:.4g}): the mesh is open there, like a "
        "crack, unless they are merged",
        file.string(), pairs.size(), pairs.size() == 1 ? "" : "s", mesh.nodes(a, 0), mesh.nodes(a, 1),
        mesh.nodes(a, 2));
  }
  return mesh;
}

}  // namespace

std::string unit_in(std::string unit, const io::Units& units) {
  const auto replace = [&](const std::string& word, const std::string& by) {
    if (const auto at = unit.find(word); at != std::string::npos) unit.replace(at, word.size(), by);
  };
  const std::string stress = io::stress_unit(units);
  replace("1/stress", stress.find('/') == std::string::npos ? "1/" + stress : units.length + "^2/" + units.force);
  replace("stress", stress);
  replace("time", units.time);
  replace("force", units.force);
  replace("length", units.length);
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

io::Case read_case(const CommandOptions& options, std::vector<std::string> sections, bool images, bool fields,
                   bool several) {
  io::Case test = io::read_case(
      options.case_file,
      {.parameters_of = [](const io::MaterialCase& m) { return material::make_law(choice(m))->parameters(); },
       .read_mesh = read_mesh,
       .effects = effect_quantities,
       .sections = std::move(sections),
       .images = images,
       .fields = fields,
       .several = several});
  for (const auto& camera : test.cameras)
    if (images && !camera.images.empty())
      if (const double excess = imaging::block_excess(imaging::read_image(camera.images.front())); excess > 0.0)
        test.doubts.push_back(
            fmt::format("{}: grey levels change by {:.2g} % more across the borders of blocks of 8 x 8 px, as in "
                        "images that were saved as JPEG: it loses noise and adds patterns, which no effect of the "
                        "light stands for; save images without loss",
                        camera.images.front().string(), 100.0 * excess));
  for (const auto& doubt : test.doubts) spdlog::warn("{}", doubt);
  return test;
}

namespace {

/// Bounds of the case file, units and scales in those of the case; what the case file does not declare at its null
/// value.
ExtendedMaterial material_of(const io::Case& test, const material::LawChoice& chosen) {
  ExtendedMaterial result;
  result.law = material::make_law(chosen);
  for (ParameterInfo info : result.law->parameters()) {
    const auto found = test.material.parameters.find(info.name);
    const bool declared = found != test.material.parameters.end();
    if (declared && found->second.lower) info.lower = std::max(info.lower, *found->second.lower);
    if (declared && found->second.upper) info.upper = std::min(info.upper, *found->second.upper);
    const double value = declared ? found->second.value : info.null_value.value_or(0.0);
    // E is every law's first; of a thousandth of it no simulation tells anything any more.
    if (result.values.empty()) info.lower = std::max(info.lower, 1e-3 * value);
    info.scale = usual_size(info, result.values.empty() ? value : result.values.front());
    info.unit = unit_in(info.unit, test.units);
    result.values.push_back(value);
    result.information.push_back(std::move(info));
    result.declared.push_back(declared ? 1 : 0);
  }
  return result;
}

}  // namespace

Material make_material(const io::Case& test) {
  return material_of(test, choice(test.material, test.specimen.plane_stress()));
}

std::vector<std::string> unlikely_values(const io::Case& test, const Material& material,
                                         const std::vector<double>& values) {
  std::vector<std::string> doubts;
  for (std::size_t j = 0; j < material.values.size(); ++j) {
    const auto& info = material.information[j];
    const auto declared = test.material.parameters.find(info.name);
    if ((info.name != "E" && info.name != "S_y") || declared == test.material.parameters.end())
      continue;  // hardening may be anything
    const double ratio = values[j] / declared->second.value;
    if (ratio < largest_change && ratio > 1.0 / largest_change) continue;
    doubts.push_back(
        fmt::format("{} is {:.4g} {} where {:.4g} was declared: are force, thickness, length and material in the units "
                    "of the case file ({}, {})?",
                    info.name, values[j], info.unit, declared->second.value, test.units.force, test.units.length));
    spdlog::warn("{}", doubts.back());
  }
  return doubts;
}

std::shared_ptr<const material::FiniteStrainLaw> extended_law(const io::Case& test,
                                                              const std::vector<std::string>& effects, bool in_space) {
  material::LawChoice chosen = choice(test.material, test.specimen.plane_stress() && !in_space);
  chosen.effects.insert(chosen.effects.end(), effects.begin(), effects.end());
  return material::make_law(chosen);
}

ExtendedMaterial make_extended_material(const io::Case& test) {
  material::LawChoice chosen = choice(test.material, test.specimen.plane_stress());
  if (chosen.law == "elastic")
    throw InputError("material.law", "elastic",
                     "j2 for imic3d loop: the effects that it knows are those of a plastic law");
  chosen.effects = material::known_effects();
  return material_of(test, chosen);
}

std::vector<int> cameras_of(const io::Case& test, bool back) {
  std::vector<int> found;
  for (std::size_t c = 0; c < test.cameras.size(); ++c)
    if ((test.cameras[c].face == "back") == back) found.push_back(static_cast<int>(c));
  return found;
}

std::vector<identification::SeenFace> seen_faces(const io::Case& test) {
  std::vector<identification::SeenFace> faces;
  for (const bool back : {false, true}) {
    const auto cameras = cameras_of(test, back);
    const bool perspective = std::any_of(cameras.begin(), cameras.end(), [&](int c) {
      return test.cameras[static_cast<std::size_t>(c)].model == "pinhole";
    });
    if (!cameras.empty() || (!back && test.cameras.empty()))
      faces.push_back({.back = back, .components = cameras.size() > 1 && perspective ? 3 : 2});
  }
  if (test.specimen.plane_stress())
    for (const auto& face : faces)
      if (face.back || face.components == 3)
        throw InputError("cameras", face.back ? "a camera at the back" : "cameras that see the motion along z",
                         "kinematics: 3d, or cameras of the front in its plane");
  return faces;
}

identification::Specimen make_specimen(const io::Case& test, bool all_components, const loop::MeshChange& change) {
  const auto& declared = test.specimen;
  auto faces = seen_faces(test);
  for (auto& face : faces)
    if (all_components) face.components = 3;
  mesh::Mesh mesh = mesh::read(declared.mesh);
  if (change.place)
    for (auto node : mesh.nodes.rowwise()) {
      Eigen::Vector2d point = node.head<2>().transpose();
      change.place(point);
      node.head<2>() = point.transpose();
    }
  for (int i = 0; i < declared.refine + change.numerics.refinements; ++i) mesh = mesh::refine(mesh);
  const bool plane_stress = declared.plane_stress() && !change.numerics.in_space,
             half = declared.mid_plane_symmetry || declared.plane_stress();
  if (plane_stress) {
    mesh.thickness = change.thickness * declared.thickness;
    if (!change.place)  // said once
      for (const auto& key : declared.unused) spdlog::info("specimen.{} says nothing in plane stress", key);
  } else if (mesh.type == mesh::CellType::quad4) {
    const int layers = declared.plane_stress() ? layers_in_space : declared.layers;
    mesh = mesh::extrude(mesh, half ? 0.5 * declared.thickness : declared.thickness,
                         layers << change.numerics.refinements);
    if (!declared.plane_stress() && declared.layer_ratio != 1.0)
      mesh::grade_layers(mesh, std::pow(declared.layer_ratio, std::exp2(-change.numerics.refinements)), half);
  } else if (mesh.node_groups.contains(declared.front)) {
    mesh::choose_front(mesh, declared.front);
  }
  if (!plane_stress) mesh.nodes.col(2) *= change.thickness * change.numerics.of_thickness;
  if (declared.quadratic()) mesh = mesh::quadratic(mesh);
  if (declared.one_point())
    mesh.integration =
        declared.element == "hex8r" ? mesh::Integration::one_point : mesh::Integration::one_point_stabilised;
  if (change.section) mesh.section = loop::of_cells(mesh, change.section);
  if (change.initial_strain) {
    mesh.initial_strain = loop::of_cells(mesh, change.initial_strain);
    mesh.initial_axis = declared.axis == "x" ? 0 : 1;
  }
  return identification::make_specimen(std::move(mesh), declared.held, declared.loaded, declared.axis == "x" ? 0 : 1,
                                       half && !plane_stress, "specimen", faces);
}

SimulationTasks simulation_tasks(const io::Case& test) {
  const auto& identify = test.identify;
  if (identify.sensitivities == "direct" || identify.functional == "equilibrium_gap") return {};
  std::size_t most_free = 1;
  for (const auto& stage : identify.stages) most_free = std::max(most_free, stage.free.size());
  return {.side_by_side = static_cast<int>(1 + most_free),
          .before = identify.functional == "displacement_driven" ? 0 : 1};
}

void check_output(const io::Case& test, const CommandOptions& options) {
  const std::filesystem::path folder = options.output.empty() ? test.output : options.output;
  const char* const allowed = "a folder that can be written";
  std::error_code failed;
  if (folder.empty()) throw InputError("output", "an empty name", allowed);
  for (auto above = std::filesystem::absolute(folder, failed).lexically_normal(); !above.empty();
       above = above.parent_path()) {
    if (!std::filesystem::exists(above, failed)) {
      if (above == above.parent_path()) break;
      continue;
    }
    if (!std::filesystem::is_directory(above, failed))
      throw InputError("output", fmt::format("{}: {} is no folder", folder.string(), above.string()), allowed);
    if (access(above.c_str(), W_OK) != 0)
      throw InputError("output", fmt::format("{}: {} cannot be written", folder.string(), above.string()), allowed);
    break;
  }
  for (const char* name : {"result.json", "results.h5", "report.html", "log.txt", "checkpoint.h5"})
    if (std::filesystem::is_directory(folder / name, failed))
      throw InputError("output", (folder / name).string() + ", a folder", allowed);
}

std::filesystem::path output_folder(const io::Case& test, const CommandOptions& options, const Communicator& world) {
  const std::filesystem::path folder = options.output.empty() ? test.output : options.output;
  collectively(world, [&] {
    if (!world.is_root()) return;
    check_output(test, options);
    std::error_code failed;
    std::filesystem::create_directories(folder, failed);
    if (failed) throw InputError("output", folder.string() + ": " + failed.message(), "a folder that can be written");
    begin_log_file(folder / "log.txt", options.resume);
  });
  return folder;
}

}  // namespace imic3d::app
