// The case file as a whole, its units, specimen and load record.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

#include "case_reader.hpp"
#include "image_files.hpp"
#include "imic3d/mesh/connectivity.hpp"
#include "units.hpp"

namespace imic3d::io {

Case CaseReader::read() {
  for (auto& mistake : check_schema(document_, case_schema())) mistakes_.push_back(std::move(mistake));
  case_.file = document_.file;
  case_.text = document_.text;
  root_.get("title", case_.title);
  case_.output = folder_ / "results";
  root_.get("output", case_.output);
  if (root_.has("tests")) {
    read_tests();
    return finished();
  }
  const auto needs = [&](const char* section) {
    return std::count(checks_.sections.begin(), checks_.sections.end(), section) > 0;
  };
  const bool on_fields = root_.has("fields"), on_bars = root_.has("experiments") && needs("identify"),
             lacks_mesh = on_curves() && !root_.has("specimen") && needs("specimen");
  if (lacks_mesh)
    mistake("experiments", "bars, which have no mesh",
            "a section specimen for this command; bars are identified (imic3d identify, imic3d loop)");
  for (const auto& section : checks_.sections)
    if (!lacks_mesh && !root_.has(section) && !(on_fields && (section == "cameras" || section == "loads")) &&
        !(on_bars && (section == "cameras" || section == "loads")))
      mistake(section, "not given", "a section " + section);

  read_units();
  read_specimen();
  read_loads_section();
  read_cameras();
  read_fields();
  read_material();
  read_experiments();
  read_dic();
  read_simulate();
  settle_frames();
  read_identify();
  read_loop();
  read_effects();
  read_virtual();
  return finished();
}

Case CaseReader::finished() {
  std::stable_sort(mistakes_.begin(), mistakes_.end(), [](auto& a, auto& b) { return a.line < b.line; });
  for (auto& placed : mistakes_) case_.mistakes.push_back(std::move(placed.mistake));
  const bool cases_follow = checks_.several && !case_.tests.empty();
  if (!case_.mistakes.empty() && !cases_follow) throw InputError(std::move(case_.mistakes));
  return std::move(case_);
}

void CaseReader::read_tests() {
  if (root_.group("loop").has("prior"))
    mistake("loop.prior", "given beside tests", "priors in the cases of the tests, alike in each");
  else
    read_loop();
  for (const auto& [section, value] : root_.json().items())
    if (section != "title" && section != "loop" && section != "output" && section != "tests")
      mistake(section, "given beside tests", "title, loop and output; all else in the cases of the tests");
  if (!checks_.several)
    mistake("tests", "several tests",
            "one test; imic3d identify and loop take several, in a file that none of them lists");
  for (const auto& section : root_.list("tests")) {
    auto& test = case_.tests.emplace_back();
    section.get("name", test.name);
    section.get("case", test.file);
    if (test.name.empty() || test.name == "." || test.name == ".." || test.name.find('/') != std::string::npos)
      mistake(section.path("name"), fmt::format("\"{}\"", test.name), "a name that a folder can have, without /");
    if (section.has("case") && !exists(test.file))
      mistake(section.path("case"), fmt::format("no such file: {}", test.file.string()), "a case file");
    if (std::any_of(case_.tests.begin(), case_.tests.end() - 1,
                    [&](const auto& other) { return other.name == test.name; }))
      mistake(section.path("name"), fmt::format("\"{}\" once more", test.name), "a name for each test");
  }
}

void CaseReader::read_units() {
  const auto section = root_.group("units");
  section.get("length", case_.units.length);
  section.get("force", case_.units.force);
  section.get("time", case_.units.time);
}

void CaseReader::read_specimen() {
  const auto section = root_.group("specimen");
  auto& specimen = case_.specimen;
  section.get("mesh", specimen.mesh);
  section.get("kinematics", specimen.kinematics);
  section.get("thickness", specimen.thickness);
  section.get("layers", specimen.layers);
  section.get("layer_ratio", specimen.layer_ratio);
  section.get("refine", specimen.refine);
  section.get("element", specimen.element);
  section.get("mid_plane_symmetry", specimen.mid_plane_symmetry);
  section.get("held", specimen.held);
  section.get("loaded", specimen.loaded);
  section.get("axis", specimen.axis);
  section.get("front", specimen.front);
  for (const char* key : {"layers", "layer_ratio", "mid_plane_symmetry"})
    if (specimen.plane_stress() && section.has(key)) specimen.unused.emplace_back(key);
  if (specimen.plane_stress() ? specimen.one_point() : specimen.element.starts_with("quad"))
    mistake(section.path("element"), specimen.element + " with kinematics: " + specimen.kinematics,
            specimen.plane_stress() ? "quad4, quad8; hex8r, hex8s with kinematics: 3d"
                                    : "hex8, hex8r, hex8s, hex20; quad4, quad8 with kinematics: plane_stress");
  read_specimen_place(section);
  if (!root_.has("specimen") && !root_.has("experiments"))
    mistake("specimen", "not given", "a section specimen, or experiments");
  if (!section.has("mesh")) return;  // the schema's check has said so
  for (const char* end : {"held", "loaded"})
    if (simulates() && !section.has(end)) mistake(section.path(end), "not given", "the name of a group of the mesh");
  if (simulates() && !specimen.held.empty() && specimen.held == specimen.loaded)
    mistake(section.path("loaded"), specimen.loaded, "another group than held");
  if (!exists(specimen.mesh)) {
    mistake(section.path("mesh"), fmt::format("no such file: {}", specimen.mesh.string()), "a .msh or .inp file");
    return;
  }
  if (checks_.read_mesh) check_mesh(section);
}

void CaseReader::check_mesh(const Section& section) {
  const auto& specimen = case_.specimen;
  mesh::Mesh mesh;
  try {
    mesh = checks_.read_mesh(specimen.mesh);
  } catch (const InputError& error) {
    for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(section.path("mesh")), one});
    return;
  }
  std::vector<std::string> names;
  for (const auto& [name, nodes] : mesh.node_groups) names.push_back(name);
  const auto check_group = [&](const std::string& key, const std::string& name) {
    if (!section.has(key) || mesh.node_groups.contains(name)) return;
    const auto near = nearest(name, names);
    mistake(section.path(key), fmt::format("no group \"{}\"{}", name, near.empty() ? "" : ", near to " + near),
            names.empty() ? "none, the mesh has no groups" : fmt::format("{}", fmt::join(names, ", ")));
  };
  check_group("held", specimen.held);
  check_group("loaded", specimen.loaded);
  check_parts(section, mesh);
  const bool solid = mesh.type == mesh::CellType::hex8;
  if (solid) check_group("front", specimen.front);
  if (!solid && !section.has("thickness") && simulates())
    mistake(section.path("thickness"), "not given", fmt::format("a positive number [{}]", case_.units.length));
  if (solid && specimen.plane_stress())
    mistake(section.path("kinematics"), "plane_stress for a 3D mesh", "a 2D mesh of quadrilaterals");
  if (solid && section.has("thickness"))
    mistake(section.path("thickness"), "given for a 3D mesh", "only with a 2D mesh");
}

/// Shear is meant by few, `axis` is forgotten by many; ends are neither points nor sides.
void CaseReader::doubt_ends(const mesh::Mesh& mesh, const std::vector<int>& held, const std::vector<int>& loaded) {
  const auto middle = [&](const std::vector<int>& nodes) -> Eigen::RowVector3d {
    return mesh.nodes(nodes, Eigen::all).colwise().mean();
  };
  const Eigen::RowVector3d apart = (middle(loaded) - middle(held)).cwiseAbs();
  const int along = case_.specimen.axis == "x" ? 0 : 1;
  const std::string found = along == 0 ? "x" : "y", likely = along == 0 ? "y" : "x";
  for (const auto& [key, nodes] : {std::pair("held", &held), {"loaded", &loaded}}) {
    const Eigen::MatrixX3d at = mesh.nodes(*nodes, Eigen::all);
    const Eigen::RowVector3d extent = at.colwise().maxCoeff() - at.colwise().minCoeff();
    if (mesh.cells.rows() > 0 && !mesh::has_a_facet(mesh, *nodes))
      case_.doubts.push_back(
          fmt::format("specimen.{}: {} nodes, among which no whole side of an element: is a group of points meant?",
                      key, nodes->size()));
    else if (extent[1 - along] < 0.01 * extent[along])
      case_.doubts.push_back(fmt::format(
          "specimen.{}: its nodes lie on a line along {}, the axis of the load: a side, no end", key, found));
  }
  if (apart[along] >= apart[1 - along]) return;
  case_.doubts.push_back(fmt::format(
      "specimen.axis: {0}, but the middle of \"{1}\" lies along {2} from that of \"{3}\": the load shears the "
      "specimen; if it pulls, axis: {2}",
      found, case_.specimen.loaded, likely, case_.specimen.held));
}

void CaseReader::check_parts(const Section& section, const mesh::Mesh& mesh) {
  const auto held = mesh.node_groups.find(case_.specimen.held), loaded = mesh.node_groups.find(case_.specimen.loaded);
  if (!simulates() || held == mesh.node_groups.end() || loaded == mesh.node_groups.end()) return;
  std::vector<char> at_end(static_cast<std::size_t>(mesh.nodes.rows()), 0);
  for (const auto* group : {&held->second, &loaded->second})
    for (const int node : *group) at_end[static_cast<std::size_t>(node)] = 1;
  doubt_ends(mesh, held->second, loaded->second);
  const std::vector<int> parts = mesh::parts_of(mesh);
  std::map<int, std::pair<int, bool>> found;  // elements of a part, whether an end holds it
  for (Eigen::Index cell = 0; cell < mesh.cells.rows(); ++cell) {
    auto& [elements, is_held] = found[parts[static_cast<std::size_t>(cell)]];
    ++elements;
    for (const int node : mesh.cells.row(cell)) is_held = is_held || at_end[static_cast<std::size_t>(node)] != 0;
  }
  for (const auto& [part, what] : found)
    if (!what.second)
      mistake(section.path("mesh"),
              fmt::format("{} of {} elements share no node with the others, nor belong to held or loaded", what.first,
                          mesh.cells.rows()),
              "elements that hang together (nodes at one place are to be merged)");
}

void CaseReader::read_loads_section() {
  if (!root_.has("loads")) return;
  const auto section = root_.group("loads");
  auto& loads = case_.loads;
  section.get("file", loads.file);
  section.get("image", loads.columns.image);
  section.get("time", loads.columns.time);
  section.get("force", loads.columns.force);
  section.get("image_file", loads.columns.image_file);
  section.get("force_scale", loads.force_scale);
  section.get("noise", loads.noise);
  section.get("lag", loads.lag);
  section.get("offset", loads.offset);
  if (std::string unit = case_.units.force; section.has("force_unit")) {
    section.get("force_unit", unit);
    if (section.has("force_scale")) mistake(section.path("force_scale"), "given beside force_unit", "one of the two");
    loads.force_scale = newtons(unit) / newtons(case_.units.force);
  }
  for (const auto& [key, column] : {std::pair("image", loads.columns.image), {"time", loads.columns.time}})
    if (column == loads.columns.force)
      return mistake(section.path("force"), fmt::format("{}, which is {}, too", column, key),
                     "another column for each");
  if (section.has("frame_times") && !read_frame_times(section)) return;
  if (loads.file.empty()) return;
  if (!exists(loads.file)) {
    mistake(section.path("file"), fmt::format("no such file: {}", loads.file.string()), "a table, e.g. a .csv file");
    return;
  }
  try {
    loads.records = recorded_loads();
  } catch (const InputError& error) {
    for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(section.path("file")), one});
  }
  if (section.has("image_file") && !loads.records.empty() &&
      std::all_of(loads.records.begin(), loads.records.end(), [](auto& record) { return record.image.empty(); }))
    mistake(section.path("image_file"), fmt::format("no image in a column \"{}\"", loads.columns.image_file),
            "a column of the load record that names the images");
}

bool CaseReader::read_frame_times(const Section& loads) {
  const auto section = loads.group("frame_times");
  auto& times = case_.loads.frame_times.emplace();
  section.get("start", times.start);
  section.get("interval", times.interval);
  section.get("file", times.file);
  section.get("image", times.columns.image);
  section.get("time", times.columns.time);
  section.get("image_file", times.columns.image_file);
  const bool is_one = section.has("interval") != section.has("file");
  if (!is_one)
    mistake(loads.path("frame_times"), section.has("file") ? "both interval and file" : "neither interval nor file",
            "one of the two");
  if (loads.has("image")) mistake(loads.path("image"), "given beside frame_times", "one of the two");
  return is_one;
}

std::vector<LoadRecord> CaseReader::recorded_loads() const {
  const auto& loads = case_.loads;
  auto columns = loads.columns;
  if (loads.frame_times) columns.image.clear();
  auto records = read_loads(loads.file, columns, loads.force_scale);
  for (auto& record : records) record.force -= loads.offset;
  remove_lag(records, loads.lag);
  if (!loads.frame_times) return records;
  const auto& times = *loads.frame_times;
  std::vector<LoadRecord> frames;
  if (!times.file.empty()) frames = read_loads(times.file, times.columns);
  for (int n = 0; times.interval > 0.0 && n * times.interval <= records.back().time - times.start && n <= largest_frame;
       ++n)
    frames.push_back({.frame = n, .time = n * times.interval, .image = {}});
  for (auto& frame : frames) frame.time += times.start;
  auto taken = at_frames(records, std::move(frames));
  if (taken.empty())
    throw InputError(loads.file.string(),
                     fmt::format("a record from {} to {}", records.front().time, records.back().time),
                     "one that runs while images are taken (frame_times)");
  return taken;
}

std::string CaseReader::range_of(const ParameterInfo& info) {
  const bool below = std::isfinite(info.lower), above = std::isfinite(info.upper);
  const auto range = below && above ? fmt::format(" from {} to {}", info.lower, info.upper)
                     : below        ? fmt::format(" from {}", info.lower)
                     : above        ? fmt::format(" up to {}", info.upper)
                                    : std::string();
  return fmt::format("a number{}{}", range, info.unit.empty() ? "" : " [" + info.unit + "]");
}

void CaseReader::settle_frames() {
  if (case_.fields) {
    case_.frames = case_.fields->frames;
  } else if (!case_.cameras.empty() && !case_.cameras.front().frames.empty()) {
    case_.frames = case_.cameras.front().frames;
  } else if (case_.simulate) {
    for (std::size_t i = 0; i < case_.simulate->value.size(); ++i) case_.frames.push_back(static_cast<int>(i));
  } else {
    for (const auto& record : case_.loads.records) case_.frames.push_back(record.frame);
  }
}

std::vector<fs::path> CaseReader::files_of(const Section& section, const std::string& key) {
  std::vector<std::string> patterns;
  if (std::string one; section.has(key) && section.value(key).is_string())
    section.get(key, one), patterns.push_back(one);
  section.get(key, patterns);
  std::vector<fs::path> all;
  for (const auto& pattern : patterns) {
    const auto files = matching_files(folder_, pattern);
    if (files.empty())
      mistake(section.path(key), fmt::format("no file \"{}\"", pattern),
              (key == "images" ? key : "files") + " that exist");
    all.insert(all.end(), files.begin(), files.end());
  }
  return all;
}

Frames CaseReader::frames_of(const Section& section, const std::string& key, const std::optional<Frames>& available,
                             const std::string& what) {
  const auto& value = section.value(key);
  std::string text;
  if (value.is_string()) text = value;
  if (value.is_number_integer()) text = value.dump();
  if (value.is_array())
    for (const auto& one : value) text += (text.empty() ? "" : ",") + one.dump();
  if (text.empty() && !value.is_string()) return {};  // named by the schema's check
  try {
    const auto ranges = parse_frames(text, what);
    return available && !available->empty() ? select(ranges, *available, what) : expand(ranges);
  } catch (const InputError& error) {
    for (const auto& one : error.mistakes()) mistake(section.path(key), one.found, one.allowed);
    return {};
  }
}

bool CaseReader::simulates() const {
  if (!root_.has("specimen")) return false;
  return root_.has("identify") || root_.has("simulate") || root_.has("virtual");
}

bool CaseReader::exists(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

bool CaseReader::on_curves() const { return root_.has("experiments") && !root_.has("cameras") && !root_.has("fields"); }

bool CaseReader::is_refused(const std::string& path) const {
  const auto inside = [](const std::string& inner, const std::string& outer) {
    return inner.starts_with(outer) &&
           (inner.size() == outer.size() || inner[outer.size()] == '.' || inner[outer.size()] == '[');
  };
  return std::any_of(mistakes_.begin(), mistakes_.end(), [&](const PlacedMistake& one) {
    if (one.path.empty()) return false;
    return inside(path, one.path) || (path.find('.') != std::string::npos && inside(one.path, path) &&
                                      one.path.find_first_of(".[", path.size() + 1) == std::string::npos);
  });
}

void CaseReader::mistake(const std::string& path, std::string found, std::string allowed) {
  if (is_refused(path)) return;
  mistakes_.push_back({document_.line(path), {document_.place(path), std::move(found), std::move(allowed)}});
}

std::string stress_unit(const Units& units) {
  if (units.length == "mm" && units.force == "N") return "MPa";
  if (units.length == "m" && units.force == "N") return "Pa";
  if (units.length == "mm" && units.force == "kN") return "GPa";
  if (units.length == "m" && units.force == "kN") return "kPa";
  return units.force + "/" + units.length + "^2";
}

int Case::index_of(int number) const {
  const auto it = std::lower_bound(frames.begin(), frames.end(), number);
  if (it == frames.end() || *it != number) throw std::out_of_range(fmt::format("no frame {}", number));
  return static_cast<int>(it - frames.begin());
}

const LoadRecord& Case::load(int index) const {
  const int number = frames.at(static_cast<std::size_t>(index));
  for (const auto& record : loads.records)
    if (record.frame == number) return record;
  throw std::out_of_range(fmt::format("no load for frame {}", number));
}

Case read_case(const std::filesystem::path& file, const CaseChecks& checks) {
  return CaseReader(read_yaml(file), checks).read();
}

}  // namespace imic3d::io
