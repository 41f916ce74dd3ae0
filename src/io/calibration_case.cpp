#include "imic3d/io/calibration_case.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "image_files.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/imaging/calibration.hpp"
#include "schema.hpp"
#include "yaml_document.hpp"

namespace imic3d::io {

namespace {

imaging::Target target(const nlohmann::json& given) {
  const std::string type = given["type"];
  return {.type = type == "chessboard" ? imaging::TargetType::chessboard
                  : type == "circles"  ? imaging::TargetType::circles
                                       : imaging::TargetType::asymmetric_circles,
          .rows = given["rows"],
          .columns = given["columns"],
          .spacing = given["spacing"],
          .diameter = given.value("diameter", 0.0)};
}

class Reader {
 public:
  explicit Reader(const std::filesystem::path& file) : document_(read_yaml(file)) {}

  CalibrationCase read() {
    mistakes_ = document_.mistakes;
    for (auto& mistake : check_schema(document_, calibration_schema())) mistakes_.push_back(std::move(mistake));
    stop_if_wrong();
    const auto& root = document_.root;
    CalibrationCase read{.file = document_.file,
                         .text = document_.text,
                         .title = root["title"],
                         .target = target(root["target"]),
                         .unit = root["target"].value("unit", "mm"),
                         .cameras = {},
                         .terms = {},
                         .output = {}};
    check(read.target);
    std::set<std::string> names;
    for (std::size_t c = 0; c < root["cameras"].size(); ++c) {
      read.cameras.push_back(camera(c, root["cameras"][c]));
      if (!names.insert(read.cameras[c].name).second)
        mistake(item("cameras", c) + ".name", fmt::format("\"{}\" again", read.cameras[c].name), "a name once");
      const auto count = read.cameras[c].images.size(), first = read.cameras[0].images.size();
      if (count > 0 && first > 0 && count != first)
        mistake(item("cameras", c) + ".images", fmt::format("{} images", count),
                fmt::format("{} as of camera {}: the k-th images belong together", first, read.cameras[0].name));
    }
    const auto terms = root.value("distortion", std::vector<std::string>{"k1", "k2", "p1", "p2", "k3"});
    for (std::size_t i = 0; i < terms.size(); ++i) {
      constexpr int first_term = 5;  // among the camera's numbers
      const auto& all = imaging::camera_number_names;
      const int term = static_cast<int>(std::find(all.begin(), all.end(), terms[i]) - all.begin()) - first_term;
      if (std::find(read.terms.begin(), read.terms.end(), term) != read.terms.end())
        mistake(item("distortion", i), fmt::format("\"{}\" again", terms[i]), "a term once");
      read.terms.push_back(term);
    }
    stop_if_wrong();
    const auto folder = document_.file.parent_path();
    read.output = root.contains("output") ? folder / root["output"].get<std::string>() : folder / "calibration";
    read.output = read.output.lexically_normal();
    return read;
  }

 private:
  void check(const imaging::Target& target) {
    if (target.type == imaging::TargetType::chessboard && std::min(target.rows, target.columns) < 3)
      mistake("target", fmt::format("{} x {} inner corners", target.rows, target.columns), "at least 3 x 3");
    const double nearest =
        target.type == imaging::TargetType::asymmetric_circles ? std::sqrt(2.0) * target.spacing : target.spacing;
    if (target.diameter > 0.0 && target.type == imaging::TargetType::chessboard)
      mistake("target.diameter", "of a chessboard", "circles only");
    else if (target.diameter >= nearest)
      mistake("target.diameter", fmt::format("{:g}", target.diameter),
              fmt::format("less than the way to the next circle, {:g}", nearest));
  }

  CalibrationCase::Camera camera(std::size_t c, const nlohmann::json& given) {
    const auto path = item("cameras", c);
    CalibrationCase::Camera camera{.name = given.value("name", fmt::format("camera {}", c)), .images = {}};
    std::vector<std::string> patterns;
    if (given["images"].is_string())
      patterns = {given["images"].get<std::string>()};
    else
      patterns = given["images"].get<std::vector<std::string>>();
    for (const auto& pattern : patterns) {
      const auto files = matching_files(document_.file.parent_path(), pattern);
      if (files.empty()) mistake(path + ".images", fmt::format("no file \"{}\"", pattern), "images that exist");
      camera.images.insert(camera.images.end(), files.begin(), files.end());
    }
    for (const auto& file : camera.images) {
      try {
        const auto header = read_image_header(file);
        if (camera.width == 0) camera.width = header.columns, camera.height = header.rows;
        if (header.columns != camera.width || header.rows != camera.height)
          mistakes_.push_back(
              {document_.line(path),
               {file.string(), fmt::format("{} x {} px", header.columns, header.rows),
                fmt::format("{} x {} px as {}", camera.width, camera.height, camera.images[0].string())}});
        if (header.depth != 8 && header.depth != 16)
          mistakes_.push_back(
              {document_.line(path), {file.string(), fmt::format("{} bits", header.depth), "8 or 16 bits"}});
      } catch (const InputError& error) {
        for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(path), one});
      }
    }
    return camera;
  }

  void mistake(const std::string& path, std::string found, std::string allowed) {
    mistakes_.push_back({document_.line(path), {document_.place(path), std::move(found), std::move(allowed)}});
  }

  void stop_if_wrong() {
    if (mistakes_.empty()) return;
    std::stable_sort(mistakes_.begin(), mistakes_.end(), [](const auto& a, const auto& b) { return a.line < b.line; });
    std::vector<Mistake> all;
    for (const auto& placed : mistakes_) all.push_back(placed.mistake);
    throw InputError(all);
  }

  YamlDocument document_;
  std::vector<PlacedMistake> mistakes_;
};

}  // namespace

CalibrationCase read_calibration_case(const std::filesystem::path& file) { return Reader(file).read(); }

}  // namespace imic3d::io
