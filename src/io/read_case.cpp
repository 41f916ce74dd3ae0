#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>

#include "image_files.hpp"
#include "imic3d/io/case.hpp"
#include "schema.hpp"
#include "yaml_document.hpp"

namespace imic3d::io {

namespace {

using Json = nlohmann::json;
namespace fs = std::filesystem;

constexpr std::size_t most_image_mistakes = 10;

/// One group of the case file. A key that is absent, or of another type than the target, leaves the target as it is:
/// the schema's check has named such a mistake already.
class Section {
 public:
  Section(const Json& value, std::string path, fs::path folder)
      : value_(value.is_object() ? value : Json::object()), path_(std::move(path)), folder_(std::move(folder)) {}

  [[nodiscard]] bool has(const std::string& key) const { return value_.contains(key); }
  [[nodiscard]] std::string path(const std::string& key) const { return member(path_, key); }
  [[nodiscard]] const Json& value(const std::string& key) const { return value_.at(key); }
  [[nodiscard]] Section group(const std::string& key) const {
    return {value_.value(key, Json::object()), path(key), folder_};
  }
  [[nodiscard]] std::vector<Section> list(const std::string& key) const {
    std::vector<Section> sections;
    if (has(key) && value_[key].is_array())
      for (std::size_t i = 0; i < value_[key].size(); ++i)
        sections.emplace_back(value_[key][i], item(path(key), i), folder_);
    return sections;
  }
  [[nodiscard]] const std::string& path() const { return path_; }
  [[nodiscard]] const Json& json() const { return value_; }

  template <class T>
  void get(const std::string& key, T& target) const {
    if (has(key)) take(value_[key], target);
  }
  template <class T>
  void get(const std::string& key, std::optional<T>& target) const {
    T value{};
    if (has(key) && take(value_[key], value)) target = value;
  }

 private:
  static bool take(const Json& value, double& target) { return value.is_number() && assign(value, target); }
  static bool take(const Json& value, int& target) { return value.is_number_integer() && assign(value, target); }
  static bool take(const Json& value, unsigned& target) { return value.is_number_integer() && assign(value, target); }
  static bool take(const Json& value, bool& target) { return value.is_boolean() && assign(value, target); }
  static bool take(const Json& value, std::string& target) { return value.is_string() && assign(value, target); }
  bool take(const Json& value, fs::path& target) const {
    if (!value.is_string()) return false;
    target = (folder_ / value.get<std::string>()).lexically_normal();
    return true;
  }
  template <class T>
  bool take(const Json& value, std::vector<T>& target) const {
    if (!value.is_array()) return false;
    target.clear();
    for (const auto& element : value)
      if (T one{}; take(element, one)) target.push_back(one);
    return true;
  }
  template <class T, std::size_t n>
  bool take(const Json& value, std::array<T, n>& target) const {
    if (!value.is_array() || value.size() != n) return false;
    for (std::size_t i = 0; i < n; ++i) take(value[i], target[i]);
    return true;
  }
  template <class T>
  static bool assign(const Json& value, T& target) {
    target = value.get<T>();
    return true;
  }

  Json value_;
  std::string path_;
  fs::path folder_;
};

double newtons(const std::string& unit) {
  static const std::map<std::string, double> values{
      {"N", 1.0}, {"kN", 1e3}, {"MN", 1e6}, {"lbf", 4.4482216152605}, {"kip", 4448.2216152605}};
  const auto it = values.find(unit);
  return it == values.end() ? 1.0 : it->second;
}

double pascals(const std::string& unit) {
  static const std::map<std::string, double> values{{"Pa", 1.0}, {"kPa", 1e3}, {"MPa", 1e6}, {"GPa", 1e9}, {"psi", 6894.757293168}, {"ksi", 6894757.293168}};
  const auto it = values.find(unit);
  return it == values.end() ? 1.0 : it->second;
}

/// Turns a document into a Case and collects everything that is wrong with it.
class CaseReader {
 public:
  CaseReader(YamlDocument document, const CaseChecks& checks)
      : document_(std::move(document)),
        checks_(checks),
        mistakes_(document_.mistakes),
        folder_(document_.file.parent_path()),
        root_(document_.root, "", folder_) {}

  Case read() {
    for (auto& mistake : check_schema(document_, case_schema())) mistakes_.push_back(std::move(mistake));
    case_.file = document_.file;
    case_.text = document_.text;
    root_.get("title", case_.title);
    case_.output = folder_ / "results";
    root_.get("output", case_.output);
    const bool on_curves = root_.has("experiments") && std::count(checks_.sections.begin(), checks_.sections.end(), "identify") > 0;
    for (const auto& section : checks_.sections)
      if (!root_.has(section) && !(on_curves && (section == "cameras" || section == "loads"))) mistake(section, "not given", "a section " + section);

    read_units();
    read_specimen();
    read_loads_section();
    read_cameras();
    read_material();
    read_experiments();
    read_dic();
    read_simulate();
    settle_frames();
    read_identify();
    read_loop();
    read_effects();
    read_virtual();

    if (!mistakes_.empty()) {
      std::stable_sort(mistakes_.begin(), mistakes_.end(), [](auto& a, auto& b) { return a.line < b.line; });
      std::vector<Mistake> plain;
      for (auto& placed : mistakes_) plain.push_back(std::move(placed.mistake));
      throw InputError(std::move(plain));
    }
    return std::move(case_);
  }

 private:
  void read_units() {
    const auto section = root_.group("units");
    section.get("length", case_.units.length);
    section.get("force", case_.units.force);
    section.get("time", case_.units.time);
  }

  void read_specimen() {
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
              specimen.plane_stress() ? "quad4, quad8; hex8r, hex8s with kinematics: 3d" : "hex8, hex8r, hex8s, hex20; quad4, quad8 with kinematics: plane_stress");
    read_specimen_place(section);
    if (!root_.has("specimen") && !root_.has("experiments")) mistake("specimen", "not given", "a section specimen, or experiments");
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

  void read_specimen_place(const Section& specimen_section) {
    if (!specimen_section.has("place")) return;
    const auto section = specimen_section.group("place");
    auto& place = case_.specimen.place.emplace();
    section.get("camera", place.camera);
    section.get("points", place.points);
    section.get("deviation", place.deviation);
    section.get("refine_cameras", place.refine_cameras);
    section.get("shape", place.shape);
  }

  /// Pinhole cameras have a calibration, and the specimen a place in front of them.
  void check_pinholes() {
    std::string names, face;
    bool found = false;
    const auto sections = root_.list("cameras");
    for (std::size_t i = 0; i < case_.cameras.size(); ++i) {
      const auto& camera = case_.cameras[i];
      if (camera.model != "pinhole") {
        for (const char* key : {"calibration", "index", "view", "frame"})
          if (sections[i].has(key)) mistake(sections[i].path(key), "given for a telecentric camera", "only with model: pinhole");
        continue;
      }
      for (const char* key : {"place", "pixel_size"})
        if (sections[i].has(key)) mistake(sections[i].path(key), "given for a pinhole camera", "only with model: telecentric (specimen.place places the specimen)");
      if (camera.view && camera.images.empty()) continue;  // of a virtual test: it needs nothing else
      if (camera.calibration.empty())
        mistake(sections[i].path("calibration"), "not given", "a calibration file (VIC-3D, DICe, MatchID, OpenCV)");
      else if (!exists(camera.calibration))
        mistake(sections[i].path("calibration"), fmt::format("no such file: {}", camera.calibration.string()), "a calibration file");
      if (camera.frame == "specimen") continue;
      names += (names.empty() ? "" : ", ") + camera.name;
      if (!face.empty() && camera.face != face)
        mistake(sections[i].path("face"), camera.face, "the face of the other pinhole cameras, " + face + ": specimen.place places one rig (or frame: specimen)");
      face = camera.face;
      found = found || !case_.specimen.place || case_.specimen.place->camera.empty() || case_.specimen.place->camera == camera.name;
    }
    if (names.empty()) {
      if (case_.specimen.place) mistake("specimen.place", "given without a pinhole camera", "only with cameras of model: pinhole that have a calibration in the rig's frame");
      return;
    }
    if (!case_.specimen.place) mistake("specimen.place", "not given", "{points: …}: where the specimen lies in front of the pinhole cameras");
    if (!found) mistake("specimen.place.camera", case_.specimen.place->camera, "one of " + names);
  }

  void check_mesh(const Section& section) {
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
    const bool solid = mesh.type == mesh::CellType::hex8;
    if (solid) check_group("front", specimen.front);
    if (!solid && !section.has("thickness") && simulates())
      mistake(section.path("thickness"), "not given", fmt::format("a positive number [{}]", case_.units.length));
    if (solid && specimen.plane_stress())
      mistake(section.path("kinematics"), "plane_stress for a 3D mesh", "a 2D mesh of quadrilaterals");
    if (solid && section.has("thickness"))
      mistake(section.path("thickness"), "given for a 3D mesh", "only with a 2D mesh");
  }

  void read_loads_section() {
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
    if (loads.file.empty()) return;
    if (!exists(loads.file)) {
      mistake(section.path("file"), fmt::format("no such file: {}", loads.file.string()), "a .csv file");
      return;
    }
    try {
      loads.records = read_loads(loads.file, loads.columns, loads.force_scale);
      for (auto& record : loads.records) record.force -= loads.offset;
      remove_lag(loads.records, loads.lag);
    } catch (const InputError& error) {
      for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(section.path("file")), one});
    }
    if (section.has("image_file") && !loads.records.empty() &&
        std::all_of(loads.records.begin(), loads.records.end(), [](auto& record) { return record.image.empty(); }))
      mistake(section.path("image_file"), fmt::format("no image in a column \"{}\"", loads.columns.image_file),
              "a column of the load record that names the images");
  }

  void read_cameras() {
    for (const auto& section : root_.list("cameras")) {
      auto& camera = case_.cameras.emplace_back();
      section.get("name", camera.name);
      section.get("model", camera.model);
      section.get("face", camera.face);
      section.get("frame", camera.frame);
      if (std::array<int, 2> size{}; section.has("size")) {
        section.get("size", size);
        camera.size = size;
      }
      if (section.has("view")) {
        const auto declared = section.group("view");
        auto& view = camera.view.emplace();
        declared.get("focal", view.focal);
        declared.get("from", view.from);
        declared.get("at", view.at);
        declared.get("roll", view.roll);
        declared.get("distortion", view.distortion);
      }
      const auto deviations = section.group("calibration_sd");
      for (const auto& [number, value] : deviations.json().items())
        if (value.is_number()) camera.calibration_sd[number] = value;
      section.get("calibration", camera.calibration);
      int before = 0;  // cameras of the same file
      for (const auto& other : case_.cameras) before += !camera.calibration.empty() && other.calibration == camera.calibration;
      camera.index = std::max(0, before - 1);
      section.get("index", camera.index);
      section.get("pixel_size", camera.pixel_size);
      section.get("noise", camera.noise);
      read_images(section, camera);
      if (camera.model != "pinhole") read_place(section, camera);
      if (!camera.frames.empty()) {
        camera.reference = {camera.frames.front()};
        if (section.has("reference")) camera.reference = frames_of(section, "reference", camera.frames);
        if (checks_.images) check_images(section, camera);
      }
    }
    std::set<std::string> names;
    for (std::size_t i = 0; i < case_.cameras.size(); ++i) {
      const auto& camera = case_.cameras[i];
      if (!names.insert(camera.name).second)
        mistake(item("cameras", i) + ".name", camera.name, "a name that no other camera has");
      if (i > 0 && camera.frames != case_.cameras.front().frames)
        mistake(item("cameras", i) + ".images", "frames " + to_text(camera.frames),
                "those of the first camera: " + to_text(case_.cameras.front().frames));
    }
    check_pinholes();
  }

  void read_place(const Section& camera_section, CameraCase& camera) {
    const auto section = camera_section.group("place");
    auto& place = camera.place;
    section.get("auto", place.automatic);
    section.get("points", place.points);
    section.get("origin", place.origin);
    section.get("rotation", place.rotation);
    section.get("flip", place.flip);
    const int ways = section.has("auto") + section.has("points") + section.has("origin");
    if (ways > 1) mistake(section.path(), "several ways to place the mesh", "one of auto, points, origin");
    if (ways == 0 && !camera.images.empty())
      mistake(section.path(), camera_section.has("place") ? "no way to place the mesh" : "not given",
              "one of auto, points, origin");
    if (!section.has("points") && !camera_section.has("pixel_size"))
      mistake(camera_section.path("pixel_size"), "not given",
              fmt::format("a positive number [{}/px], or place.points", case_.units.length));
  }

  void read_images(const Section& section, CameraCase& camera) {
    if (!section.has("images")) return;
    const auto& value = section.value("images");
    std::vector<std::string> patterns;
    if (value.is_string()) patterns.push_back(value);
    if (value.is_array()) section.get("images", patterns);
    if (value == "from_loads") {
      take_images_from_loads(section, camera);
      return;
    }
    for (const auto& pattern : patterns) {
      const auto files = matching_files(folder_, pattern);
      if (files.empty()) mistake(section.path("images"), fmt::format("no file \"{}\"", pattern), "images that exist");
      camera.images.insert(camera.images.end(), files.begin(), files.end());
    }
    number_images(section, camera);
  }

  void take_images_from_loads(const Section& section, CameraCase& camera) {
    if (!root_.has("loads")) mistake(section.path("images"), "from_loads without loads", "a section loads");
    for (const auto& record : case_.loads.records) {
      if (record.image.empty()) continue;
      camera.images.push_back(record.image);
      camera.frames.push_back(record.frame);
    }
    if (camera.images.empty() && !case_.loads.records.empty())
      mistake(section.path("images"), "from_loads, where the load record names no image",
              fmt::format("a column \"{}\" with the files (loads.image_file)", case_.loads.columns.image_file));
    if (section.has("frames"))
      mistake(section.path("frames"), "given beside images: from_loads", "none, the load record numbers the images");
  }

  void number_images(const Section& section, CameraCase& camera) {
    const auto n = camera.images.size();
    std::string way = section.has("frames") ? "listed" : "sequence";
    section.get("frames", way);
    if (way == "from_names") {
      camera.frames = frames_in_names(section, camera.images);
    } else if (way != "sequence") {
      camera.frames = frames_of(section, "frames", std::nullopt);
      if (!camera.frames.empty() && camera.frames.size() != n)
        mistake(section.path("frames"), fmt::format("{} frames", camera.frames.size()),
                fmt::format("{}, one for each image", n));
    }
    if (camera.frames.size() == n) return;
    camera.frames.clear();
    for (std::size_t i = 0; i < n; ++i) camera.frames.push_back(static_cast<int>(i));
  }

  Frames frames_in_names(const Section& section, const std::vector<fs::path>& images) {
    Frames frames;
    for (const auto& image : images) {
      const auto number = number_in_name(image);
      if (!number || (!frames.empty() && *number <= frames.back())) {
        mistake(section.path("frames"), fmt::format("from_names, with the image {}", image.filename().string()),
                "names whose last number ascends from image to image");
        return {};
      }
      frames.push_back(*number);
    }
    return frames;
  }

  /// All images are of the first one's size and depth, and every one has a row of loads.
  void check_images(const Section& section, const CameraCase& camera) {
    const int line = document_.line(section.path("images"));
    std::vector<Mistake> found;
    std::optional<ImageHeader> first;
    fs::path first_file;
    for (const auto& image : camera.images) {
      try {
        const auto header = read_image_header(image);
        const auto place = image.string();
        if (header.depth != 8 && header.depth != 16)
          found.push_back({place, fmt::format("{} bits", header.depth), "8 or 16 bits"});
        if (!first) {
          first = header;
          first_file = image;
        }
        const auto as_first = " as in " + first_file.string();
        if (header.columns != first->columns || header.rows != first->rows)
          found.push_back({place, fmt::format("{} x {} px", header.columns, header.rows),
                           fmt::format("{} x {} px{}", first->columns, first->rows, as_first)});
        if (header.depth != first->depth)
          found.push_back(
              {place, fmt::format("{} bits", header.depth), fmt::format("{} bits{}", first->depth, as_first)});
      } catch (const InputError& error) {
        found.insert(found.end(), error.mistakes().begin(), error.mistakes().end());
      }
    }
    check_number_of_images(section, camera);
    if (!case_.loads.records.empty()) {
      std::set<int> recorded;
      for (const auto& record : case_.loads.records) recorded.insert(record.frame);
      for (std::size_t i = 0; i < camera.frames.size() && i < camera.images.size(); ++i)
        if (!recorded.contains(camera.frames[i]))
          found.push_back({case_.loads.file.string(),
                           fmt::format("no row for frame {} ({})", camera.frames[i], camera.images[i].string()),
                           "a row for each image"});
    }
    if (found.size() > most_image_mistakes) {
      const auto more = found.size() - most_image_mistakes;
      found.resize(most_image_mistakes);
      found.push_back({section.path("images"), fmt::format("{} more mistakes of this kind", more), ""});
    }
    for (auto& one : found) mistakes_.push_back({line, std::move(one)});
  }

  /// Images that are merely counted must be as many as the rows: a file that is missing would shift all that follow.
  void check_number_of_images(const Section& section, const CameraCase& camera) {
    const auto images = camera.images.size(), rows = case_.loads.records.size();
    if (section.has("frames") || section.value("images") == "from_loads" || images >= rows) return;
    mistake(section.path("images"), fmt::format("{} images", images),
            fmt::format("{}, one for each row of {}; else say which they are: frames: from_names, or a list", rows,
                        case_.loads.file.string()));
  }

  void read_material() {
    if (!root_.has("material")) return;
    const auto section = root_.group("material");
    auto& material = case_.material;
    section.get("law", material.law);
    section.get("hardening", material.hardening);
    section.get("tie_initial_modulus", material.tie_initial_modulus);
    section.get("yield_stress", material.yield_stress);
    section.get("table_strain", material.table_strain);
    section.get("effects", material.effects);
    const auto parameters = section.group("parameters");
    for (const auto& [name, value] : parameters.json().items()) {
      ParameterCase parameter;
      if (value.is_number()) parameter.value = value;
      if (value.is_object()) {
        const auto details = parameters.group(name);
        details.get("value", parameter.value);
        details.get("lower", parameter.lower);
        details.get("upper", parameter.upper);
      }
      material.parameters[name] = parameter;
    }
    check_table(section);
    if (checks_.parameters_of) check_parameters(parameters);
    for (const auto& [name, parameter] : material.parameters) check_bounds(parameters.path(name), parameter);
  }

  void check_table(const Section& section) {
    const auto& strain = case_.material.table_strain;
    const bool tabulated = case_.material.hardening == "table";
    if (tabulated != section.has("table_strain")) {
      mistake(section.path("table_strain"), tabulated ? "not given" : "given without hardening: table",
              tabulated ? "a list of ascending plastic strains, from 0" : "only with hardening: table");
    } else if (tabulated && !strain.empty() &&
               (strain.front() != 0.0 ||
                std::adjacent_find(strain.begin(), strain.end(), std::greater_equal<>()) != strain.end())) {
      mistake(section.path("table_strain"), fmt::format("{}", fmt::join(strain, ", ")),
              "a list of ascending plastic strains, from 0");
    }
  }

  void check_parameters(const Section& section) {
    std::vector<ParameterInfo> infos;
    try {
      infos = checks_.parameters_of(case_.material);
    } catch (const InputError& error) {
      for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line("material"), one});
      return;
    }
    std::vector<std::string> names;
    for (const auto& info : infos) names.push_back(info.name);
    for (const auto& info : infos) {
      const auto found = case_.material.parameters.find(info.name);
      if (found == case_.material.parameters.end() && info.null_value) {
        case_.material.parameters[info.name].value = *info.null_value;
      } else if (found == case_.material.parameters.end()) {
        mistake(section.path(info.name), "not given", range_of(info));
      } else if (found->second.value < info.lower || found->second.value > info.upper) {
        mistake(section.path(info.name), fmt::format("{}", found->second.value), range_of(info));
      }
    }
    for (const auto& [name, parameter] : case_.material.parameters) {
      if (std::find(names.begin(), names.end(), name) != names.end()) continue;
      const auto near = nearest(name, names);
      mistake(section.path(name),
              near.empty() ? "not a parameter of this material" : "not a parameter of this material, near to " + near,
              fmt::format("{}", fmt::join(names, ", ")));
    }
  }

  static std::string range_of(const ParameterInfo& info) {
    const bool below = std::isfinite(info.lower), above = std::isfinite(info.upper);
    const auto range = below && above ? fmt::format(" from {} to {}", info.lower, info.upper)
                       : below        ? fmt::format(" from {}", info.lower)
                       : above        ? fmt::format(" up to {}", info.upper)
                                      : std::string();
    return fmt::format("a number{}{}", range, info.unit.empty() ? "" : " [" + info.unit + "]");
  }

  void check_bounds(const std::string& path, const ParameterCase& parameter) {
    if (parameter.lower && parameter.upper && !(*parameter.lower < *parameter.upper)) {
      mistake(path, fmt::format("lower {}, upper {}", *parameter.lower, *parameter.upper), "lower below upper");
    } else if ((parameter.lower && parameter.value < *parameter.lower) ||
               (parameter.upper && parameter.value > *parameter.upper)) {
      mistake(path, fmt::format("value {}", parameter.value),
              fmt::format("a value between its bounds{}{}",
                          parameter.lower ? fmt::format(", from {}", *parameter.lower) : "",
                          parameter.upper ? fmt::format(", up to {}", *parameter.upper) : ""));
    }
  }

  void read_experiments() {
    for (const auto& section : root_.list("experiments")) {
      auto& experiment = case_.experiments.emplace_back();
      section.get("name", experiment.name);
      section.get("strain", experiment.columns.strain);
      section.get("stress", experiment.columns.stress);
      section.get("time", experiment.columns.time);
      section.get("strain_scale", experiment.strain_scale);
      section.get("noise", experiment.noise);
      section.get("rate", experiment.rate);
      section.get("direction", experiment.direction);
      section.get("from", experiment.from);
      section.get("monotonic", experiment.monotonic);
      section.get("held_out", experiment.held_out);
      std::string strain_kind = "engineering", stress_kind = strain_kind, until = "end", unit = stress_unit(case_.units);
      section.get("strain_kind", strain_kind);
      section.get("stress_kind", stress_kind);
      section.get("until", until);
      section.get("stress_unit", unit);
      experiment.engineering_strain = strain_kind == "engineering";
      experiment.engineering_stress = stress_kind == "engineering";
      experiment.until_maximum = until == "maximum_force";
      experiment.stress_scale = pascals(unit) / pascals(stress_unit(case_.units));
      if (!experiment.columns.time.empty() && experiment.rate) mistake(section.path("rate"), "given beside time", "one of the two");
      if (!experiment.name.empty() && std::any_of(case_.experiments.begin(), case_.experiments.end() - 1, [&](const auto& other) { return other.name == experiment.name; }))
        mistake(section.path("name"), experiment.name, "a name that no other experiment has");
      read_curves(section, experiment);
      if (section.has("held_out") && section.value("held_out").is_string()) {
        Frames rows;
        Eigen::Index longest = 0;
        for (const auto& table : experiment.tables) longest = std::max(longest, table.strain.size());
        for (int row = 0; row < longest; ++row) rows.push_back(row);
        experiment.held_out_rows = frames_of(section, "held_out", rows);
      }
    }
  }

  void read_curves(const Section& section, ExperimentCase& experiment) {
    if (!section.has("file")) return;
    const auto& value = section.value("file");
    std::vector<std::string> patterns;
    if (value.is_string()) patterns.push_back(value);
    if (value.is_array()) section.get("file", patterns);
    for (const auto& pattern : patterns) {
      const auto files = matching_files(folder_, pattern);
      if (files.empty()) mistake(section.path("file"), fmt::format("no file \"{}\"", pattern), "files that exist");
      for (const auto& file : files) {
        if (std::find(experiment.files.begin(), experiment.files.end(), file) != experiment.files.end()) continue;
        try {
          experiment.tables.push_back(read_curve(file, experiment.columns));
          experiment.files.push_back(file);
        } catch (const InputError& error) {
          for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(section.path("file")), one});
        }
      }
    }
  }

  void read_dic() {
    const auto section = root_.group("dic");
    auto& dic = case_.dic;
    section.get("regularisation", dic.regularisation);
    section.get("pyramid_levels", dic.pyramid_levels);
    section.get("max_iterations", dic.max_iterations);
    section.get("tolerance", dic.tolerance);
    section.get("low_pass", dic.low_pass);
    section.get("border", dic.border);
    section.get("brightness", dic.brightness);
    section.get("local_brightness", dic.local_brightness);
    section.get("groups", dic.groups);
  }

  void read_simulate() {
    if (!root_.has("simulate")) return;
    const auto section = root_.group("simulate");
    auto& simulate = case_.simulate.emplace();
    section.get("control", simulate.control);
    if (case_.specimen.element == "hex8r") mistake("specimen.element", "hex8r in a simulation without images", "hex8, hex8s, hex20");
    section.get("value", simulate.value);
    section.get("clamped", simulate.clamped);
    section.get("centred", simulate.centred);
    section.get("steps_per_frame", simulate.steps_per_frame);
    for (std::size_t i = 0; i < simulate.value.size(); ++i) simulate.time.push_back(static_cast<double>(i));
    section.get("time", simulate.time);
    if (simulate.time.size() != simulate.value.size())
      mistake(section.path("time"), fmt::format("a list of {}", simulate.time.size()),
              fmt::format("a list of {}, as many as value", simulate.value.size()));
    if (std::adjacent_find(simulate.time.begin(), simulate.time.end(), std::greater_equal<>()) != simulate.time.end())
      mistake(section.path("time"), "times that do not ascend", "ascending times");
    if (!simulate.value.empty() && simulate.value.front() != 0.0)
      mistake(section.path("value"), fmt::format("{} at frame 0", simulate.value.front()),
              "0 at frame 0, the reference");
  }

  void settle_frames() {
    if (!case_.cameras.empty() && !case_.cameras.front().frames.empty()) {
      case_.frames = case_.cameras.front().frames;
    } else if (case_.simulate) {
      for (std::size_t i = 0; i < case_.simulate->value.size(); ++i) case_.frames.push_back(static_cast<int>(i));
    } else {
      for (const auto& record : case_.loads.records) case_.frames.push_back(record.frame);
    }
  }

  void read_identify() {
    if (!root_.has("identify")) return;
    const auto section = root_.group("identify");
    auto& identify = case_.identify;
    section.get("functional", identify.functional);
    section.get("alpha", identify.alpha);
    const bool gap = identify.functional == "equilibrium_gap";
    if (identify.alpha > 0.0 && identify.functional != "force_driven" && !gap)
      mistake(section.path("alpha"), fmt::format("{} with functional: {}", identify.alpha, identify.functional),
              "functional: force_driven or equilibrium_gap, or alpha: 0");
    if (gap && identify.alpha == 0.0) mistake(section.path("alpha"), "not given, or 0, with functional: equilibrium_gap", "above 0, e.g. 1e-3");
    if (case_.specimen.element == "hex8r" && identify.alpha == 0.0)
      mistake(section.path("alpha"), "not given, or 0, with specimen.element: hex8r", "above 0, e.g. 1e-2, or element: hex8s");
    if (gap && !case_.specimen.plane_stress())
      mistake(section.path("functional"), "equilibrium_gap in 3D", "specimen.kinematics: plane_stress");
    if (gap && case_.material.law != "elastic") mistake(section.path("functional"), "equilibrium_gap with law: " + case_.material.law, "law: elastic");
    // Hourglass modes that weak images hold alone have no good derivatives, and those of hex8s none.
    if (case_.specimen.element == "hex8r" || case_.specimen.element == "hex8s") identify.sensitivities = "perturbed";
    section.get("sensitivities", identify.sensitivities);
    if (case_.specimen.element == "hex8s" && identify.sensitivities == "direct")
      mistake(section.path("sensitivities"), "direct with specimen.element: hex8s", "perturbed, or element: hex8, hex20");
    section.get("eta", identify.eta);
    section.get("max_iterations", identify.max_iterations);
    section.get("noise_draws", identify.noise_draws);
    section.get("boundary_smoothing", identify.boundary_smoothing);
    if (std::string driving; section.has("driving")) {
      section.get("driving", driving);
      identify.driving = (folder_ / driving).lexically_normal();
      if (!std::filesystem::exists(identify.driving)) mistake(section.path("driving"), identify.driving.string(), "results.h5 of `imic3d dic`");
    }
    section.get("groups", identify.groups);
    section.get("steps_per_frame", identify.steps_per_frame);
    if (section.has("held_out")) identify.held_out = frames_of(section, "held_out", case_.frames);
    const auto is_held_out = [&](int frame) {
      return std::binary_search(identify.held_out.begin(), identify.held_out.end(), frame);
    };
    std::vector<std::string> declared;
    for (const auto& [name, parameter] : case_.material.parameters) declared.push_back(name);
    for (const auto& stage_section : section.list("stages")) {
      auto& stage = identify.stages.emplace_back();
      stage_section.get("free", stage.free);
      for (std::size_t i = 0; i < stage.free.size(); ++i) {
        const auto path = item(stage_section.path("free"), i);
        if (!case_.material.parameters.contains(stage.free[i])) {
          const auto near = nearest(stage.free[i], declared);
          mistake(path, fmt::format("no parameter \"{}\"{}", stage.free[i], near.empty() ? "" : ", near to " + near),
                  fmt::format("{}", fmt::join(declared, ", ")));
        } else if (std::count(stage.free.begin(), stage.free.begin() + static_cast<std::ptrdiff_t>(i), stage.free[i]) >
                   0) {
          mistake(path, fmt::format("\"{}\" twice", stage.free[i]), "each parameter once");
        }
      }
      stage.frames = case_.frames;
      if (stage_section.has("frames")) stage.frames = frames_of(stage_section, "frames", case_.frames);
      const bool any = !stage.frames.empty();
      std::erase_if(stage.frames, is_held_out);
      if (any && stage.frames.empty())
        mistake(stage_section.path("frames"), "only frames that are held out", "at least one frame to fit");
    }
  }

  void read_loop() {
    if (!root_.has("loop")) return;
    const auto section = root_.group("loop");
    auto& loop = case_.loop;
    section.get("draws", loop.draws);
    section.get("modes", loop.modes);
    section.get("additions", loop.additions);
    section.get("rivals", loop.rivals);
    section.get("starts", loop.starts);
    const auto prior = section.group("prior");
    for (const auto& [name, deviation] : prior.json().items()) {
      if (!case_.material.parameters.contains(name)) mistake(prior.path(name), "no parameter of this name", "a parameter of the material");
      if (deviation.is_number()) loop.prior[name] = deviation;
    }
  }

  void read_effects() {
    const auto section = root_.group("effects");
    std::vector<std::string> known;
    for (const auto& [effect, quantities] : checks_.effects) known.push_back(effect);
    const auto is_known = [&](const std::string& path, const char* what, const std::string& name, const std::vector<std::string>& names) {
      if (checks_.effects.empty() || std::find(names.begin(), names.end(), name) != names.end()) return true;
      const auto near = nearest(name, names);
      mistake(path, fmt::format("no {} \"{}\"{}", what, name, near.empty() ? "" : ", near to " + near), fmt::format("{}", fmt::join(names, ", ")));
      return false;
    };
    for (const auto& [effect, declared] : section.json().items()) {
      if (!is_known(section.path(effect), "effect", effect, known)) continue;
      const auto quantities = section.group(effect);
      for (const auto& [quantity, value] : quantities.json().items()) {
        if (!checks_.effects.empty() && !is_known(quantities.path(quantity), "quantity", quantity, checks_.effects.at(effect))) continue;
        auto& one = case_.effects[effect][quantity];
        if (value.is_number()) one.value = value.get<double>();
        if (!value.is_object()) continue;
        const auto details = quantities.group(quantity);
        details.get("value", one.value);
        details.get("lower", one.lower);
        details.get("upper", one.upper);
        details.get("free", one.free);
        if (one.lower && one.upper && !(*one.lower < *one.upper))
          mistake(quantities.path(quantity), fmt::format("lower {}, upper {}", *one.lower, *one.upper), "lower below upper");
        else if (!one.value && !one.free)
          mistake(quantities.path(quantity), "neither a value nor free: true", "a number, or {value, lower, upper, free}");
      }
    }
  }

  void read_virtual() {
    if (!root_.has("virtual")) return;
    const auto section = root_.group("virtual");
    auto& test = case_.virtual_test.emplace();
    section.get("size", test.size);
    section.get("texture", test.texture);
    section.get("speckle_size", test.speckle_size);
    section.get("noise", test.noise);
    section.get("depth", test.depth);
    section.get("load_noise", test.load_noise);
    section.get("static_frames", test.static_frames);
    section.get("seed", test.seed);
    test.directory = folder_ / test.directory;
    section.get("directory", test.directory);
    section.get("declared_mesh", test.declared_mesh);
    if (section.has("declared_mesh") && !exists(test.declared_mesh))
      mistake(section.path("declared_mesh"), fmt::format("no such file: {}", test.declared_mesh.string()), "a .msh or .inp file");
    if (test.texture && !exists(*test.texture))
      mistake(section.path("texture"), fmt::format("no such file: {}", test.texture->string()), "an image file");
  }

  /// Frames under `key`, restricted to `available` (where nothing is known of the images, as they are written).
  Frames frames_of(const Section& section, const std::string& key, const std::optional<Frames>& available) {
    const auto& value = section.value(key);
    std::string text;
    if (value.is_string()) text = value;
    if (value.is_number_integer()) text = value.dump();
    if (value.is_array())
      for (const auto& one : value) text += (text.empty() ? "" : ",") + one.dump();
    if (text.empty() && !value.is_string()) return {};  // named by the schema's check
    try {
      const auto ranges = parse_frames(text);
      return available && !available->empty() ? select(ranges, *available) : expand(ranges);
    } catch (const InputError& error) {
      for (const auto& one : error.mistakes()) mistake(section.path(key), one.found, one.allowed);
      return {};
    }
  }

  [[nodiscard]] bool simulates() const {
    if (!root_.has("specimen")) return false;
    return root_.has("identify") || root_.has("simulate") || root_.has("virtual");
  }

  static bool exists(const fs::path& path) {
    std::error_code error;
    return fs::is_regular_file(path, error);
  }

  void mistake(const std::string& path, std::string found, std::string allowed) {
    mistakes_.push_back({document_.line(path), {document_.place(path), std::move(found), std::move(allowed)}});
  }

  YamlDocument document_;
  const CaseChecks& checks_;
  std::vector<PlacedMistake> mistakes_;
  fs::path folder_;
  Section root_;
  Case case_;
};

}  // namespace

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
