#include "svg_plot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace imic3d::io {

namespace {

struct Range {
  double lower = std::numeric_limits<double>::infinity(), upper = -std::numeric_limits<double>::infinity();

  void include(double value) {
    lower = std::min(lower, value);
    upper = std::max(upper, value);
  }
  /// A little air on both sides, and never empty.
  void widen() {
    if (!(lower <= upper)) *this = {0.0, 1.0};
    const double air = upper > lower ? 0.05 * (upper - lower) : std::max(1e-3 * std::abs(upper), 1e-12);
    lower -= air;
    upper += air;
  }
};

std::string tick_label(double value, double step) {
  if (std::abs(value) < 1e-9 * step) return "0";
  return fmt::format("{:.6g}", value);
}

}  // namespace

std::string escaped(const std::string& text) {
  std::string safe;
  for (char c : text) {
    switch (c) {
      case '&': safe += "&amp;"; break;
      case '<': safe += "&lt;"; break;
      case '>': safe += "&gt;"; break;
      case '"': safe += "&quot;"; break;
      default: safe += c;
    }
  }
  return safe;
}

std::vector<double> round_ticks(double lower, double upper, int count) {
  const double rough = (upper - lower) / count;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  const double ratio = rough / power;
  const double step = power * (ratio < 1.5 ? 1.0 : ratio < 3.5 ? 2.0 : ratio < 7.5 ? 5.0 : 10.0);
  std::vector<double> ticks;
  for (double i = std::ceil(lower / step - 1e-9); i * step <= upper + 1e-9 * step; i += 1.0) ticks.push_back(i * step);
  return ticks;
}

std::string svg(const Plot& plot) {
  Range x, y;
  const auto include = [&](const std::vector<double>& xs, const std::vector<double>& ys) {
    for (std::size_t i = 0; i < xs.size() && i < ys.size(); ++i) {
      if (!std::isfinite(xs[i]) || !std::isfinite(ys[i])) continue;
      x.include(xs[i]);
      y.include(ys[i]);
    }
  };
  for (const auto& curve : plot.curves) include(curve.x, curve.y);
  for (const auto& band : plot.bands) include(band.x, band.lower), include(band.x, band.upper);
  x.widen();
  y.widen();
  const double left = 74, right = plot.width - 14, top = 42, bottom = plot.height - 46;
  const auto px = [&](double value) { return left + (value - x.lower) / (x.upper - x.lower) * (right - left); };
  const auto py = [&](double value) { return bottom - (value - y.lower) / (y.upper - y.lower) * (bottom - top); };

  std::string out =
      fmt::format("<svg viewBox=\"0 0 {} {}\" width=\"{}\" height=\"{}\" role=\"img\" aria-label=\"{}\">\n", plot.width,
                  plot.height, plot.width, plot.height, escaped(plot.title));
  out += fmt::format("<text class=\"plot-title\" x=\"{}\" y=\"14\">{}</text>\n", left, escaped(plot.title));
  for (const auto& [from, to] : plot.shaded) {
    const double begin = std::clamp(px(from), left, right), end = std::clamp(px(to), left, right);
    out += fmt::format("<rect class=\"shaded\" x=\"{:.1f}\" y=\"{}\" width=\"{:.1f}\" height=\"{}\"/>\n", begin, top,
                       end - begin, bottom - top);
  }
  for (const auto& band : plot.bands) {
    std::string path, back;
    for (std::size_t i = 0; i < band.x.size() && i < band.lower.size() && i < band.upper.size(); ++i) {
      if (!std::isfinite(band.lower[i]) || !std::isfinite(band.upper[i])) continue;
      path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : " L", px(band.x[i]), py(band.upper[i]));
      back.insert(0, fmt::format(" L{:.1f} {:.1f}", px(band.x[i]), py(band.lower[i])));
    }
    if (!path.empty())
      out += fmt::format("<path class=\"band\" d=\"{}{} Z\" fill=\"{}\" fill-opacity=\"0.8\"/>\n", path, back,
                         band.colour);
  }
  const auto x_ticks = round_ticks(x.lower, x.upper, plot.width < 300 ? 3 : 6), y_ticks = round_ticks(y.lower, y.upper);
  for (double value : x_ticks)
    out += fmt::format(
        "<line class=\"grid\" x1=\"{0:.1f}\" x2=\"{0:.1f}\" y1=\"{1}\" y2=\"{2}\"/>"
        "<text class=\"tick\" x=\"{0:.1f}\" y=\"{3}\" text-anchor=\"middle\">{4}</text>\n",
        px(value), top, bottom, bottom + 16, tick_label(value, x.upper - x.lower));
  for (double value : y_ticks)
    out += fmt::format(
        "<line class=\"grid\" x1=\"{0}\" x2=\"{1}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\"/>"
        "<text class=\"tick\" x=\"{3}\" y=\"{4:.1f}\" text-anchor=\"end\">{5}</text>\n",
        left, right, py(value), left - 6, py(value) + 4, tick_label(value, y.upper - y.lower));
  out += fmt::format("<rect class=\"frame\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>\n", left, top, right - left,
                     bottom - top);
  out += fmt::format("<text class=\"axis\" x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\n", (left + right) / 2,
                     plot.height - 10, escaped(plot.x_label));
  out +=
      fmt::format("<text class=\"axis\" transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>\n",
                  (top + bottom) / 2, escaped(plot.y_label));
  for (const auto& curve : plot.curves) {
    std::string path, dots;
    bool pen_down = false;
    for (std::size_t i = 0; i < curve.x.size() && i < curve.y.size(); ++i) {
      if (!std::isfinite(curve.x[i]) || !std::isfinite(curve.y[i])) {
        pen_down = false;
        continue;
      }
      path += fmt::format("{}{:.1f} {:.1f}", pen_down ? " L" : " M", px(curve.x[i]), py(curve.y[i]));
      pen_down = true;
      if (curve.dots)
        dots += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"3\" fill=\"{}\"/>", px(curve.x[i]), py(curve.y[i]),
                            curve.colour);
    }
    if (curve.line && !path.empty())
      out += fmt::format("<path d=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\"/>\n", path.substr(1),
                         curve.colour, curve.width);
    out += dots + "\n";
  }
  double at = right - 8;
  const auto add_to_legend = [&](const std::string& label, const std::string& colour) {
    if (label.empty()) return;
    out += fmt::format("<text class=\"tick\" x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>", at, top - 8,
                       escaped(label));
    at -= 6.3 * static_cast<double>(label.size()) + 12;
    out += fmt::format("<circle cx=\"{}\" cy=\"{}\" r=\"4\" fill=\"{}\"/>\n", at, top - 12, colour);
    at -= 14;
  };
  for (auto it = plot.bands.rbegin(); it != plot.bands.rend(); ++it) add_to_legend(it->label, it->colour);
  for (auto it = plot.curves.rbegin(); it != plot.curves.rend(); ++it) add_to_legend(it->label, it->colour);
  return out + "</svg>\n";
}

}  // namespace imic3d::io
