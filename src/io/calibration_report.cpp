#include "imic3d/io/calibration_report.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "html.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/run_results.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

using imaging::CalibratedCamera, imaging::camera_number_names, imaging::camera_numbers;

/// What a camera's numbers are, with unit and standard deviation (0: fixed). The pose is given as the rotation vector
/// of the whole rotation; its deviations are those of a small further rotation.
struct Number {
  std::string name, unit;
  double value, deviation;
};

std::vector<Number> numbers_of(const CalibrationRun& run, std::size_t c) {
  const CalibratedCamera& camera = run.result.cameras[c];
  const auto& lens = camera.intrinsics;
  std::vector<double> values = {lens.fx, lens.fy, lens.cx, lens.cy, lens.skew};
  values.insert(values.end(), lens.distortion.begin(), lens.distortion.end());
  const Eigen::AngleAxisd turn(camera.pose.rotation);
  for (int axis = 0; axis < 3; ++axis) values.push_back(turn.angle() * turn.axis()[axis]);
  for (int axis = 0; axis < 3; ++axis) values.push_back(camera.pose.translation[axis]);
  std::vector<Number> numbers;
  for (int n = 0; n < camera_numbers; ++n) {
    const double variance = camera.covariance(n, static_cast<Eigen::Index>(c) * camera_numbers + n);
    const bool shown = variance > 0.0 || (c > 0 && n >= 17);
    if (shown)
      numbers.push_back({camera_number_names[static_cast<std::size_t>(n)],
                         n < 5    ? "px"
                         : n < 17 ? "-"
                         : n < 20 ? "rad"
                                  : run.request.unit,
                         values[static_cast<std::size_t>(n)], std::sqrt(variance)});
  }
  return numbers;
}

/// From the first camera's centre to camera c's, and the angle between their axes.
struct Geometry {
  double baseline, baseline_deviation, angle;
};

Geometry geometry(const CalibrationRun& run, std::size_t c) {
  const CalibratedCamera& camera = run.result.cameras[c];
  const Eigen::Vector3d along = camera.pose.translation.normalized();
  const Eigen::Matrix3d covariance =
      camera.covariance.block<3, 3>(20, static_cast<Eigen::Index>(c) * camera_numbers + 20);
  return {camera.pose.translation.norm(), std::sqrt(along.dot(covariance * along)),
          std::acos(std::clamp(camera.pose.rotation(2, 2), -1.0, 1.0)) * 180.0 / std::numbers::pi};
}

std::string file_name(const CalibrationRun& run, std::size_t c, std::size_t f) {
  return run.request.cameras[c].images[f].filename().string();
}

/// The magnification, a round number, that makes a typical residual about `length` long.
double magnification(double rms, double length) {
  if (!(rms > 0.0)) return 1.0;
  const double wanted = length / rms, power = std::pow(10.0, std::floor(std::log10(wanted)));
  return wanted >= 5.0 * power ? 5.0 * power : wanted >= 2.0 * power ? 2.0 * power : power;
}

std::string jpeg(const cv::Mat& picture) {
  std::vector<unsigned char> bytes;
  cv::imencode(".jpg", picture, bytes, {cv::IMWRITE_JPEG_QUALITY, 82});
  return base64({bytes.begin(), bytes.end()});
}

/// The way from a point to the next in its row, of all images on average [px].
double mean_spacing(const CalibrationRun& run) {
  double sum = 0.0, count = 0.0;
  const auto columns = static_cast<std::size_t>(run.request.target.columns);
  for (const auto& camera : run.sightings)
    for (const auto& pixels : camera.pixels)
      for (std::size_t k = 1; k < pixels.size(); ++k)
        if (k % columns != 0) sum += (pixels[k] - pixels[k - 1]).norm(), count += 1.0;
  return sum / count;
}

/// The part of an image with the target (all of it if that was not found), its points joined row by row from blue to
/// red, and the residuals as arrows, `times` their length.
cv::Mat picture_of(const CalibrationRun& run, std::size_t c, std::size_t f, double times) {
  const auto image = imaging::read_image(run.request.cameras[c].images[f]);
  const auto& pixels = run.sightings[c].pixels[f];
  const auto& residuals = run.result.residuals[c][f];
  Eigen::Vector2d lower(0.0, 0.0), upper(image.width - 1.0, image.height - 1.0);
  if (!pixels.empty()) {
    Eigen::Vector2d first = pixels[0], last = pixels[0];
    for (const auto& pixel : pixels) first = first.cwiseMin(pixel), last = last.cwiseMax(pixel);
    const Eigen::Vector2d air = Eigen::Vector2d::Constant(0.15 * (last - first).maxCoeff());
    lower = (first - air).cwiseMax(lower), upper = (last + air).cwiseMin(upper);
  }
  const cv::Rect part(static_cast<int>(lower[0]), static_cast<int>(lower[1]), static_cast<int>(upper[0] - lower[0]) + 1,
                      static_cast<int>(upper[1] - lower[1]) + 1);
  const cv::Mat grey(image.height, image.width, CV_32F, const_cast<float*>(image.grey.data()));
  cv::Mat bytes, picture;
  cv::normalize(grey(part), bytes, 60, 255, cv::NORM_MINMAX, CV_8U);
  const double scale = 640.0 / std::max(part.width, part.height);
  cv::resize(bytes, bytes, {}, scale, scale, scale < 1.0 ? cv::INTER_AREA : cv::INTER_LINEAR);
  cv::cvtColor(bytes, picture, cv::COLOR_GRAY2BGR);
  const auto at =
      [&](const Eigen::Vector2d& pixel) {  // the centre of the first pixel is (0, 0); in sixteenths for OpenCV
        return cv::Point(static_cast<int>(std::lround(16.0 * ((pixel[0] - part.x + 0.5) * scale - 0.5))),
                         static_cast<int>(std::lround(16.0 * ((pixel[1] - part.y + 0.5) * scale - 0.5))));
      };
  const auto columns = static_cast<std::size_t>(run.request.target.columns);
  for (std::size_t k = 0; k < pixels.size(); ++k) {
    const double way = static_cast<double>(k / columns) / std::max(1, run.request.target.rows - 1);
    const cv::Scalar colour(220 * (1.0 - way), 120, 220 * way);
    if (k > 0) cv::line(picture, at(pixels[k - 1]), at(pixels[k]), colour, 1, cv::LINE_AA, 4);
    cv::circle(picture, at(pixels[k]), 16 * 4, colour, k == 0 ? 3 : 1, cv::LINE_AA, 4);
  }
  for (std::size_t k = 0; k < pixels.size(); ++k)
    cv::arrowedLine(picture, at(pixels[k]), at(pixels[k] + times * residuals[k]), {0, 200, 255}, 2, cv::LINE_AA, 4,
                    0.25);
  return picture;
}

/// All residuals of a camera as lines over its sensor.
std::string sensor_map(const CalibrationRun& run, std::size_t c, double times) {
  const auto& seen = run.sightings[c];
  const double scale = 500.0 / seen.width, margin = 8.0, top = 24.0;
  std::string lines;
  for (std::size_t f = 0; f < seen.pixels.size(); ++f)
    for (std::size_t k = 0; k < seen.pixels[f].size(); ++k) {
      const Eigen::Vector2d at = scale * seen.pixels[f][k] + Eigen::Vector2d(margin, top),
                            to = at + scale * times * run.result.residuals[c][f][k];
      lines += fmt::format("<path d=\"M{:.1f} {:.1f}L{:.1f} {:.1f}\"/><circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"1\"/>",
                           at[0], at[1], to[0], to[1], at[0], at[1]);
    }
  return fmt::format(
      "<svg width=\"{:.0f}\" height=\"{:.0f}\"><text class=\"plot-title\" x=\"{}\" y=\"14\">{}: all residuals, {:g} "
      "times</text>"
      "<rect class=\"frame\" x=\"{}\" y=\"{}\" width=\"500\" height=\"{:.1f}\"/><g stroke=\"#b2182b\" "
      "stroke-width=\"0.8\">{}</g></svg>\n",
      500 + 2 * margin, seen.height * scale + top + margin, margin, escaped(seen.name), times, margin, top,
      seen.height * scale, lines);
}

/// The error of every image of every camera as bars.
std::string bars(const CalibrationRun& run) {
  constexpr const char* colours[] = {"#2166ac", "#b2182b", "#1b7837", "#762a83", "#b35806", "#444444"};
  const auto& cameras = run.sightings;
  const std::size_t frames = cameras[0].pixels.size();
  double highest = 0.0;
  for (std::size_t c = 0; c < cameras.size(); ++c)
    for (std::size_t f = 0; f < frames; ++f)
      if (const double rms = run.result.rms_of(c, f); std::isfinite(rms)) highest = std::max(highest, rms);
  const double left = 56, top = 30, height = 220, group = std::clamp(960.0 / static_cast<double>(frames), 8.0, 60.0),
               width = group * static_cast<double>(frames);
  const auto y = [&](double value) { return top + height * (1.0 - value / (1.1 * highest)); };
  std::string out = fmt::format(
      "<svg width=\"{:.0f}\" height=\"{:.0f}\"><text class=\"plot-title\" x=\"{}\" y=\"14\">Reprojection error of "
      "every image "
      "(rms)</text>\n",
      left + width + 10, top + height + 46, left);
  for (const double tick : round_ticks(0.0, 1.1 * highest))
    out += fmt::format(
        "<path class=\"grid\" d=\"M{} {:.1f}h{:.1f}\"/><text class=\"tick\" x=\"{}\" y=\"{:.1f}\" "
        "text-anchor=\"end\">{:g}</text>\n",
        left, y(tick), width, left - 6, y(tick) + 4, std::abs(tick));
  const double bar = 0.8 * group / static_cast<double>(cameras.size());
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    const char* colour = colours[c % std::size(colours)];
    for (std::size_t f = 0; f < frames; ++f) {
      const double rms = run.result.rms_of(c, f),
                   x = left + group * (static_cast<double>(f) + 0.1) + bar * static_cast<double>(c);
      if (std::isfinite(rms))
        out += fmt::format(
            "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"{}\"><title>{}: {:.4f} "
            "px</title></rect>\n",
            x, y(rms), bar, top + height - y(rms), colour, escaped(file_name(run, c, f)), rms);
      else
        out += fmt::format(
            "<text class=\"tick\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">×<title>{}: not "
            "found</title></text>\n",
            x + bar / 2, top + height - 3, escaped(file_name(run, c, f)));
    }
    const double rms = run.result.rms_of(c);
    out += fmt::format("<path d=\"M{} {:.1f}h{:.1f}\" stroke=\"{}\" stroke-dasharray=\"4 3\"/>", left, y(rms), width,
                       colour);
    out += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"10\" height=\"10\" fill=\"{}\"/><text class=\"tick\" x=\"{:.1f}\" "
        "y=\"{:.1f}\">{} ({:.4f} "
        "px)</text>\n",
        left + 190 * static_cast<double>(c), top + height + 30, colour, left + 190 * static_cast<double>(c) + 14,
        top + height + 39, escaped(cameras[c].name), rms);
  }
  const std::size_t step = std::max<std::size_t>(1, static_cast<std::size_t>(std::ceil(24.0 / group)));
  for (std::size_t f = 0; f < frames; f += step)
    out += fmt::format("<text class=\"tick\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{}</text>",
                       left + group * (static_cast<double>(f) + 0.5), top + height + 14, f);
  out += fmt::format(
      "<text class=\"axis\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"end\">frame</text><text class=\"axis\" x=\"4\" "
      "y=\"{}\">[px]</text>",
      left + width, top + height + 28, top - 2);
  return out + fmt::format("<path class=\"frame\" d=\"M{} {}v{}h{:.1f}\"/></svg>\n", left, top, height, width);
}

std::size_t found(const imaging::CameraSightings& camera) {
  return static_cast<std::size_t>(
      std::count_if(camera.pixels.begin(), camera.pixels.end(), [](const auto& pixels) { return !pixels.empty(); }));
}

}  // namespace

void write_calibration_result(const std::filesystem::path& file, const CalibrationRun& run) {
  const auto quantity = [](double value, const std::string& unit) {
    return nlohmann::ordered_json{
        {"value", std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json()}, {"unit", unit}};
  };
  nlohmann::ordered_json out;
  out["title"] = run.request.title;
  out["program"] = run.program;
  out["rms_reprojection_error"] = quantity(run.result.rms, "px");
  out["standard_deviation_of_a_coordinate"] = quantity(run.result.deviation, "px");
  out["iterations"] = run.result.iterations;
  for (std::size_t c = 0; c < run.sightings.size(); ++c) {
    const auto& seen = run.sightings[c];
    nlohmann::ordered_json camera{{"name", seen.name},
                                  {"images", seen.pixels.size()},
                                  {"found", found(seen)},
                                  {"rms_reprojection_error", quantity(run.result.rms_of(c), "px")}};
    for (const auto& number : numbers_of(run, c))
      camera["numbers"][number.name] = {
          {"value", number.value}, {"standard_deviation", number.deviation}, {"unit", number.unit}};
    if (c > 0) {
      const Geometry rig = geometry(run, c);
      camera["distance_from_first"] = {
          {"value", rig.baseline}, {"standard_deviation", rig.baseline_deviation}, {"unit", run.request.unit}};
      camera["angle_to_first"] = quantity(rig.angle, "degree");
    }
    camera["not_found"] = nlohmann::ordered_json::array();
    for (std::size_t f = 0; f < seen.pixels.size(); ++f) {
      if (seen.pixels[f].empty()) camera["not_found"].push_back(file_name(run, c, f));
      camera["rms_of_images"].push_back(
          {{"file", file_name(run, c, f)}, {"rms", quantity(run.result.rms_of(c, f), "px")}});
    }
    out["cameras"].push_back(camera);
  }
  write_text_file(file, out.dump(2) + "\n");
}

void write_calibration_page(const std::filesystem::path& page, const CalibrationRun& run) {
  const auto& request = run.request;
  const auto title = escaped(request.title);
  std::string out = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta "
      "charset=\"utf-8\">\n<title>{0}</title>\n<style>{1}</style>\n</head>\n<body>\n<h1>{0}</h1>\n"
      "<p class=\"note\">{2} · {3}</p>\n",
      title, page_style, escaped(request.file.string()), escaped(run.program));
  std::string pairs;
  for (std::size_t c = 0; c < run.sightings.size(); ++c)
    pairs += fmt::format("<tr><td>{}</td><td>{} of {}</td><td>{}</td></tr>\n", escaped(run.sightings[c].name),
                         found(run.sightings[c]), run.sightings[c].pixels.size(), shown(run.result.rms_of(c), 4));
  out += fmt::format(
      "<h2>How well it fits</h2>\n<table>\n<tr><th>camera</th><th>target found</th><th>reprojection error, rms "
      "[px]</th></tr>\n{}<tr><td>all</td><td></td><td>{}</td></tr>\n</table>\n"
      "<p>Reprojection error: the distance of a point of the target in the image from where the fit sees it. Standard "
      "deviation of one "
      "coordinate of a point: {} px.</p>\n",
      pairs, shown(run.result.rms, 4), shown(run.result.deviation, 3));
  std::string missing;
  for (std::size_t c = 0; c < run.sightings.size(); ++c)
    for (std::size_t f = 0; f < run.sightings[c].pixels.size(); ++f)
      if (run.sightings[c].pixels[f].empty())
        missing += fmt::format("<li>{}: {}</li>\n", escaped(run.sightings[c].name), escaped(file_name(run, c, f)));
  if (!missing.empty())
    out += "<p>The target was not found in these images, which are left out:</p>\n<ul>\n" + missing + "</ul>\n";

  out += "<h2>Error of every image</h2>\n<div class=\"plots\">\n" + bars(run) +
         "</div>\n<h2>Residuals over the sensor</h2>\n<p class=\"note\">Noise has no pattern here; a lens that the "
         "distortion terms cannot "
         "describe has.</p>\n<div class=\"plots\">\n";
  const double on_sensor = magnification(run.result.rms, 0.02 * run.sightings[0].width);
  for (std::size_t c = 0; c < run.sightings.size(); ++c) out += sensor_map(run, c, on_sensor);
  out += "</div>\n<h2>Cameras</h2>\n";
  for (std::size_t c = 0; c < run.sightings.size(); ++c) {
    out += fmt::format(
        "<h3>{}</h3>\n<table>\n<tr><th>number</th><th>value</th><th>standard deviation</th><th>unit</th></tr>\n",
        escaped(run.sightings[c].name));
    for (const auto& number : numbers_of(run, c))
      out += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td class=\"left\">{}</td></tr>\n", number.name,
                         shown_with(number.value, number.deviation), shown(number.deviation, 2), number.unit);
    out += "</table>\n";
    if (c == 0) continue;
    const Geometry rig = geometry(run, c);
    out += fmt::format("<p>{} {} from {} (standard deviation {}), its axis turned by {:.3f} degrees.</p>\n",
                       shown_with(rig.baseline, rig.baseline_deviation), request.unit, escaped(run.sightings[0].name),
                       shown(rig.baseline_deviation, 2), rig.angle);
  }
  const double in_picture = magnification(run.result.rms, 0.6 * mean_spacing(run));
  out += fmt::format(
      "<h2>Images</h2>\n<p class=\"note\">Points as found, the first of them thick; yellow: seen minus predicted, "
      "drawn {:g} times as "
      "long.</p>\n<div class=\"pictures\">\n",
      in_picture);
  for (std::size_t f = 0; f < run.sightings[0].pixels.size(); ++f)
    for (std::size_t c = 0; c < run.sightings.size(); ++c) {
      const double rms = run.result.rms_of(c, f);
      out += fmt::format(
          "<figure><img alt=\"{0}\" src=\"data:image/jpeg;base64,{1}\"><figcaption>frame {2}, {3}: {0}, "
          "{4}</figcaption></figure>\n",
          escaped(file_name(run, c, f)), jpeg(picture_of(run, c, f, in_picture)), f, escaped(run.sightings[c].name),
          std::isfinite(rms) ? fmt::format("{:.4f} px", rms) : "target not found");
    }
  out += fmt::format(
      "</div>\n<h2>Calibration "
      "file</h2>\n<details><summary>{}</summary>\n<pre>{}</pre>\n</details>\n</body>\n</html>\n",
      escaped(request.file.string()), escaped(request.text));
  write_text_file(page, out);
}

}  // namespace imic3d::io
