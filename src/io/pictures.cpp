#include "imic3d/io/pictures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "imic3d/core/error.hpp"
#include "imic3d/io/run_results.hpp"

namespace imic3d::io {

namespace {

const cv::Scalar white(255, 255, 255), black(0, 0, 0), grey(110, 110, 110);
constexpr int legend_width = 150, margin = 14;

void save(const std::filesystem::path& picture, const cv::Mat& pixels) {
  std::vector<unsigned char> bytes;
  cv::imencode(picture.extension().string(), pixels, bytes);
  write_text_file(picture, {bytes.begin(), bytes.end()});  // whole or not at all
}

/// From numbers in a range to colours.
class Colours {
 public:
  Colours(std::span<const double> values, const ColourScale& scale) : diverging_(scale.diverging) {
    lower_ = scale.lower;
    upper_ = scale.upper;
    if (lower_ == upper_) choose_range(values);
    cv::Mat ramp(1, 256, CV_8U);
    for (int i = 0; i < 256; ++i) ramp.at<unsigned char>(i) = static_cast<unsigned char>(i);
    cv::applyColorMap(ramp, viridis_, cv::COLORMAP_VIRIDIS);
  }

  [[nodiscard]] cv::Vec3b operator()(double value) const {
    if (!std::isfinite(value)) return {255, 255, 255};
    const double t = std::clamp((value - lower_) / (upper_ - lower_), 0.0, 1.0);
    if (!diverging_) return viridis_.at<cv::Vec3b>(static_cast<int>(std::lround(255 * t)));
    const cv::Vec3d blue(172, 102, 33), middle(240, 240, 240), red(43, 24, 178);  // BGR
    const cv::Vec3d colour = t < 0.5 ? blue + (middle - blue) * (2 * t) : middle + (red - middle) * (2 * t - 1);
    return {cv::saturate_cast<unsigned char>(colour[0]), cv::saturate_cast<unsigned char>(colour[1]),
            cv::saturate_cast<unsigned char>(colour[2])};
  }

  [[nodiscard]] double lower() const { return lower_; }
  [[nodiscard]] double upper() const { return upper_; }

 private:
  /// 1 % of the values may lie outside on either side, so that a few do not hide the rest.
  void choose_range(std::span<const double> values) {
    std::vector<double> finite;
    std::copy_if(values.begin(), values.end(), std::back_inserter(finite), [](double v) { return std::isfinite(v); });
    if (finite.empty()) finite = {0.0};
    std::sort(finite.begin(), finite.end());
    const auto n = finite.size();
    lower_ = finite[n / 100];
    upper_ = finite[n - 1 - n / 100];
    if (diverging_) {
      upper_ = std::max(std::abs(lower_), std::abs(upper_));
      lower_ = -upper_;
    }
    if (!(lower_ < upper_)) {
      lower_ -= 0.5;
      upper_ += 0.5;
    }
  }

  bool diverging_;
  double lower_ = 0.0, upper_ = 1.0;
  cv::Mat viridis_;
};

/// The picture with a colour bar to its right and what it shows above the bar.
cv::Mat with_legend(const cv::Mat& pixels, const Colours& colours, const std::string& legend) {
  const int height = std::max(pixels.rows, 200);
  int baseline = 0;
  const int text_width = cv::getTextSize(legend, cv::FONT_HERSHEY_SIMPLEX, 0.5, 1, &baseline).width;
  cv::Mat whole(height + 3 * margin, std::max(pixels.cols + legend_width, text_width) + 2 * margin, CV_8UC3, white);
  pixels.copyTo(whole(cv::Rect(margin, 2 * margin, pixels.cols, pixels.rows)));
  cv::putText(whole, legend, {margin, margin + 4}, cv::FONT_HERSHEY_SIMPLEX, 0.5, black, 1, cv::LINE_AA);
  const int left = pixels.cols + 2 * margin, top = 2 * margin + 6, bar = height - 12;
  for (int row = 0; row < bar; ++row) {
    const double value = colours.upper() + (colours.lower() - colours.upper()) * row / (bar - 1.0);
    const auto colour = colours(value);
    cv::line(whole, {left, top + row}, {left + 22, top + row},
             {double(colour[0]), double(colour[1]), double(colour[2])});
  }
  cv::rectangle(whole, {left, top}, {left + 22, top + bar - 1}, grey);
  constexpr int ticks = 4;
  for (int i = 0; i <= ticks; ++i) {
    const double t = static_cast<double>(i) / ticks;
    double value = colours.upper() + (colours.lower() - colours.upper()) * t;
    if (std::abs(value) < 1e-9 * (colours.upper() - colours.lower())) value = 0.0;
    const int row = top + static_cast<int>(std::lround(t * (bar - 1)));
    cv::line(whole, {left + 22, row}, {left + 27, row}, grey);
    cv::putText(whole, fmt::format("{:.3g}", value), {left + 31, row + 5}, cv::FONT_HERSHEY_SIMPLEX, 0.45, black, 1,
                cv::LINE_AA);
  }
  return whole;
}

cv::Point2d corner(std::span<const double> positions, int node) {
  const auto n = static_cast<std::size_t>(node);
  return {positions[2 * n], positions[2 * n + 1]};
}

/// Edges of a quad mesh; the number says how many cells have it.
std::map<std::pair<int, int>, int> edges_of(const mesh::Mesh& quads) {
  std::map<std::pair<int, int>, int> edges;
  for (Eigen::Index c = 0; c < quads.cells.rows(); ++c)
    for (int k = 0; k < 4; ++k) {
      const int a = quads.cells(c, k), b = quads.cells(c, (k + 1) % 4);
      ++edges[{std::min(a, b), std::max(a, b)}];
    }
  return edges;
}

/// Fixed-point coordinates, for lines that do not jump by whole pixels.
constexpr int shift = 4;
cv::Point fixed(const cv::Point2d& point) {
  return {cv::saturate_cast<int>(point.x * (1 << shift)), cv::saturate_cast<int>(point.y * (1 << shift))};
}

/// 8 bits of any image: 16 bits are stretched to their range.
cv::Mat to_eight_bits(const cv::Mat& image) {
  cv::Mat grey_levels = image;
  if (image.channels() > 1)
    cv::cvtColor(image, grey_levels, image.channels() == 4 ? cv::COLOR_BGRA2GRAY : cv::COLOR_BGR2GRAY);
  cv::Mat eight;
  if (grey_levels.depth() == CV_8U) {
    eight = grey_levels;
  } else {
    cv::normalize(grey_levels, eight, 0, 255, cv::NORM_MINMAX, CV_8U);
  }
  return eight;
}

}  // namespace

void draw_mesh_on_image(const std::filesystem::path& picture, const std::filesystem::path& image,
                        const mesh::Mesh& quads, std::span<const double> pixels) {
  cv::Mat read;
  try {
    read = cv::imread(image.string(), cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    read.release();
  }
  if (read.empty()) throw InputError(image.string(), "cannot be read", "an image");
  cv::Mat canvas;
  cv::cvtColor(to_eight_bits(read), canvas, cv::COLOR_GRAY2BGR);
  const int thick = std::max(1, std::max(canvas.cols, canvas.rows) / 700);
  for (const auto& [edge, count] : edges_of(quads)) {
    const bool contour = count == 1;
    cv::line(canvas, fixed(corner(pixels, edge.first)), fixed(corner(pixels, edge.second)),
             contour ? cv::Scalar(0, 160, 255) : cv::Scalar(230, 190, 60), contour ? 2 * thick : thick, cv::LINE_AA,
             shift);
  }
  const std::vector<cv::Scalar> colours{{80, 80, 255}, {90, 220, 90}, {255, 120, 220}, {255, 200, 80}, {120, 240, 255}};
  std::size_t group = 0;
  for (const auto& [name, nodes] : quads.node_groups) {
    if (nodes.empty() || nodes.size() * 2 > static_cast<std::size_t>(quads.nodes.rows())) continue;
    const auto& colour = colours[group++ % colours.size()];
    cv::Point2d centre(0, 0);
    for (int node : nodes) {
      centre += corner(pixels, node) * (1.0 / static_cast<double>(nodes.size()));
      cv::circle(canvas, fixed(corner(pixels, node)), (3 * thick) << shift, colour, cv::FILLED, cv::LINE_AA, shift);
    }
    const double size = 0.7 * thick;
    int baseline = 0;
    const auto extent = cv::getTextSize(name, cv::FONT_HERSHEY_SIMPLEX, size, thick, &baseline);
    const cv::Point at(
        std::clamp(static_cast<int>(centre.x) - extent.width / 2, 2, std::max(2, canvas.cols - extent.width)),
        std::clamp(static_cast<int>(centre.y) - 8 * thick, extent.height + 2, canvas.rows - 4));
    cv::rectangle(canvas, {at.x - 4, at.y - extent.height - 4}, {at.x + extent.width + 4, at.y + baseline}, black,
                  cv::FILLED);
    cv::putText(canvas, name, at, cv::FONT_HERSHEY_SIMPLEX, size, colour, thick, cv::LINE_AA);
  }
  save(picture, canvas);
}

void draw_map(const std::filesystem::path& picture, std::span<const double> values, int columns, int rows,
              const ColourScale& scale) {
  if (values.size() != static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows))
    throw std::invalid_argument("draw_map: values are not [rows x columns]");
  const Colours colours(values, scale);
  cv::Mat pixels(rows, columns, CV_8UC3);
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      pixels.at<cv::Vec3b>(row, column) = colours(
          values[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(column)]);
  if (const int factor = 400 / std::max(columns, rows); factor > 1)
    cv::resize(pixels, pixels, {}, factor, factor, cv::INTER_NEAREST);
  save(picture, with_legend(pixels, colours, scale.legend));
}

void draw_field(const std::filesystem::path& picture, const mesh::Mesh& quads, std::span<const double> positions,
                std::span<const double> values, const ColourScale& scale) {
  const auto nodes = static_cast<std::size_t>(quads.nodes.rows()), cells = static_cast<std::size_t>(quads.cells.rows());
  const bool nodal = values.size() == nodes;
  if (positions.size() != 2 * nodes || (!nodal && values.size() != cells))
    throw std::invalid_argument("draw_field: wrong number of positions or values");
  cv::Rect2d box;
  for (Eigen::Index i = 0; i < quads.cells.rows() * 4; ++i) {
    const auto at = corner(positions, quads.cells(i / 4, i % 4));
    const cv::Rect2d point(at.x, at.y, 1e-300, 1e-300);
    box = i == 0 ? point
                 : cv::Rect2d(cv::Point2d(std::min(box.x, point.x), std::min(box.y, point.y)),
                              cv::Point2d(std::max(box.br().x, point.x), std::max(box.br().y, point.y)));
  }
  const double size = std::max(box.width, box.height), magnification = 700.0 / std::max(size, 1e-300);
  const auto place = [&](const cv::Point2d& p) {
    return cv::Point2d((p.x - box.x) * magnification, (p.y - box.y) * magnification);
  };
  cv::Mat canvas(static_cast<int>(box.height * magnification) + 2, static_cast<int>(box.width * magnification) + 2,
                 CV_8UC3, white);
  const Colours colours(values, scale);
  for (std::size_t c = 0; c < cells; ++c) {
    std::array<cv::Point2d, 4> p;
    std::array<double, 4> v{};
    for (int k = 0; k < 4; ++k) {
      const int node = quads.cells(static_cast<Eigen::Index>(c), k);
      p[static_cast<std::size_t>(k)] = place(corner(positions, node));
      v[static_cast<std::size_t>(k)] = nodal ? values[static_cast<std::size_t>(node)] : values[c];
    }
    const int parts = nodal ? 6 : 1;
    const auto bilinear = [](const auto& q, double s, double t) {
      return q[0] * ((1 - s) * (1 - t)) + q[1] * (s * (1 - t)) + q[2] * (s * t) + q[3] * ((1 - s) * t);
    };
    for (int i = 0; i < parts; ++i)
      for (int j = 0; j < parts; ++j) {
        const double s0 = double(i) / parts, s1 = double(i + 1) / parts, t0 = double(j) / parts,
                     t1 = double(j + 1) / parts;
        const std::array<cv::Point, 4> polygon{fixed(bilinear(p, s0, t0)), fixed(bilinear(p, s1, t0)),
                                               fixed(bilinear(p, s1, t1)), fixed(bilinear(p, s0, t1))};
        const auto colour = colours(bilinear(v, (s0 + s1) / 2, (t0 + t1) / 2));
        cv::fillConvexPoly(canvas, polygon.data(), 4, {double(colour[0]), double(colour[1]), double(colour[2])},
                           cv::LINE_8, shift);
      }
  }
  save(picture, with_legend(canvas, colours, scale.legend));
}

namespace {

mesh::Mesh surface_of(const ResultsFile& file) {
  mesh::Mesh mesh;
  const auto nodes = file.read("surface/nodes");
  const auto cells = file.read_integers("surface/cells");
  mesh.nodes = Eigen::Map<const mesh::Nodes>(nodes.data(), static_cast<Eigen::Index>(nodes.size() / 3), 3);
  mesh.cells = Eigen::Map<const mesh::Cells>(cells.data(), static_cast<Eigen::Index>(cells.size() / 4), 4);
  return mesh;
}

}  // namespace

std::vector<std::filesystem::path> draw_pictures(const ResultsFile& file, const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> pictures;
  const auto numbers = file.read_integers("frames/number");
  auto done = file.frames_done("dic");
  while (!done.empty() && !std::isfinite(file.read("dic/displacement", done.back())[0])) done.pop_back();  // lost
  if (!done.empty()) {
    const auto mesh = surface_of(file);
    const auto u = file.read("dic/displacement", done.back());
    const std::size_t axis = file.read_text("case/axis") == "x" ? 0 : 1;
    std::vector<double> positions, values;
    for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
      positions.insert(positions.end(), {mesh.nodes(i, 0), -mesh.nodes(i, 1)});
      values.push_back(u[3 * static_cast<std::size_t>(i) + axis]);
    }
    pictures.push_back(folder / fmt::format("dic_displacement_frame_{:04d}.png", numbers[done.back()]));
    draw_field(pictures.back(), mesh, positions, values,
               {.legend = fmt::format("DIC displacement along {}, frame {} [{}]", axis == 0 ? "x" : "y",
                                      numbers[done.back()], file.unit("dic/displacement")),
                .diverging = false});
  }
  return pictures;
}

}  // namespace imic3d::io
