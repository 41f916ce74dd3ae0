#include "loop_plots.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

using nlohmann::json;

constexpr const char *colour_before = "#b2182b", *colour_after = "#1f5fa8", *colour_of_load = "#222222",
                     *colour_held_out = "#888888";

/// The frames that are held out, each with half of the way to its neighbours.
std::vector<std::pair<double, double>> held_out_frames(const json& summary) {
  const auto frames = numbers(summary["frames"]), held = numbers(summary["held_out"]);
  std::vector<std::pair<double, double>> all;
  for (std::size_t t = 0; t < frames.size(); ++t) {
    if (std::find(held.begin(), held.end(), frames[t]) == held.end()) continue;
    const double before = t > 0 ? frames[t] - frames[t - 1] : 1.0,
                 after = t + 1 < frames.size() ? frames[t + 1] - frames[t] : before;
    all.emplace_back(frames[t] - 0.5 * before, frames[t] + 0.5 * after);
  }
  return all;
}

std::string frame_label(const json& summary) {
  return summary.contains("curves")  ? "bars and pieces of curves, in the order of the case"
         : summary.contains("tests") ? "frames of all tests, one after another"
                                     : "frame";
}

/// One curve where nothing changed.
std::vector<Curve> before_and_after(const std::vector<double>& frames, const std::vector<double>& before,
                                    const std::vector<double>& after) {
  if (before == after) return {{"declared model", frames, before, colour_after, true, true}};
  return {{"before", frames, before, colour_before, true, true}, {"after", frames, after, colour_after, true, true}};
}

std::string force_plot(const json& summary) {
  const json& force = summary["force_residual"];
  const auto frames = numbers(summary["frames"]), rms = numbers(force["null_rms"]);
  Plot plot{.title = "Force, measured − predicted",
            .x_label = "frame",
            .y_label = fmt::format("force [{}]", force["unit"].get<std::string>()),
            .curves = before_and_after(frames, numbers(force["before"]), numbers(force["after"])),
            .shaded = held_out_frames(summary)};
  if (rms.size() == frames.size()) {
    Band band{.label = "noise alone, 95 %", .x = frames, .lower = {}, .upper = {}};
    for (double one : rms) band.lower.push_back(-1.96 * one), band.upper.push_back(1.96 * one);
    plot.bands.push_back(std::move(band));
  }
  return svg(plot);
}

std::string load_plot(const json& summary) {
  return svg({.title = "Load",
              .x_label = "",
              .y_label = fmt::format("force [{}]", summary["load"]["unit"].get<std::string>()),
              .curves = {{"", numbers(summary["frames"]), numbers(summary["load"]["force"]), colour_of_load}},
              .shaded = held_out_frames(summary),
              .height = 200});
}

std::string mode_plot(const json& summary) {
  return svg(
      {.title = fmt::format("What remains: first mode over time, {:.0f} % of the square",
                            100.0 * summary["remainder"]["share_of_first_mode"].get<double>()),
       .x_label = frame_label(summary),
       .y_label = "[noise]",
       .curves = {{"", numbers(summary["frames"]), numbers(summary["remainder"]["time"]), colour_after, true, true}},
       .shaded = held_out_frames(summary),
       .height = 200});
}

}  // namespace

bool searched(const json& summary) { return summary.value("searched", true); }

std::vector<double> numbers(const json& list) {
  std::vector<double> all;
  for (const auto& one : list) all.push_back(one.is_number() ? one.get<double>() : std::nan(""));
  return all;
}

std::string chi_plot(const json& summary, const std::string& title) {
  const json &before = summary["before"]["chi"], &after = summary["after"]["chi"];
  const auto frames = numbers(summary["frames"]);
  return svg(
      {.title = title,
       .x_label = frame_label(summary),
       .y_label = "χ",
       .curves = before_and_after(frames, numbers(before["frames"]), numbers(after["frames"])),
       .bands = {{"noise alone, 95 %", frames, std::vector<double>(frames.size(), 0.0), numbers(after["null_frames"])}},
       .shaded = held_out_frames(summary)});
}

std::string frame_plots(const json& summary) {
  std::string out = "<div class=\"plots\">\n<div>";
  if (summary.contains("load")) out += load_plot(summary);
  out += chi_plot(summary, "Error of each frame") + "</div>\n<div>";
  if (summary.contains("force_residual")) out += force_plot(summary);
  if (summary["remainder"]["time"].size() == summary["frames"].size()) out += mode_plot(summary);
  return out + "</div>\n</div>\n";
}

std::string bar_plots(const json& summary) {
  std::string out;
  std::vector<std::string> done;
  for (const auto& first : summary["curves"]) {
    const auto group = first["group"].get<std::string>();
    if (std::find(done.begin(), done.end(), group) != done.end()) continue;
    done.push_back(group);
    for (const char* when : {"before", "after"}) {
      if (when == std::string_view("before") && !searched(summary)) continue;
      std::vector<Curve> lines;
      for (const auto& one : summary["curves"]) {
        if (one["group"] != group) continue;
        const auto measured = numbers(one["measured"]), predicted = numbers(one[when]);
        std::vector<double> gap;
        for (std::size_t i = 0; i < measured.size(); ++i) gap.push_back(measured[i] - predicted[i]);
        lines.push_back({"", numbers(one["strain"]), gap,
                         one["held_out"].get<bool>()     ? colour_held_out
                         : std::string(when) == "before" ? colour_before
                                                         : colour_after,
                         true, false, 1.0});
      }
      out += svg({.title = fmt::format("{}: measured − predicted, {} (grey: held out)", group, when),
                  .x_label = "logarithmic strain",
                  .y_label = fmt::format("stress [{}]", summary["groups"][0]["unit"].get<std::string>()),
                  .curves = lines});
    }
  }
  return "<div class=\"plots\">\n" + out + "</div>\n";
}

}  // namespace imic3d::io
