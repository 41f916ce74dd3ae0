#include "imic3d/io/loop_page.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <iterator>

#include "html.hpp"
#include "imic3d/io/run_results.hpp"
#include "loop_candidates.hpp"
#include "loop_plots.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

using nlohmann::json;

/// What the verdict is about: the effects that were added, and with the last one those that it cannot be told from.
std::string subject(const json& summary) {
  std::string words;
  for (const auto& one : summary["named"]) {
    const bool uncertain = summary["verdict"] == "ambiguous" && one == summary["named"].back();
    words += (words.empty() ? ": " : " + ") +
             (uncertain ? "one of (" + escaped(joined(summary["set"])) + ")" : escaped(one.get<std::string>()));
  }
  return words;
}

/// Frames that are held out, by their names where they have others than numbers; many are counted.
std::string held_out(const json& summary) {
  const json& held = summary["held_out"];
  if (held.empty()) return "nothing";
  if (held.size() > 12) return fmt::format("{} of {}", held.size(), summary["frames"].size());
  json names = json::array();
  for (std::size_t t = 0; t < summary["frames"].size(); ++t)
    if (std::find(held.begin(), held.end(), summary["frames"][t]) != held.end())
      names.push_back(summary.contains("frame_names") ? summary["frame_names"][t].get<std::string>()
                                                      : summary["frames"][t].dump());
  return escaped(joined(names));
}

std::string answer(const json& summary) {
  std::string out = fmt::format(
      "<p><strong>{}</strong></p>\n<p>{}{}. Held out: {}.</p>\n", escaped(summary, "sentence"),
      searched(summary) ? fmt::format("Verdict: <strong>{}</strong>{}", escaped(summary, "verdict"), subject(summary))
                        : "Identified alone",
      summary.contains("light") ? "; of the light: <strong>" + escaped(summary["light"], "verdict") + "</strong>" : "",
      held_out(summary));
  if (summary.contains("doubts"))
    for (const auto& doubt : summary["doubts"])
      out += fmt::format("<p class=\"note\">{}</p>\n", escaped(doubt.get<std::string>()));
  return out;
}

std::string embedded(const std::vector<ReportPicture>& pictures) {
  if (pictures.empty()) return "";
  const bool after = std::any_of(pictures.begin(), pictures.end(), [](const auto& one) {
    return one.file.stem().string().starts_with("residual_after");
  });
  std::string out = fmt::format(
      "<h2>Residual on the surface</h2>\n<p class=\"note\">In units of what noise alone leaves at each node (σ, its "
      "rms over the null tests), all on one scale.</p>\n"
      "<div class=\"pictures\" style=\"grid-template-columns: repeat({}, 1fr)\">\n",
      after ? 3 : 2);
  for (const auto& picture : pictures) {
    std::ifstream stream(picture.file, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(stream)), {});
    if (!bytes.empty())
      out +=
          fmt::format("<figure><img src=\"data:image/png;base64,{}\" alt=\"{}\"><figcaption>{}</figcaption></figure>\n",
                      base64(bytes), escaped(picture.caption), escaped(picture.caption));
  }
  return out + "</div>\n";
}

std::string error_row(const std::string& what, double before, double after, double null, bool both) {
  return fmt::format("<tr><td>{}</td>{}<td>{}</td><td>{}</td></tr>\n", what,
                     both ? fmt::format("<td>{}</td>", shown(before, 4)) : "", shown(after, 4), shown(null, 4));
}

std::string errors(const json& summary) {
  const json &before = summary["before"]["chi"], &after = summary["after"]["chi"];
  struct Row {
    const char *key, *null, *what;
  };
  const bool bars = summary.contains("tests"),
             checked = !summary["held_out"].empty() || summary.contains("part_of_several_tests");
  std::string rows;
  for (const auto& [key, null, what] :
       {Row{"fitted", "null_fitted", "χ of the fitted frames"},
        Row{"held_out", "null_held_out", "χ of the held-out frames"},
        Row{"images", "null_images", "χ of the displacement, fitted frames"},
        Row{"force", "null_force", bars ? "χ of forces and stresses, fitted frames" : "χ of the force, fitted frames"},
        Row{"checkerboard", "null_checkerboard", "χ of the white squares, from the black ones"}})
    if (before.contains(key) && (checked || key != std::string_view("held_out")))
      rows += error_row(what, before[key], after[key], after[null], searched(summary));
  if (before.contains("cameras"))
    for (const auto& [name, was] : before["cameras"].items()) {
      const json& now = after["cameras"][name];
      rows += error_row(fmt::format("χ of the {} cameras, from the others", escaped(name)), was["left_out"],
                        now["left_out"], now["null"], searched(summary));
    }
  const char* note = summary.contains("part_of_several_tests")
                         ? "<p class=\"note\">One of several tests: the verdict and the errors of this table are those "
                           "of all of them together.</p>\n"
                         : "";
  return (searched(summary) ? "<h2>Error before and after</h2>\n" + std::string(note) +
                                  "<table>\n<tr><th></th><th>before</th><th>after"
                            : "<h2>Error</h2>\n" + std::string(note) + "<table>\n<tr><th></th><th>model") +
         "</th><th>noise alone, 95 %</th></tr>\n" + rows + "</table>\n" + frame_plots(summary);
}

/// Where and when the final model leaves most.
std::string where_it_remains(const json& summary) {
  const json& remainder = summary["remainder"];
  if (!remainder.contains("map")) return "";
  const json& map = remainder["map"];
  std::string with;
  for (const auto& [name, r] : remainder["goes_with"].items())
    with += fmt::format("{}{} {:.2f}", with.empty() ? "" : ", ", name, r.get<double>());
  return fmt::format(
      "<p>What remains is largest at ({}, {}) {}{} in frame {}: {} times the noise there, where one null test of a "
      "hundred exceeds {} somewhere; {:.1f} % of nodes and frames are beyond that. Correlation of its first mode with "
      "{}.</p>\n",
      shown(map["place"][0], 3), shown(map["place"][1], 3),
      summary.contains("length_unit") ? escaped(summary, "length_unit") : "",
      map.contains("face") ? " on the " + escaped(map, "face") : "", map["frame"].get<int>(), shown(map["largest"], 3),
      shown(map["limit"], 3), 100.0 * map["share_beyond_limit"].get<double>(), with);
}

/// A score over its limit; a dash where candidates were not scored, as the energy says already that something is left.
std::string largest_score(const json& trial) {
  if (!trial.contains("largest_score")) return "–";
  const json& largest = trial["largest_score"];
  return fmt::format(
      "{:.1f} (limit {:.1f}){}", largest["z"].get<double>(), largest["limit"].get<double>(),
      largest.contains("candidate") ? "<br><span class=\"note\">" + escaped(largest, "candidate") + "</span>" : "");
}

std::string trial_row(const json& trial) {
  const std::string name = escaped(trial, "candidate");
  if (!trial.contains("chi"))
    return fmt::format(
        "<tr><td>{}</td><td>–</td><td>–</td><td>–</td><td>–</td><td class=\"words\">could not be fitted: "
        "{}</td></tr>\n",
        name, escaped(trial, "objection"));
  const json& energy = trial["omnibus"];
  return fmt::format(
      "<tr><td>{}</td><td>{}</td><td>{}</td><td>{:+.1f} (limit {:.1f})</td><td>{}</td><td "
      "class=\"words\">{}</td></tr>\n",
      name, shown(trial["chi"]["fitted"], 4), shown(trial["chi"]["held_out"], 4), energy["deviations"].get<double>(),
      energy["threshold"].get<double>(), largest_score(trial), left_after(trial));
}

std::string rounds(const json& summary) {
  std::string out;
  int round = 0;
  for (const auto& one : summary["rounds"]) {
    ++round;
    if (one["trials"].empty()) continue;  // none stood out: what is left is in the energy
    out += fmt::format(
        "<h2>Round {}: added on trial</h2>\n<table>\n<tr><th>candidate</th><th>χ fitted</th><th>χ held "
        "out</th><th>energy left [sd]</th><th>largest score left [sd]</th><th></th></tr>\n",
        round);
    for (const auto& trial : one["trials"]) out += trial_row(trial);
    out +=
        "</table>\n<p class=\"note\">sd: standard deviations beyond what noise alone leaves. Scores are not made where "
        "the energy says already that something is left (–).</p>\n";
  }
  return out;
}

/// Effects that the data cannot tell apart, and what would.
std::string ambiguity(const json& summary) {
  if (!summary.contains("ambiguity")) return "";
  std::string out = "<h2>What these data cannot tell apart</h2>\n<p>Each of these alone suffices: " +
                    escaped(joined(summary["set"])) + ".</p>\n<ul>\n";
  for (const auto& one : summary["ambiguity"])
    out += fmt::format("<li><strong>{}</strong>: {}.{}{}</li>\n", escaped(one, "name"), escaped(one, "sentence"),
                       one["confused_with"] == "" ? "" : " Confused with " + escaped(one, "confused_with") + ".",
                       one["separated_by"] == "" ? "" : " What would tell it: " + escaped(one, "separated_by") + ".");
  return out + "</ul>\n";
}

std::string parameters(const json& summary) {
  const json &before = summary["before"]["parameters"], &after = summary["after"]["parameters"];
  const bool both = searched(summary);
  std::string out = fmt::format("<h2>Parameters</h2>\n<table>\n<tr><th>parameter</th>{}<th></th><th>unit</th></tr>\n",
                                both ? "<th>before</th><th></th><th></th><th>after</th>" : "<th>value</th>");
  const auto with = [](const json& one) {
    const double deviation = one["standard_deviation"];
    return fmt::format("<td>{}</td><td>{}</td>", shown_with(one["value"], deviation),
                       std::isnan(deviation) ? "not seen"
                       : deviation > 0.0     ? "± " + shown(deviation, 2)
                                             : "its bound");
  };
  for (const auto& [name, now] : after.items())
    out += fmt::format("<tr><td>{}</td>{}{}<td class=\"left\">{}</td></tr>\n", escaped(name),
                       !both                   ? ""
                       : before.contains(name) ? with(before[name]) + "<td>→</td>"
                                               : "<td>–</td><td></td><td>new</td>",
                       with(now), escaped(now, "unit"));
  if (summary.contains("known"))
    for (const auto& [name, one] : summary["known"].items())
      out += fmt::format("<tr><td>{}</td>{}<td>{}</td><td>known</td><td class=\"left\">{}</td></tr>\n", escaped(name),
                         both ? "<td></td><td></td><td></td>" : "", shown(one["value"], 4), escaped(one, "unit"));
  return out + "</table>\n";
}

std::string where_to_look(const json& summary) {
  std::string out = "<p>No known effect explains it. Look where it is largest: " + escaped(summary["next"], "look_at");
  const json& remainder = summary["remainder"];
  if (remainder.contains("map")) {
    const json& map = remainder["map"];
    out += fmt::format("; on the surface about ({}, {}){} in frame {}", shown(map["place"][0], 3),
                       shown(map["place"][1], 3), map.contains("face") ? " on the " + escaped(map, "face") : "",
                       map["frame"].get<int>());
  }
  return out + ".</p>\n";
}

std::string what_next(const json& summary) {
  const std::string verdict = summary["verdict"];
  const json& measurements = summary["next"]["measurements"];
  std::string out = "<h2>What to measure next</h2>\n" + (verdict == "unexplained" ? where_to_look(summary) : "");
  if (measurements.empty())
    return verdict == "unexplained" ? out
                                    : out + "<p>Nothing: of the effects that were looked for none is invisible.</p>\n";
  const char* purpose = verdict == "ambiguous"     ? "This would tell them apart:"
                        : verdict == "attributed"  ? "This would confirm it:"
                        : verdict == "unexplained" ? "This would tell of what helps:"
                                                   : "This would show what this test cannot see:";
  out += fmt::format("<p>{}</p>\n<ul>\n", purpose);
  for (const auto& one : measurements)
    out += fmt::format("<li>{} ({})</li>\n", escaped(one, "measurement"), escaped(joined(one["for"])));
  return out + "</ul>\n";
}

/// Of bars: rms per group, and the residual of every bar.
std::string bars(const json& summary) {
  const bool both = searched(summary);
  std::string out =
      fmt::format("<h2>Bars</h2>\n<table>\n<tr><th>group</th><th></th><th>rows</th>{}<th>unit</th></tr>\n",
                  both ? "<th>rms before</th><th>after</th>" : "<th>rms</th>");
  for (const auto& group : summary["groups"])
    out += fmt::format(
        "<tr{}><td>{}</td><td class=\"left\">{}</td><td>{}</td>{}<td>{}</td><td class=\"left\">{}</td></tr>\n",
        group["held_out"].get<bool>() ? " class=\"held\"" : "", escaped(group, "name"),
        group["held_out"].get<bool>() ? "held out" : "fitted", group["rows"].get<long>(),
        both ? fmt::format("<td>{}</td>", shown(group["before"], 3)) : "", shown(group["after"], 3),
        escaped(group, "unit"));
  return out + "</table>\n" + bar_plots(summary);
}

/// The light: what the correlation leaves of the grey levels, and what was done about it.
std::string light(const json& summary) {
  const json &before = summary["before"]["chi"], &after = summary["after"]["chi"];
  std::string out =
      fmt::format("<h2>Light</h2>\n<p>{}: {}</p>\n", escaped(summary, "verdict"), escaped(summary, "sentence"));
  out += fmt::format(
      "<p class=\"note\">χ {} before, {} after what was added (noise alone up to {}); held-out frames {}, {} "
      "({}).</p>\n",
      shown(before["fitted"], 3), shown(after["fitted"], 3), shown(after["null_fitted"], 3),
      shown(before["held_out"], 3), shown(after["held_out"], 3), shown(after["null_held_out"], 3));
  if (const auto& map = summary["map"]; map.contains("place"))
    out += fmt::format(
        "<p>What remains is largest about ({}, {}) in frame {}, camera {}: {} times the noise, where one null test of "
        "a hundred exceeds {} somewhere; {:.1f} % of places and frames are beyond that.</p>\n",
        shown(map["place"][0], 3), shown(map["place"][1], 3), map["frame"].get<int>(), escaped(map, "camera"),
        shown(map["largest"], 3), shown(map["limit"], 3), 100.0 * map["share_beyond_limit"].get<double>());
  out += "<div class=\"plots\">\n" + chi_plot(summary, "Light: error of each frame");
  for (const auto& [name, camera] : summary["cameras"].items()) {
    std::vector<Curve> curves = {
        {"as correlated", numbers(summary["frames"]), numbers(camera["rms"]), "#b2182b", true, true}};
    if (summary.contains("corrected"))
      curves.push_back({"with the light fitted", numbers(summary["frames"]),
                        numbers(summary["corrected"]["after"]["cameras"][name]["rms"]), "#1f5fa8", true, true});
    out += svg(
        {.title = "Grey levels left, " + name, .x_label = "frame", .y_label = "rms [grey level]", .curves = curves});
  }
  return out + "</div>\n" + candidate_table(summary["before"]) + ambiguity(summary) +
         "<h3>What these grey levels cannot show</h3>\n" + blind_spots(summary["after"]);
}

}  // namespace

void write_loop_page(const std::filesystem::path& page, const json& summary,
                     const std::vector<ReportPicture>& pictures) {
  const json& after = summary["after"];
  const bool added = !after["added"].empty();
  std::string out = fmt::format(
      "<!doctype html>\n<html lang=\"en\"><head><meta "
      "charset=\"utf-8\"><title>{0}</title><style>{1}</style></head><body>\n<h1>{0}</h1>\n",
      escaped(summary, "title"), page_style);
  out += answer(summary);
  out += embedded(pictures);
  out += errors(summary) + where_it_remains(summary);
  if (searched(summary))
    out += "<h2>Candidates under the declared model</h2>\n" + candidate_table(summary["before"]) + rounds(summary);
  if (!after["candidates"].empty() && added)
    out += "<h2>Candidates under the final model</h2>\n<details><summary>scores and sizes</summary>\n" +
           candidate_table(after) + "</details>\n";
  out += ambiguity(summary);
  out += parameters(summary);
  if (searched(summary)) out += "<h2>What this test cannot see</h2>\n" + blind_spots(after) + what_next(summary);
  if (summary.contains("light")) out += light(summary["light"]);
  if (summary.contains("curves")) out += bars(summary);
  write_text_file(page, out + "</body></html>\n");
}

}  // namespace imic3d::io
