#include "imic3d/io/curve_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "html.hpp"
#include "imic3d/io/run_results.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

constexpr const char* fitted_colour = "#222222";
constexpr const char* held_out_colour = "#e08214";
constexpr const char* model_colour = "#b2182b";
constexpr std::array<const char*, 3> uses = {"not judged", "fitted", "held out"};

nlohmann::json to_json(const CurveRun::Misfit& misfit, const std::string& unit) {
  if (misfit.rows == 0) return nullptr;
  return {{"rows", misfit.rows},
          {"rms", quantity(misfit.stress, unit)},
          {"typical", quantity(misfit.typical, unit)},
          {"chi", quantity(misfit.chi, "-")}};
}

nlohmann::json to_json(const CurveRun& run) {
  nlohmann::json out;
  out["title"] = run.title;
  out["case_file"] = run.case_file;
  out["case_text"] = run.case_text;
  out["law"] = run.law;
  for (const auto& [name, version] : run.versions) out["program"][name] = version;
  for (const auto& p : run.parameters) {
    auto& of = out["parameters"][p.name];
    of = quantity(p.value, p.unit);
    of["initial"] = p.start;
    of["standard_deviation"] = quantity(p.deviation, p.unit)["value"];
    of["standard_deviation_noise_alone"] = quantity(p.noise_deviation, p.unit)["value"];
    of["free"] = p.free;
    of["on_bound"] = p.at_bound;
    if (!p.effect.empty()) of["effect"] = p.effect;
  }
  std::vector<std::string> names;
  for (const auto& p : run.parameters) names.push_back(p.name);
  if (auto covariance = covariance_of(names, run.covariance); !covariance.is_null())
    out["covariance"] = std::move(covariance);
  for (const auto& g : run.groups)
    out["experiments"][g.name] = {{"curves", g.curves},
                                  {"standard_deviation", quantity(g.deviation, run.stress_unit)},
                                  {"standard_deviation_from", g.deviation_from},
                                  {"standard_deviation_of_strain", quantity(g.strain_deviation, "-")},
                                  {"scatter_between_repetitions", quantity(g.floor, run.stress_unit)},
                                  {"fitted", to_json(g.fitted, run.stress_unit)},
                                  {"held_out", to_json(g.held_out, run.stress_unit)}};
  out["iterations"] = run.iterations.size();
  out["converged"] = run.converged;
  if (!run.doubts.empty()) out["doubts"] = run.doubts;
  out["time"] = quantity(run.seconds, "s");
  return out;
}

std::string to_csv(const CurveRun& run) {
  std::string out = fmt::format("experiment,curve,row,use,time_{0},log_strain,measured_{1},predicted_{1},stress_kind\n",
                                run.time_unit, run.stress_unit);
  for (const auto& c : run.curves)
    for (Eigen::Index i = 0; i < c.strain.size(); ++i)
      out += fmt::format("\"{}\",\"{}\",{},{},{:.9g},{:.9g},{:.9g},{:.9g},{}\n", c.group, c.name, i,
                         uses[static_cast<std::size_t>(c.use[static_cast<std::size_t>(i)])], c.time[i], c.strain[i],
                         c.measured[i], c.predicted[i], c.engineering ? "engineering" : "true");
  return out;
}

/// The rows of one use, the others broken out.
std::vector<double> rows_of(const CurveRun::Curve& c, const Eigen::VectorXd& values, char use) {
  std::vector<double> rows(static_cast<std::size_t>(values.size()), std::nan(""));
  for (std::size_t i = 0; i < rows.size(); ++i)
    if (c.use[i] == use) rows[i] = values[static_cast<Eigen::Index>(i)];
  return rows;
}

std::string plots(const CurveRun& run, const std::string& group) {
  Plot stress{.title = group,
              .x_label = "logarithmic strain",
              .y_label = fmt::format("stress [{}]", run.stress_unit),
              .curves = {}};
  Plot gap{.title = "measured − predicted",
           .x_label = "logarithmic strain",
           .y_label = fmt::format("[{}]", run.stress_unit),
           .curves = {}};
  bool first_fitted = true, first_held = true, first_model = true;
  for (const auto& c : run.curves) {
    if (c.group != group) continue;
    const std::vector<double> strain(c.strain.data(), c.strain.data() + c.strain.size());
    for (const char use : {char{1}, char{2}}) {
      if (std::find(c.use.begin(), c.use.end(), use) == c.use.end()) continue;
      bool& first = use == 1 ? first_fitted : first_held;
      const char* colour = use == 1 ? fitted_colour : held_out_colour;
      stress.curves.push_back({first ? std::string("measured, ") + uses[static_cast<std::size_t>(use)] : "", strain,
                               rows_of(c, c.measured, use), colour, true, false, 1.0});
      gap.curves.push_back({"", strain, rows_of(c, c.measured - c.predicted, use), colour, true, false, 1.0});
      first = false;
    }
  }
  for (const auto& c : run.curves) {
    if (c.group != group) continue;
    stress.curves.push_back({first_model ? "model" : "",
                             {c.strain.data(), c.strain.data() + c.strain.size()},
                             {c.predicted.data(), c.predicted.data() + c.predicted.size()},
                             model_colour,
                             true,
                             false,
                             1.0});
    first_model = false;
  }
  return "<div class=\"plots\">\n" + svg(stress) + svg(gap) + "</div>\n";
}

std::string page(const CurveRun& run) {
  const auto title = escaped(run.title);
  std::string out = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta "
      "charset=\"utf-8\">\n<title>{0}</title>\n<style>{1}</style>\n</head>\n<body>\n<h1>{0}</h1>\n"
      "<p class=\"note\">{2} · law {3}{4}</p>\n",
      title, page_style, escaped(run.case_file), escaped(run.law), run.converged ? "" : " · not converged");
  for (const auto& doubt : run.doubts) out += fmt::format("<p><strong>Doubted:</strong> {}</p>\n", escaped(doubt));
  out +=
      "<h2>Parameters</h2>\n<table>\n<tr><th>parameter</th><th>identified</th><th>standard deviation</th><th>of white "
      "noise alone</th><th>start</th><th>unit</th>"
      "<th>effect</th></tr>\n";
  for (const auto& p : run.parameters)
    out += fmt::format(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td class=\"left\">{}</td><td "
        "class=\"left\">{}</td></tr>\n",
        escaped(p.name), shown_with(p.value, p.deviation),
        p.at_bound ? "on a bound"
        : p.free   ? shown(p.deviation, 2)
                   : "fixed",
        p.free ? shown(p.noise_deviation, 2) : "", shown(p.start), escaped(p.unit), escaped(p.effect));
  out += fmt::format(
      "</table>\n<p class=\"note\">Standard deviation: repeated bars differ by their scatter, each all along its "
      "curve; with white noise alone it would be the smaller one.</p>\n"
      "<h2>Measured − predicted [{0}]</h2>\n<table>\n<tr><th>experiment</th><th>curves</th><th>noise</th><th>read "
      "from</th><th>between bars</th><th>fitted: rms</th>"
      "<th>typical</th><th>χ</th><th>held out: rms</th><th>typical</th><th>χ</th></tr>\n",
      escaped(run.stress_unit));
  for (const auto& g : run.groups) {
    const auto of = [](const CurveRun::Misfit& m) {
      return m.rows > 0 ? fmt::format("<td>{}</td><td>{}</td><td>{}</td>", shown(m.stress, 4), shown(m.typical, 4),
                                      shown(m.chi, 3))
                        : std::string("<td></td><td></td><td></td>");
    };
    out += fmt::format(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td class=\"left\">{}</td><td>{}</td>{}{}</tr>\n", escaped(g.name),
        g.curves, shown(g.deviation, 3),
        escaped(g.deviation_from +
                (g.strain_deviation > 0.0 ? fmt::format("; of the strain {}", shown(g.strain_deviation, 2)) : "")),
        shown(g.floor, 3), of(g.fitted), of(g.held_out));
  }
  out +=
      "</table>\n<p class=\"note\">between bars: standard deviation of repetitions at the same strain, which no law "
      "can go below on all of them; typical: median of the absolute value over 0.6745, the rms without a few rows that "
      "are far off.</p>\n<h2>Curves</h2>\n";
  for (const auto& g : run.groups) out += plots(run, g.name);
  if (run.iterations.size() > 1) {
    std::vector<double> row;
    for (std::size_t i = 0; i < run.iterations.size(); ++i) row.push_back(static_cast<double>(i));
    out +=
        "<h2>Iterations</h2>\n<div class=\"plots\">\n" + svg({.title = "χ",
                                                              .x_label = "iteration, all stages",
                                                              .y_label = "χ of the fitted rows",
                                                              .curves = {{"", row, run.chi, fitted_colour, true, true}},
                                                              .width = 340,
                                                              .height = 230});
    for (std::size_t p = 0; p < run.parameters.size(); ++p) {
      if (!run.parameters[p].free) continue;
      std::vector<double> values;
      for (const auto& at : run.iterations) values.push_back(at[p]);
      out += svg({.title = run.parameters[p].name,
                  .x_label = "iteration, all stages",
                  .y_label = run.parameters[p].unit,
                  .curves = {{"", row, values, model_colour, true, true}},
                  .width = 340,
                  .height = 230});
    }
    out += "</div>\n";
  }
  out += fmt::format("<h2>Case file</h2>\n<details><summary>{}</summary>\n<pre>{}</pre>\n</details>\n",
                     escaped(run.case_file), escaped(run.case_text));
  return out + "</body>\n</html>\n";
}

}  // namespace

void write_curve_results(const std::filesystem::path& folder, const CurveRun& run) {
  write_json(folder / "result.json", to_json(run));
  write_text_file(folder / "curves.csv", to_csv(run));
  write_text_file(folder / "report.html", page(run));
}

}  // namespace imic3d::io
