#include "imic3d/io/loop_page.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <iterator>

#include "html.hpp"
#include "imic3d/io/run_results.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

using nlohmann::json;

std::vector<double> numbers(const json& list) {
  std::vector<double> all;
  for (const auto& one : list) all.push_back(one.is_number() ? one.get<double>() : std::nan(""));
  return all;
}

std::string joined(const json& names) {
  std::string text;
  for (const auto& one : names) text += (text.empty() ? "" : ", ") + one.get<std::string>();
  return text.empty() ? "none" : text;
}

/// What the verdict is about: the effects that were added, and with the last one those that it cannot be told from.
std::string subject(const json& summary) {
  std::string text;
  for (const auto& one : summary["named"]) {
    const bool uncertain = summary["verdict"] == "ambiguous" && one == summary["named"].back();
    text += (text.empty() ? ": " : " + ") + (uncertain ? "one of (" + escaped(joined(summary["set"])) + ")" : escaped(one.get<std::string>()));
  }
  return text;
}

/// Size ± standard deviation of each parameter of a candidate.
std::string sizes(const json& candidate, const char* value, bool with_deviation) {
  std::string text;
  for (const auto& one : candidate["sizes"]) {
    const double deviation = one["standard_deviation"];
    const std::string unit = one["unit"];
    text += (text.empty() ? "" : "<br>") + escaped(one["parameter"].get<std::string>()) + " " +
            (with_deviation ? shown_with(one[value], deviation) + " ± " + shown(deviation, 2) : shown(std::abs(one[value].get<double>()), 2)) +
            (unit == "-" ? "" : " " + escaped(unit));
  }
  return text;
}

std::string candidates(const json& model) {
  std::vector<json> all(model["candidates"].begin(), model["candidates"].end());
  std::stable_sort(all.begin(), all.end(), [](const json& a, const json& b) { return a["z"].get<double>() > b["z"].get<double>(); });
  std::string rows = "<table>\n<tr><th>candidate</th><th>link</th><th>z</th><th>κ</th><th>estimated size</th><th>smallest size found</th><th>predicted drop of χ²</th></tr>\n";
  for (const auto& one : all) {
    const bool hidden = one["kappa"].get<double>() < 0.05;
    rows += fmt::format("<tr{}><td>{}</td><td class=\"left\">{}</td><td>{}{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n", hidden ? " class=\"held\"" : "",
                        escaped(one["name"].get<std::string>()), escaped(one["link"].get<std::string>()), shown(one["z"], 3), one["significant"].get<bool>() ? " *" : one["contradicted"].get<bool>() ? " (*)" : "",
                        shown(one["kappa"], 2), hidden ? "invisible" : sizes(one, "size", true), one["kappa"].get<double>() < 1e-9 ? "none" : sizes(one, "detectable", false), shown(one["predicted_drop"], 3));
  }
  return rows + fmt::format("</table>\n<p class=\"note\">* beyond the limit {} that noise alone exceeds in 4 of 100 tests over all candidates, in brackets where with this size the held-out frames are explained worse: no more than chance; κ: what the free parameters leave of the mark</p>\n",
                            shown(model["threshold"], 3));
}

/// Of bars: rms per group, and the residual of every bar over its strain, before and after.
std::string curves(const json& summary) {
  std::string out = "<h2>Bars</h2>\n<table>\n<tr><th>group</th><th></th><th>rows</th><th>rms before</th><th>after</th><th>unit</th></tr>\n";
  for (const auto& group : summary["groups"])
    out += fmt::format("<tr{}><td>{}</td><td class=\"left\">{}</td><td>{}</td><td>{}</td><td>{}</td><td class=\"left\">{}</td></tr>\n", group["held_out"].get<bool>() ? " class=\"held\"" : "",
                       escaped(group["name"].get<std::string>()), group["held_out"].get<bool>() ? "held out" : "fitted", group["rows"].get<long>(), shown(group["before"], 3), shown(group["after"], 3),
                       escaped(group["unit"].get<std::string>()));
  out += "</table>\n<div class=\"plots\">\n";
  std::vector<std::string> done;
  for (const auto& first : summary["curves"]) {
    const auto group = first["group"].get<std::string>();
    if (std::find(done.begin(), done.end(), group) != done.end()) continue;
    done.push_back(group);
    for (const char* when : {"before", "after"}) {
      std::vector<Curve> lines;
      for (const auto& one : summary["curves"]) {
        if (one["group"] != group) continue;
        const auto measured = numbers(one["measured"]), predicted = numbers(one[when]);
        std::vector<double> gap;
        for (std::size_t i = 0; i < measured.size(); ++i) gap.push_back(measured[i] - predicted[i]);
        lines.push_back({"", numbers(one["strain"]), gap, one["held_out"].get<bool>() ? "#888888" : std::string(when) == "before" ? "#b2182b" : "#1f5fa8", true, false, 1.0});
      }
      out += svg({.title = fmt::format("{}: measured − predicted, {} (grey: held out)", group, when), .x_label = "logarithmic strain",
                  .y_label = fmt::format("stress [{}]", summary["groups"][0]["unit"].get<std::string>()), .curves = lines});
    }
  }
  return out + "</div>\n";
}

/// The light: what the correlation leaves of the grey levels, and what was done about it.
std::string light(const json& summary) {
  std::string out = fmt::format("<h2>Light</h2>\n<p>{}: {}</p>\n", escaped(summary["verdict"].get<std::string>()), escaped(summary["sentence"].get<std::string>()));
  out += fmt::format("<p class=\"note\">χ {} before, {} after what was added (noise alone up to {}); held-out frames {}, {} ({}).</p>\n", shown(summary["before"]["chi"]["fitted"], 3), shown(summary["after"]["chi"]["fitted"], 3),
                     shown(summary["after"]["chi"]["null_fitted"], 3), shown(summary["before"]["chi"]["held_out"], 3), shown(summary["after"]["chi"]["held_out"], 3), shown(summary["after"]["chi"]["null_held_out"], 3));
  if (const auto& map = summary["map"]; map.contains("place"))
    out += fmt::format("<p>What remains is largest about ({}, {}) in frame {}, camera {}: {} times the noise, where one null test of a hundred exceeds {} somewhere; {:.1f} % of places and frames are beyond that.</p>\n",
                       shown(map["place"][0], 3), shown(map["place"][1], 3), map["frame"].get<int>(), escaped(map["camera"].get<std::string>()), shown(map["largest"], 3), shown(map["limit"], 3),
                       100.0 * map["share_beyond_limit"].get<double>());
  const auto frames = numbers(summary["frames"]);
  out += "<div class=\"plots\">\n";
  out += svg({.title = "Light: error of each frame", .x_label = "frame", .y_label = "χ",
              .curves = {{"before", frames, numbers(summary["before"]["chi"]["frames"]), "#b2182b", true, true},
                         {"after", frames, numbers(summary["after"]["chi"]["frames"]), "#1f5fa8", true, true},
                         {"noise alone, 95 %", frames, numbers(summary["after"]["chi"]["null_frames"]), "#888888", true, false}}});
  for (const auto& [name, camera] : summary["cameras"].items()) {
    std::vector<Curve> curves = {{"as correlated", frames, numbers(camera["rms"]), "#b2182b", true, true}};
    if (summary.contains("corrected")) curves.push_back({"with the light fitted", frames, numbers(summary["corrected"]["after"]["cameras"][name]["rms"]), "#1f5fa8", true, true});
    out += svg({.title = "Grey levels left, " + name, .x_label = "frame", .y_label = "rms [grey level]", .curves = curves});
  }
  out += "</div>\n" + candidates(summary["before"]);
  return out;
}

}  // namespace

void write_loop_page(const std::filesystem::path& page, const json& summary, const std::vector<ReportPicture>& pictures) {
  const json &before = summary["before"], &after = summary["after"];
  const auto frames = numbers(summary["frames"]);
  std::string out = fmt::format("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{1}</style></head><body>\n<h1>{0}</h1>\n", escaped(summary["title"].get<std::string>()), page_style);
  out += fmt::format("<p><strong>{}</strong></p>\n<p>Verdict: <strong>{}</strong>{}. Held-out frames: {}.</p>\n", escaped(summary["sentence"].get<std::string>()), escaped(summary["verdict"].get<std::string>()),
                     subject(summary) + (summary.contains("light") ? "; of the light: <strong>" + escaped(summary["light"]["verdict"].get<std::string>()) + "</strong>" : ""),
                     escaped(summary["held_out"].dump()));

  if (summary.contains("doubts"))
    for (const auto& doubt : summary["doubts"]) out += fmt::format("<p class=\"note\">{}</p>\n", escaped(doubt.get<std::string>()));
  out += "<h2>Error before and after</h2>\n<table>\n<tr><th></th><th>before</th><th>after</th><th>noise alone, 95 %</th></tr>\n";
  for (const auto& [key, null, what] : {std::array{"fitted", "null_fitted", "χ of the fitted frames"}, std::array{"held_out", "null_held_out", "χ of the held-out frames"}})
    out += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n", what, shown(before["chi"][key], 4), shown(after["chi"][key], 4), shown(after["chi"][null], 4));
  if (before["chi"].contains("checkerboard"))
    out += fmt::format("<tr><td>χ of the white squares, from the black ones</td><td>{}</td><td>{}</td><td>{}</td></tr>\n", shown(before["chi"]["checkerboard"], 4), shown(after["chi"]["checkerboard"], 4),
                       shown(after["chi"]["null_checkerboard"], 4));
  if (before["chi"].contains("cameras"))
    for (const auto& [name, was] : before["chi"]["cameras"].items()) {
      const auto& now = after["chi"]["cameras"][name];
      out += fmt::format("<tr><td>χ of the {} cameras, from the others</td><td>{}</td><td>{}</td><td>{}</td></tr>\n", escaped(name), shown(was["left_out"], 4), shown(now["left_out"], 4), shown(now["null"], 4));
    }
  out += "</table>\n<div class=\"plots\">\n";
  out += svg({.title = "Error of each frame", .x_label = "frame", .y_label = "χ",
              .curves = {{"before", frames, numbers(before["chi"]["frames"]), "#b2182b", true, true},
                         {"after", frames, numbers(after["chi"]["frames"]), "#1f5fa8", true, true},
                         {"noise alone, 95 %", frames, numbers(after["chi"]["null_frames"]), "#888888", true, false}}});
  if (summary.contains("force_residual"))
    out += svg({.title = "Force, measured − predicted", .x_label = "frame", .y_label = fmt::format("force [{}]", summary["force_residual"]["unit"].get<std::string>()),
                .curves = {{"before", frames, numbers(summary["force_residual"]["before"]), "#b2182b", true, true},
                           {"after", frames, numbers(summary["force_residual"]["after"]), "#1f5fa8", true, true}}});
  if (summary["remainder"]["time"].size() == frames.size())
    out += svg({.title = fmt::format("What remains: first mode over time, {:.0f} % of the square", 100.0 * summary["remainder"]["share_of_first_mode"].get<double>()), .x_label = "frame", .y_label = "[noise]",
                .curves = {{"", frames, numbers(summary["remainder"]["time"]), "#1f5fa8", true, true}}});
  out += "</div>\n";
  if (summary["remainder"].contains("map")) {
    const auto& map = summary["remainder"]["map"];
    std::string with;
    for (const auto& [name, r] : summary["remainder"]["goes_with"].items()) with += fmt::format("{}{} {:.2f}", with.empty() ? "" : ", ", name, r.get<double>());
    out += fmt::format("<p>What remains is largest at ({}, {}){} in frame {}: {} times the noise there, where one null test of a hundred exceeds {} somewhere; {:.1f} % of nodes and frames are beyond that. Correlation of its first mode "
                       "with {}.</p>\n", shown(map["place"][0], 3), shown(map["place"][1], 3), map.contains("face") ? fmt::format(" on the {}", map["face"].get<std::string>()) : std::string(), map["frame"].get<int>(), shown(map["largest"], 3), shown(map["limit"], 3), 100.0 * map["share_beyond_limit"].get<double>(), with);
  }

  out += "<h2>Parameters</h2>\n<table>\n<tr><th>parameter</th><th>before</th><th></th><th>after</th><th></th><th>unit</th></tr>\n";
  for (const auto& [name, now] : after["parameters"].items()) {
    const bool new_one = !before["parameters"].contains(name);
    out += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>± {}</td><td class=\"left\">{}</td></tr>\n", escaped(name),
                       new_one ? "–" : shown_with(before["parameters"][name]["value"], before["parameters"][name]["standard_deviation"]), new_one ? "new" : "→",
                       shown_with(now["value"], now["standard_deviation"]), shown(now["standard_deviation"], 2), escaped(now["unit"].get<std::string>()));
  }
  out += "</table>\n<h2>Candidates under the declared model</h2>\n" + candidates(before);
  int round = 0;
  for (const auto& one : summary["rounds"]) {
    ++round;
    if (one["trials"].empty()) continue;  // none stood out: what is left is in the energy
    out += fmt::format("<h2>Round {}: added on trial</h2>\n<table>\n<tr><th>candidate</th><th>χ fitted</th><th>χ held out</th><th>largest score left</th><th>limit</th><th></th></tr>\n", round);
    for (const auto& trial : one["trials"]) {
      const bool fitted = trial.contains("chi");
      out += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{} sd</td><td>{}</td><td class=\"left\">{}</td></tr>\n", escaped(trial["candidate"].get<std::string>()),
                         fitted ? shown(trial["chi"]["fitted"], 4) : "–", fitted ? shown(trial["chi"]["held_out"], 4) : "–", fitted ? shown(trial["omnibus"]["deviations"], 3) : "–",
                         fitted ? shown(trial["omnibus"]["threshold"], 3) : "–",
                         !trial["plausible"].get<bool>() ? escaped("not plausible: " + trial["objection"].get<std::string>()) : trial["sufficient"].get<bool>() ? "nothing is left" : "something is left");
    }
    out += "</table>\n";
  }
  if (!after["candidates"].empty() && !summary["named"].empty()) out += "<h2>Candidates under the final model</h2>\n" + candidates(after);
  out += fmt::format("<h2>What this test cannot see</h2>\n<p>{}</p>\n", escaped(joined(summary["invisible"])));
  out += "<p class=\"note\">These may be there, of any size; the column of the smallest size found says what each would have to be to be noticed.</p>\n";

  if (summary.contains("light")) out += light(summary["light"]);
  if (summary.contains("curves")) out += curves(summary);
  if (!pictures.empty()) out += "<h2>Pictures</h2>\n<div class=\"pictures\">\n";
  for (const auto& picture : pictures) {
    std::ifstream stream(picture.file, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(stream)), {});
    if (!bytes.empty()) out += fmt::format("<figure><img src=\"data:image/png;base64,{}\" alt=\"{}\"><figcaption>{}</figcaption></figure>\n", base64(bytes), escaped(picture.caption), escaped(picture.caption));
  }
  if (!pictures.empty()) out += "</div>\n";
  write_text_file(page, out + "</body></html>\n");
}

}  // namespace imic3d::io
