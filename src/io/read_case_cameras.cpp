// The cameras of a case file: images, frames, places.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

#include "case_reader.hpp"
#include "image_files.hpp"

namespace imic3d::io {

namespace {

constexpr std::size_t most_image_mistakes = 10;

}  // namespace

void CaseReader::read_specimen_place(const Section& specimen_section) {
  if (!specimen_section.has("place")) return;
  const auto section = specimen_section.group("place");
  auto& place = case_.specimen.place.emplace();
  section.get("camera", place.camera);
  section.get("points", place.points);
  section.get("deviation", place.deviation);
  section.get("refine_cameras", place.refine_cameras);
  section.get("shape", place.shape);
}

void CaseReader::check_pinholes() {
  std::string names, face;
  bool found = false;
  const auto sections = root_.list("cameras");
  for (std::size_t i = 0; i < case_.cameras.size(); ++i) {
    const auto& camera = case_.cameras[i];
    if (camera.model != "pinhole") {
      for (const char* key : {"calibration", "index", "view", "frame"})
        if (sections[i].has(key))
          mistake(sections[i].path(key), "given for a telecentric camera", "only with model: pinhole");
      continue;
    }
    for (const char* key : {"place", "pixel_size"})
      if (sections[i].has(key))
        mistake(sections[i].path(key), "given for a pinhole camera",
                "only with model: telecentric (specimen.place places the specimen)");
    if (camera.view && camera.images.empty()) continue;  // of a virtual test: it needs nothing else
    if (camera.calibration.empty())
      mistake(sections[i].path("calibration"), "not given", "a calibration file (VIC-3D, DICe, MatchID, OpenCV)");
    else if (!exists(camera.calibration))
      mistake(sections[i].path("calibration"), fmt::format("no such file: {}", camera.calibration.string()),
              "a calibration file");
    if (camera.frame == "specimen") continue;
    names += (names.empty() ? "" : ", ") + camera.name;
    if (!face.empty() && camera.face != face)
      mistake(
          sections[i].path("face"), camera.face,
          "the face of the other pinhole cameras, " + face + ": specimen.place places one rig (or frame: specimen)");
    face = camera.face;
    found = found || !case_.specimen.place || case_.specimen.place->camera.empty() ||
            case_.specimen.place->camera == camera.name;
  }
  if (names.empty()) {
    if (case_.specimen.place)
      mistake("specimen.place", "given without a pinhole camera",
              "only with cameras of model: pinhole that have a calibration in the rig's frame");
    return;
  }
  if (!case_.specimen.place)
    mistake("specimen.place", "not given", "{points: …}: where the specimen lies in front of the pinhole cameras");
  if (!found) mistake("specimen.place.camera", case_.specimen.place->camera, "one of " + names);
}

void CaseReader::read_cameras() {
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
    for (const auto& other : case_.cameras)
      before += !camera.calibration.empty() && other.calibration == camera.calibration;
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
    const auto& first = case_.cameras.front();
    if (camera.frames != first.frames)
      mistake(item("cameras", i) + ".images", "frames " + to_text(camera.frames),
              "those of the first camera: " + to_text(first.frames));
    else if (camera.reference != first.reference)
      mistake(item("cameras", i) + ".reference", to_text(camera.reference),
              fmt::format("{} as for {}: all cameras record at once", to_text(first.reference), first.name));
  }
  check_pinholes();
}

void CaseReader::read_place(const Section& camera_section, CameraCase& camera) {
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

void CaseReader::read_images(const Section& section, CameraCase& camera) {
  if (!section.has("images")) return;
  if (section.value("images") == "from_loads") {
    take_images_from_loads(section, camera);
    return;
  }
  camera.images = files_of(section, "images");
  number_images(section, camera);
}

void CaseReader::take_images_from_loads(const Section& section, CameraCase& camera) {
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

void CaseReader::number_images(const Section& section, CameraCase& camera) {
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

Frames CaseReader::frames_in_names(const Section& section, const std::vector<fs::path>& images) {
  Frames frames;
  for (const auto& image : images) {
    const auto number = number_in_name(image);
    if (!number || (!frames.empty() && *number <= frames.back())) {
      mistake(section.path("frames"), fmt::format("from_names, with the file {}", image.filename().string()),
              "names whose last number ascends from file to file");
      return {};
    }
    frames.push_back(*number);
  }
  return frames;
}

void CaseReader::check_images(const Section& section, const CameraCase& camera) {
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
  if (found.empty())
    for (std::size_t i = 1; i < camera.images.size(); ++i)
      if (same_content(camera.images[i - 1], camera.images[i]))
        case_.doubts.push_back(fmt::format("{} and {} are the same picture: was a frame written twice?",
                                           camera.images[i - 1].string(), camera.images[i].filename().string()));
  check_number_of_images(section, camera);
  if (!case_.loads.records.empty()) {
    std::set<int> recorded;
    for (const auto& record : case_.loads.records) recorded.insert(record.frame);
    for (std::size_t i = 0; i < camera.frames.size() && i < camera.images.size(); ++i)
      if (!recorded.contains(camera.frames[i]))
        found.push_back({case_.loads.file.string(),
                         fmt::format("no row for frame {} ({})", camera.frames[i], camera.images[i].string()),
                         case_.loads.frame_times ? "images that were taken while the record ran (frame_times)"
                                                 : "a row for each image"});
  }
  if (found.size() > most_image_mistakes) {
    const auto more = found.size() - most_image_mistakes;
    found.resize(most_image_mistakes);
    found.push_back({section.path("images"), fmt::format("{} more mistakes of this kind", more), ""});
  }
  for (auto& one : found) mistakes_.push_back({line, std::move(one)});
}

void CaseReader::check_number_of_images(const Section& section, const CameraCase& camera) {
  const auto images = camera.images.size(), rows = case_.loads.records.size();
  if (section.has("frames") || section.value("images") == "from_loads" || case_.loads.frame_times || images >= rows)
    return;
  mistake(section.path("images"), fmt::format("{} images", images),
          fmt::format("{}, one for each row of {}; else say which they are: frames: from_names, or a list", rows,
                      case_.loads.file.string()));
}

void CaseReader::read_fields() {
  if (!root_.has("fields")) return;
  const auto section = root_.group("fields");
  if (!checks_.fields) {
    mistake("fields", "given",
            "images of cameras, for this command; displacement fields are for imic3d identify and loop");
    return;
  }
  if (root_.has("cameras")) mistake("fields", "given beside cameras", "one of the two");
  auto& fields = case_.fields.emplace();
  section.get("scale", fields.scale);
  section.get("origin", fields.origin);
  section.get("rotation", fields.rotation);
  section.get("y_down", fields.y_down);
  section.get("noise", fields.noise);
  section.get("subset", fields.subset);
  section.get("references", fields.references);
  const auto columns = section.group("columns");
  columns.get("x", fields.columns.x);
  columns.get("y", fields.columns.y);
  columns.get("u", fields.columns.u);
  columns.get("v", fields.columns.v);
  columns.get("valid", fields.columns.valid);
  const auto& [x, y, u, v, valid] = fields.columns;
  for (const auto& [one, name, other, its_name] : {std::tuple(x, "x", y, "y"),
                                                   {u, "u", v, "v"},
                                                   {u, "u", x, "x"},
                                                   {u, "u", y, "y"},
                                                   {v, "v", x, "x"},
                                                   {v, "v", y, "y"}})
    if (one == other)
      mistake(section.path("columns"), fmt::format("{}: {} and {}: {}", its_name, other, name, one),
              "another column for each");
  if (!section.has("files")) return;
  const auto files = files_of(section, "files");
  for (const auto& file : files) {
    try {
      fields.tables.push_back(read_points(file, fields.columns));
      fields.files.push_back(file);
    } catch (const InputError& error) {
      for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(section.path("files")), one});
    }
  }
  const auto n = fields.files.size();
  for (std::size_t i = 0; i < n; ++i) fields.frames.push_back(static_cast<int>(i) + 1);
  std::set<int> recorded;
  for (const auto& record : case_.loads.records) recorded.insert(record.frame);
  if (std::string way; section.has("frames")) {
    section.get("frames", way);
    const Frames declared =
        way == "from_names" ? frames_in_names(section, fields.files) : frames_of(section, "frames", std::nullopt);
    if (declared.size() != n && !declared.empty())
      mistake(section.path("frames"), fmt::format("{} frames", declared.size()),
              fmt::format("{}, one for each file", n));
    if (declared.size() == n) fields.frames = declared;
  } else if (!files.empty() && !recorded.empty() && *recorded.rbegin() > static_cast<int>(files.size()) &&
             !case_.loads.frame_times) {
    mistake(section.path("files"), fmt::format("{} files", files.size()),
            fmt::format("{}, one for each frame of {}; else say which they are: frames: from_names, or a list",
                        *recorded.rbegin(), case_.loads.file.string()));
  }
  if (section.has("at_rest")) fields.at_rest = frames_of(section, "at_rest", fields.frames);
  if (recorded.empty()) return;
  for (std::size_t i = 0; i < n; ++i)
    if (!recorded.contains(fields.frames[i]))
      mistakes_.push_back(
          {document_.line(section.path("files")),
           {case_.loads.file.string(),
            fmt::format("no row for frame {} ({})", fields.frames[i], fields.files[i].string()),
            case_.loads.frame_times ? "fields of frames that were taken while the record ran (frame_times)"
                                    : "a row for each field"}});
}

}  // namespace imic3d::io
