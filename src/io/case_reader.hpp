#pragma once
// The reader of case files, its parts by section.

#include <algorithm>
#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "imic3d/io/case.hpp"
#include "schema.hpp"
#include "yaml_document.hpp"

namespace imic3d::io {

using Json = nlohmann::json;
namespace fs = std::filesystem;

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

/// Turns a document into a Case and collects everything that is wrong with it.
class CaseReader {
 public:
  CaseReader(YamlDocument document, const CaseChecks& checks)
      : document_(std::move(document)),
        checks_(checks),
        mistakes_(document_.mistakes),
        folder_(document_.file.parent_path()),
        root_(document_.root, "", folder_) {}
  Case read();

 private:
  /// The case, or all mistakes by their lines.
  Case finished();
  void read_units();
  void read_specimen();
  void read_specimen_place(const Section& specimen_section);
  /// Pinhole cameras have a calibration, and the specimen a place in front of them.
  void check_pinholes();
  void check_mesh(const Section& section);
  /// Every part of the mesh is held by one of the ends.
  void check_parts(const Section& section, const mesh::Mesh& mesh);
  void doubt_ends(const mesh::Mesh& mesh, const std::vector<int>& held, const std::vector<int>& loaded);
  void read_loads_section();
  /// Whether there is one way to tell them.
  bool read_frame_times(const Section& loads);
  [[nodiscard]] std::vector<LoadRecord> recorded_loads() const;
  void read_cameras();
  void read_place(const Section& camera_section, CameraCase& camera);
  void read_images(const Section& section, CameraCase& camera);
  void take_images_from_loads(const Section& section, CameraCase& camera);
  void number_images(const Section& section, CameraCase& camera);
  Frames frames_in_names(const Section& section, const std::vector<fs::path>& images);
  /// All images are of the first one's size and depth, and every one has a row of loads.
  void check_images(const Section& section, const CameraCase& camera);
  /// Images that are merely counted must be as many as the rows: a file that is missing would shift all that follow.
  void check_number_of_images(const Section& section, const CameraCase& camera);
  void read_fields();
  void read_material();
  void doubt_units();
  void check_table(const Section& section);
  void check_parameters(const Section& section);
  void doubt_bound(const ParameterInfo& info, const char* which, double declared, double own);
  static std::string range_of(const ParameterInfo& info);
  void check_bounds(const std::string& path, const ParameterCase& parameter);
  void read_experiments();
  void read_tests();
  void read_curves(const Section& section, ExperimentCase& experiment);
  void read_dic();
  void read_simulate();
  void settle_frames();
  void read_identify();
  void read_loop();
  void read_effects();
  void read_virtual();
  /// Files of the pattern, or the patterns, under `key`; a pattern without any is a mistake.
  std::vector<fs::path> files_of(const Section& section, const std::string& key);
  /// Frames under `key`, restricted to `available` (where nothing is known of the images, as they are written).
  Frames frames_of(const Section& section, const std::string& key, const std::optional<Frames>& available,
                   const std::string& what = "frame");
  [[nodiscard]] bool simulates() const;
  [[nodiscard]] bool on_curves() const;
  /// The schema has refused the value of this path, one around it, or (within a section) one of its members: what
  /// follows from that is no mistake of its own.
  [[nodiscard]] bool is_refused(const std::string& path) const;
  static bool exists(const fs::path& path);
  void mistake(const std::string& path, std::string found, std::string allowed);
  YamlDocument document_;
  const CaseChecks& checks_;
  std::vector<PlacedMistake> mistakes_;
  fs::path folder_;
  Section root_;
  Case case_;
  std::vector<std::string> parameters_of_law_;  // where it is known
};

}  // namespace imic3d::io
