#pragma once
// Simple curves as SVG text.

#include <string>
#include <utility>
#include <vector>

namespace imic3d::io {

/// One curve; points with a NaN are left out and break the line.
struct Curve {
  std::string label;
  std::vector<double> x, y;
  std::string colour = "#1f5fa8";
  bool line = true, dots = false;
  double width = 1.8;  ///< of the line [px]
};

/// An area between two curves, behind all of them.
struct Band {
  std::string label;
  std::vector<double> x, lower, upper;
  std::string colour = "#dcdcdc";
};

struct Plot {
  std::string title, x_label, y_label;
  std::vector<Curve> curves;
  std::vector<Band> bands{};
  std::vector<std::pair<double, double>> shaded{};  ///< stretches of x, from top to bottom
  int width = 520, height = 320;                    ///< [px]
};

/// The plot as one <svg> element with axes, round ticks and a legend.
[[nodiscard]] std::string svg(const Plot& plot);

/// Text with &, <, > and quotes made safe for HTML and SVG.
[[nodiscard]] std::string escaped(const std::string& text);

/// Round positions between lower and upper, about `count` of them.
[[nodiscard]] std::vector<double> round_ticks(double lower, double upper, int count = 5);

}  // namespace imic3d::io
