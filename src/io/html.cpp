#include "html.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace imic3d::io {

const char* const page_style = R"css(
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif; color: #1c1c1c; background: #fff;
       max-width: 1100px; margin: 2em auto; padding: 0 1.5em; }
h1 { font-size: 1.7em; margin: 0 0 .1em; } h2 { font-size: 1.2em; margin: 2em 0 .5em; border-bottom: 1px solid #ddd; }
h3 { font-size: 1em; margin: 1.2em 0 .3em; }
.note { color: #666; margin: 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; display: block; max-width: 100%; overflow-x: auto; }
th, td { padding: .25em .55em; text-align: right; border-bottom: 1px solid #e6e6e6; white-space: nowrap; }
th { font-weight: 600; color: #444; border-bottom: 1px solid #999; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
td.left, th.left { text-align: left; } td.words { text-align: left; white-space: normal; min-width: 11em; } .dense td, .dense th { padding-right: .4em; } .dense td:first-child { white-space: normal; } tr.held td { color: #7a5a00; }
.plots { display: flex; flex-wrap: wrap; gap: 1em; } .plots > div { display: flex; flex-direction: column; }
svg { font-family: inherit; } .plot-title { font-size: 13px; font-weight: 600; } .tick { font-size: 11px; fill: #444; }
.axis { font-size: 12px; fill: #222; } .grid { stroke: #eee; } .shaded { fill: #f3ecd8; } .frame { fill: none; stroke: #999; }
figure { margin: 0 0 1.5em; } figure img { max-width: 100%; border: 1px solid #ddd; } figcaption { color: #444; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 1em; align-items: start; }
pre { background: #f6f6f6; padding: 1em; overflow-x: auto; font-size: 13px; } summary { cursor: pointer; color: #2166ac; }
)css";

std::string base64(const std::string& bytes) {
  constexpr const char* letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const auto byte = [&](std::size_t k) {
      return i + k < bytes.size() ? static_cast<unsigned>(static_cast<unsigned char>(bytes[i + k])) : 0U;
    };
    const unsigned triple = byte(0) << 16 | byte(1) << 8 | byte(2);
    text += letters[triple >> 18 & 63];
    text += letters[triple >> 12 & 63];
    text += i + 1 < bytes.size() ? letters[triple >> 6 & 63] : '=';
    text += i + 2 < bytes.size() ? letters[triple & 63] : '=';
  }
  return text;
}

std::string shown(double value, int digits) {
  if (!std::isfinite(value)) return "–";
  const double size = std::abs(value);
  if (size != 0.0 && (size >= 1e7 || size < 1e-4)) return fmt::format("{:.{}e}", value, digits - 1);
  const int before = size > 0.0 ? static_cast<int>(std::floor(std::log10(size))) + 1 : 1;
  return fmt::format("{:.{}f}", value, std::max(0, digits - before));
}

std::string shown_with(double value, double deviation) {
  if (!std::isfinite(value) || !std::isfinite(deviation) || deviation <= 0.0) return shown(value);
  const int last = static_cast<int>(std::floor(std::log10(deviation))) - 1;
  const int digits = static_cast<int>(std::floor(std::log10(std::max(std::abs(value), deviation)))) - last + 1;
  return shown(value, std::clamp(digits, 2, 12));
}

}  // namespace imic3d::io
