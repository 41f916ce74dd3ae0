#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <map>
#include <numbers>
#include <optional>
#include <sstream>

#include "calibration_opencv.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/imaging/calibration.hpp"

namespace imic3d::imaging {

Eigen::Matrix3d rotation_of_angles(double alpha, double beta, double gamma) {
  const double degree = std::numbers::pi / 180.0;
  using Eigen::AngleAxisd, Eigen::Vector3d;
  return (AngleAxisd(gamma * degree, Vector3d::UnitZ()) * AngleAxisd(beta * degree, Vector3d::UnitY()) *
          AngleAxisd(alpha * degree, Vector3d::UnitX()))
      .toRotationMatrix();
}

void check_camera(const std::string& place, const CalibratedCamera& camera) {
  const auto& lens = camera.intrinsics;
  const Eigen::Map<const Eigen::VectorXd> distortion(lens.distortion.data(),
                                                     static_cast<Eigen::Index>(lens.distortion.size()));
  const bool finite = distortion.allFinite() && camera.pose.translation.allFinite() &&
                      camera.pose.rotation.allFinite() &&
                      std::isfinite(lens.fx + lens.fy + lens.cx + lens.cy + lens.skew);
  if (!finite) throw InputError(place, "a number that is not finite", "finite numbers");
  if (!(lens.fx > 0.0 && lens.fy > 0.0))
    throw InputError(place, fmt::format("focal lengths {:g} and {:g}", lens.fx, lens.fy), "positive numbers [px]");
  const Eigen::Matrix3d& R = camera.pose.rotation;
  if ((R.transpose() * R - Eigen::Matrix3d::Identity()).norm() > 1e-6 || R.determinant() < 0.0)
    throw InputError(place, "a rotation that is not orthogonal or mirrors", "a rotation matrix");
}

namespace {

std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(" \t\r\n");
  return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(" \t\r\n") - first + 1);
}

double number(const std::string& place, const std::string& text) {
  std::size_t used = 0;
  double value = std::nan("");
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
  }
  if (used != text.size() || !std::isfinite(value)) throw InputError(place, "\"" + text + "\"", "a finite number");
  return value;
}

/// The numbers of a text, separated by blanks, commas and braces.
std::vector<double> numbers(const std::string& place, std::string text) {
  for (char& c : text)
    if (c == ',' || c == '{' || c == '}') c = ' ';
  std::istringstream words(text);
  std::vector<double> values;
  for (std::string word; words >> word;) values.push_back(number(place, word));
  return values;
}

/// A tag of an XML file and the text behind it, up to the next tag.
struct Tag {
  std::string name;  ///< with its slash if it closes an element
  std::map<std::string, std::string> attributes;
  std::string text;
  int line = 0;
};

/// The tags in their order, comments and declarations left out. Enough for the flat files of VIC-3D and DICe.
std::vector<Tag> tags(const std::string& file, const std::string& text) {
  std::vector<Tag> found;
  std::size_t at = 0;
  int line = 1;
  const auto advance = [&](std::size_t to) {
    line += static_cast<int>(std::count(text.begin() + static_cast<std::ptrdiff_t>(at),
                                        text.begin() + static_cast<std::ptrdiff_t>(to), '\n'));
    at = to;
  };
  while (true) {
    const auto open = text.find('<', at);
    if (!found.empty()) found.back().text += text.substr(at, open == std::string::npos ? open : open - at);
    if (open == std::string::npos) return found;
    advance(open);
    const bool comment = text.compare(at, 4, "<!--") == 0;
    const auto close = comment ? text.find("-->", at) : text.find('>', at);
    if (close == std::string::npos)
      throw InputError(fmt::format("{}:{}", file, line), "a tag that does not end", "<...>");
    const std::string inside = text.substr(at + 1, close - at - 1);
    if (!comment && inside[0] != '?' && inside[0] != '!') {
      Tag tag{.name = inside.substr(0, inside.find_first_of(" \t\r\n")), .attributes = {}, .text = {}, .line = line};
      for (auto equals = inside.find('='); equals != std::string::npos; equals = inside.find('=', equals + 1)) {
        const auto quote = inside.find_first_of("\"'", equals);
        if (quote == std::string::npos) break;
        const auto end = inside.find(inside[quote], quote + 1);
        if (end == std::string::npos) break;
        auto name = trimmed(inside.substr(0, equals));
        name = name.substr(name.find_last_of(" \t\r\n\"'") + 1);
        tag.attributes[name] = inside.substr(quote + 1, end - quote - 1);
        equals = end;
      }
      found.push_back(tag);
    }
    advance(close + (comment ? 3 : 1));
  }
}

/// VIC-3D: `<camera> cx cy fx fy skew k1 k2 k3 <orientation> alpha beta gamma tx ty tz`, or with the same numbers in
/// `<intrinsics>` and `<distortion>`. x_camera = Rz(gamma) Ry(beta) Rx(alpha) X + t; k1, k2, k3 are OpenCV's.
std::vector<CalibratedCamera> read_vic(const std::string& file, const std::vector<Tag>& found) {
  std::vector<CalibratedCamera> cameras;
  bool inside = false, has_lens = false, has_pose = false;
  int width = 0, height = 0, line = 0;
  std::string place;
  const auto finish = [&] {
    if (!inside) return;
    if (!has_lens) throw InputError(place, "no numbers", "cx cy fx fy skew k1 k2 k3");
    if (!has_pose) throw InputError(place, "no orientation", "<orientation> alpha beta gamma tx ty tz");
    check_camera(place, cameras.back());
    inside = false;
  };
  const auto lens = [&](const std::vector<double>& values) {
    if (values.empty()) return;
    if (values.size() < 5 || values.size() > 8)
      throw InputError(fmt::format("{}:{} camera", file, line), fmt::format("{} numbers", values.size()),
                       "cx cy fx fy skew k1 k2 k3");
    Intrinsics& to = cameras.back().intrinsics;
    to.cx = values[0], to.cy = values[1], to.fx = values[2], to.fy = values[3], to.skew = values[4];
    constexpr int radial[] = {0, 1, 4};
    for (std::size_t k = 5; k < values.size(); ++k) to.distortion[static_cast<std::size_t>(radial[k - 5])] = values[k];
    has_lens = true;
  };
  for (const Tag& tag : found) {
    line = tag.line;
    const auto here = fmt::format("{}:{} {}", file, tag.line, tag.name);
    if (tag.name == "polygonmask" && tag.attributes.contains("width") && tag.attributes.contains("height"))
      width = static_cast<int>(number(here, tag.attributes.at("width"))),
      height = static_cast<int>(number(here, tag.attributes.at("height")));
    if (tag.name == "camera") {
      finish();
      inside = true, has_lens = has_pose = false, place = here;
      cameras.emplace_back().name = tag.attributes.contains("id") ? "camera " + tag.attributes.at("id")
                                                                  : fmt::format("camera {}", cameras.size() - 1);
      lens(numbers(here, tag.text));
    } else if (inside && tag.name == "intrinsics") {
      lens(numbers(here, tag.text));
    } else if (inside && tag.name == "distortion") {
      const auto values = numbers(here, tag.text);
      if (values.size() > 3) throw InputError(here, fmt::format("{} numbers", values.size()), "k1 k2 k3");
      constexpr std::size_t radial[] = {0, 1, 4};
      for (std::size_t k = 0; k < values.size(); ++k) cameras.back().intrinsics.distortion[radial[k]] = values[k];
    } else if (inside && tag.name == "orientation") {
      const auto values = numbers(here, tag.text);
      if (values.size() != 6)
        throw InputError(here, fmt::format("{} numbers", values.size()), "alpha beta gamma [degrees] tx ty tz");
      cameras.back().pose = {rotation_of_angles(values[0], values[1], values[2]), {values[3], values[4], values[5]}};
      has_pose = true;
    } else if (tag.name == "/camera") {
      finish();
    }
  }
  finish();
  for (auto& camera : cameras) camera.width = width, camera.height = height;
  return cameras;
}

/// DICe: a list `CAMERA i` of named parameters for each camera; angles and distances as in VIC-3D.
std::vector<CalibratedCamera> read_dice(const std::string& file, const std::vector<Tag>& found) {
  constexpr std::array<const char*, 12> terms = {"K1", "K2", "P1", "P2", "K3", "K4",
                                                 "K5", "K6", "S1", "S2", "S3", "S4"};
  std::vector<std::map<std::string, std::pair<std::string, int>>> lists;  // value and line of every parameter
  std::map<std::string, std::pair<std::string, int>> system;
  std::vector<std::string> path;
  for (const Tag& tag : found) {
    const auto value = [&](const char* key) {
      return tag.attributes.contains(key) ? tag.attributes.at(key) : std::string();
    };
    if (tag.name == "ParameterList") {
      path.push_back(value("name"));
      if (path.back().starts_with("CAMERA ")) lists.emplace_back();
    } else if (tag.name == "/ParameterList" && !path.empty()) {
      path.pop_back();
    } else if (tag.name == "Parameter") {
      const bool of_camera = path.size() > 1 && path[1].starts_with("CAMERA ");
      (of_camera ? lists.back() : system)[value("name")] = {value("value"), tag.line};
    }
  }
  const bool relative = system.contains("extrinsics_relative_camera_to_camera") &&
                        system["extrinsics_relative_camera_to_camera"].first == "true";
  std::vector<CalibratedCamera> cameras;
  for (std::size_t i = 0; i < lists.size(); ++i) {
    auto& list = lists[i];
    const auto place = [&](const std::string& key) {
      return list.contains(key) ? fmt::format("{}:{} CAMERA {} {}", file, list[key].second, i, key)
                                : fmt::format("{} CAMERA {} {}", file, i, key);
    };
    const auto get = [&](const std::string& key, std::optional<double> otherwise = 0.0) {
      if (!list.contains(key) && !otherwise) throw InputError(place(key), "not given", "a number");
      return list.contains(key) ? number(place(key), trimmed(list[key].first)) : *otherwise;
    };
    CalibratedCamera camera;
    camera.name = list.contains("CAMERA_ID") && !list["CAMERA_ID"].first.empty() ? list["CAMERA_ID"].first
                                                                                 : fmt::format("CAMERA {}", i);
    auto& lens = camera.intrinsics;
    lens.fx = get("FX", std::nullopt), lens.fy = get("FY", std::nullopt), lens.cx = get("CX", std::nullopt),
    lens.cy = get("CY", std::nullopt);
    lens.skew = get("FS");
    for (std::size_t k = 0; k < terms.size(); ++k) lens.distortion[k] = get(terms[k]);
    const bool any = std::any_of(lens.distortion.begin(), lens.distortion.end(), [](double k) { return k != 0.0; });
    const std::string model = list.contains("LENS_DISTORTION_MODEL") ? list["LENS_DISTORTION_MODEL"].first : "NONE";
    if (model == "NONE")
      lens.distortion = {};
    else if (any && model != "OPENCV_DIS" && model != "VIC3D_DIS" && model != "K1R3_K2R5_K3R7")
      throw InputError(place("LENS_DISTORTION_MODEL"), model,
                       "OPENCV_DIS, VIC3D_DIS, K1R3_K2R5_K3R7, NONE (no other can be kept)");
    for (const char* tilt : {"T1", "T2"})
      if (get(tilt) != 0.0) throw InputError(place(tilt), list[tilt].first, "0 (a tilted sensor is not modelled)");
    if (list.contains("IMAGE_HEIGHT_WIDTH")) {
      const auto size = numbers(place("IMAGE_HEIGHT_WIDTH"), list["IMAGE_HEIGHT_WIDTH"].first);
      if (size.size() != 2)
        throw InputError(place("IMAGE_HEIGHT_WIDTH"), list["IMAGE_HEIGHT_WIDTH"].first, "{ height, width }");
      camera.height = static_cast<int>(size[0]), camera.width = static_cast<int>(size[1]);
    }
    camera.pose.rotation = rotation_of_angles(get("ALPHA"), get("BETA"), get("GAMMA"));
    for (int row = 0; row < 3; ++row) {
      const auto key = fmt::format("ROW {}", row);
      if (!list.contains(key)) continue;
      const auto values = numbers(place(key), list[key].first);
      if (values.size() != 3) throw InputError(place(key), list[key].first, "three numbers");
      camera.pose.rotation.row(row) << values[0], values[1], values[2];
    }
    camera.pose.translation = {get("TX"), get("TY"), get("TZ")};
    if (relative && i == 1) camera.pose = camera.pose * cameras[0].pose;
    check_camera(fmt::format("{} CAMERA {}", file, i), camera);
    cameras.push_back(camera);
  }
  return cameras;
}

/// MatchID: `key;value` lines. Camera 0 is the frame; x_1 = Rz(Psi) Ry(Phi) Rx(Theta) x_0 + T.
std::vector<CalibratedCamera> read_matchid(const std::string& file, const std::string& text) {
  std::map<std::string, std::pair<double, int>> values;
  std::istringstream stream(text);
  std::string row;
  for (int line = 1; std::getline(stream, row); ++line) {
    if (trimmed(row).empty()) continue;
    const auto place = fmt::format("{}:{}", file, line);
    const auto end = row.find(';');
    if (end == std::string::npos)
      throw InputError(place, "\"" + trimmed(row) + "\"", "a name, a semicolon and a number");
    auto key = trimmed(row.substr(0, row.find_first_of(";[")));
    if (key.starts_with("cam")) key[0] = 'C';
    if (values.contains(key))
      throw InputError(place + " " + key, fmt::format("given twice (first in line {})", values[key].second),
                       "each name once");
    values[key] = {number(place + " " + key, trimmed(row.substr(end + 1))), line};
  }
  const auto get = [&](const std::string& key) {
    if (!values.contains(key)) throw InputError(file + " " + key, "not given", "a line " + key + ";<number>");
    return values[key].first;
  };
  const auto get_or_zero = [&](const std::string& key) { return values.contains(key) ? values[key].first : 0.0; };
  std::vector<CalibratedCamera> cameras(2);
  for (std::size_t i = 0; i < 2; ++i) {
    const auto camera = fmt::format("Cam{}_", i);
    auto& lens = cameras[i].intrinsics;
    cameras[i].name = fmt::format("camera {}", i);
    lens.fx = get(camera + "Fx"), lens.fy = get(camera + "Fy"), lens.cx = get(camera + "Cx"),
    lens.cy = get(camera + "Cy");
    lens.skew = get_or_zero(camera + "Fs");
    lens.distortion = {get_or_zero(camera + "Kappa 1"), get_or_zero(camera + "Kappa 2"), get_or_zero(camera + "P1"),
                       get_or_zero(camera + "P2"), get_or_zero(camera + "Kappa 3")};
  }
  cameras[1].pose = {rotation_of_angles(get("Theta"), get("Phi"), get("Psi")), {get("Tx"), get("Ty"), get("Tz")}};
  for (const auto& camera : cameras) check_camera(file + " " + camera.name, camera);
  return cameras;
}

}  // namespace

std::vector<CalibratedCamera> read_calibration(const std::filesystem::path& path) {
  const std::string file = path.string();
  const char* formats = "a calibration of VIC-3D, DICe (XML), MatchID (.caldat) or OpenCV (YAML, XML)";
  std::error_code error;
  std::ifstream stream(path, std::ios::binary);
  if (!stream || std::filesystem::is_directory(path, error))
    throw InputError(file, std::filesystem::exists(path, error) ? "cannot be read" : "no such file", formats);
  const std::string text((std::istreambuf_iterator<char>(stream)), {});
  std::vector<CalibratedCamera> cameras;
  if (text.starts_with("%YAML") || text.find("<opencv_storage") != std::string::npos) {
    cameras = read_opencv_calibration(path, text);
  } else if (text.find("DICe_xml_camera_system_file") != std::string::npos) {
    cameras = read_dice(file, tags(file, text));
  } else if (text.find("<camera") != std::string::npos) {
    cameras = read_vic(file, tags(file, text));
  } else if (text.find("_Fx") != std::string::npos && text.find(';') != std::string::npos) {
    cameras = read_matchid(file, text);
  } else {
    throw InputError(file, "not a calibration", formats);
  }
  if (cameras.empty()) throw InputError(file, "no camera", formats);
  return cameras;
}

}  // namespace imic3d::imaging
