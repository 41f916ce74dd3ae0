#include "imic3d/io/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "html.hpp"
#include "image_files.hpp"
#include "imic3d/io/run_results.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

constexpr const char* measured_colour = "#222222";
constexpr const char* model_colour = "#b2182b";
constexpr const char* dic_colour = "#2166ac";

class Report {
 public:
  explicit Report(const ResultsFile& file) : file_(file), numbers_(file.read_integers("frames/number")) {}

  std::string page(const std::vector<ReportPicture>& pictures, const std::vector<std::string>& doubts) {
    const auto title = escaped(file_.read_text("case/title"));
    out_ = fmt::format(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{0}</title>\n"
        "<style>{1}</style>\n</head>\n<body>\n<h1>{0}</h1>\n",
        title, page_style);
    const auto text_of = [&](const std::string& name) { return file_.has(name) ? file_.read_text(name) : "?"; };
    out_ += fmt::format("<p class=\"note\">{} · imic3d {}</p>\n", escaped(file_.read_text("case/file")),
                        escaped(text_of("program/imic3d")));
    for (const auto& doubt : doubts) out_ += fmt::format("<p><strong>Doubted:</strong> {}</p>\n", escaped(doubt));
    parameters();
    headline();
    curves();
    iterations();
    show(pictures);
    frames();
    sources();
    return out_ + "</body>\n</html>\n";
  }

 private:
  void parameters() {
    if (!file_.has("identification/parameters")) return;
    const auto names = file_.read_texts("identification/parameters"), units = file_.read_texts("identification/units");
    const auto initial = file_.read("identification/initial"), values = file_.read("identification/values"),
               deviation = file_.read("identification/standard_deviation");
    const auto on_bound = file_.has("identification/on_bound") ? file_.read_integers("identification/on_bound")
                                                               : std::vector<int>(names.size(), 0);
    const auto at_once = [&](const char* what) {
      return file_.has("identification/at_once/change") ? file_.read(std::string("identification/at_once/") + what)
                                                        : std::vector<double>(names.size(), std::nan(""));
    };
    const auto change = at_once("change"), deviation_then = at_once("standard_deviation");
    const bool in_turn = std::any_of(change.begin(), change.end(), [](double value) { return std::isfinite(value); });
    out_ += fmt::format(
        "<h2>Parameters</h2>\n<table>\n<tr><th>parameter</th><th>identified</th><th>standard deviation</th>"
        "<th>relative</th>{}<th>start</th><th>unit</th></tr>\n",
        in_turn ? "<th>change, all free at once</th>" : "");
    bool finished = false;
    for (std::size_t i = 0; i < names.size(); ++i) {
      const bool free = std::isfinite(deviation[i]);
      finished = finished || std::isfinite(values[i]);
      out_ += fmt::format(
          "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td>{}<td>{}</td><td class=\"left\">{}</td></tr>\n",
          escaped(names[i]), shown_with(values[i], deviation[i]),
          on_bound[i] > 0            ? "on its bound"
          : free                     ? shown(deviation[i], 2)
          : std::isinf(deviation[i]) ? "not determined"
                                     : "fixed",
          free && on_bound[i] <= 0 ? shown(100 * deviation[i] / std::abs(values[i]), 2) + " %" : "",
          !in_turn ? ""
          : std::isfinite(change[i])
              ? fmt::format("<td>{} ± {}</td>", shown_with(change[i], deviation_then[i]), shown(deviation_then[i], 2))
              : "<td></td>",
          shown(initial[i]), escaped(units[i]));
    }
    out_ += "</table>\n";
    if (in_turn)
      out_ +=
          "<p class=\"note\">Stages found the parameters one after another: standard deviations are those of each as "
          "if the others were known.</p>\n";
    if (!finished) out_ += "<p>The identification was not finished; see the parameters by iteration.</p>\n";
  }

  void headline() {
    auto result = summary(file_);
    std::string rows;
    const auto add = [&](const char* what, const char* key) {
      if (!result.contains(key) || result[key]["value"].is_null()) return;
      std::string cells;
      for (const auto* part : {&result, &result["fitted"], &result["held_out"]}) {
        const bool given = part->contains(key) && !(*part)[key]["value"].is_null();
        cells += fmt::format("<td>{}</td>", given ? shown((*part)[key]["value"].get<double>(), 4) : "–");
      }
      rows += fmt::format("<tr><td>{}</td>{}<td class=\"left\">{}</td></tr>\n", what, cells,
                          escaped(result[key]["unit"].get<std::string>()));
    };
    add("force, measured − predicted (rms over the frames)", "force_rms_difference");
    add("residual of the identified model (rms)", "residual_rms_model");
    add("residual of pure DIC (rms)", "residual_rms_dic");
    if (!rows.empty())
      out_ +=
          "<h2>How well it fits</h2>\n<table>\n<tr><th></th><th>all frames</th><th>fitted</th><th>held "
          "out</th><th></th></tr>\n" +
          rows + "</table>\n";
  }

  void curves() {
    std::string plots;
    const auto [x, x_label] = abscissa();
    const auto measured = file_.read("frames/force_measured"), predicted = file_.read("frames/force_predicted");
    if (any(measured) || any(predicted))
      plots += svg({.title = "Force",
                    .x_label = x_label,
                    .y_label = fmt::format("force [{}]", file_.unit("frames/force_measured")),
                    .curves = {{"measured", x, measured, measured_colour, false, true},
                               {"predicted", x, predicted, model_colour, true, false}}});
    if (file_.has("residual/rms_model")) {
      const std::vector<double> frame(numbers_.begin(), numbers_.end());
      const auto model = file_.read("residual/rms_model"), dic = file_.read("residual/rms_dic");
      if (any(model) || any(dic))
        plots += svg({.title = "Residual",
                      .x_label = "frame",
                      .y_label = "rms [grey level]",
                      .curves = {{"model", frame, model, model_colour, true, true},
                                 {"pure DIC", frame, dic, dic_colour, true, true}}});
    }
    if (!plots.empty()) out_ += "<h2>Curves</h2>\n<div class=\"plots\">\n" + plots + "</div>\n";
  }

  /// Elongation between the ends where the simulation is there, else the frame's number.
  std::pair<std::vector<double>, std::string> abscissa() const {
    const auto held = "mesh/node_groups/" + file_.read_text("case/held");
    const auto loaded = "mesh/node_groups/" + file_.read_text("case/loaded");
    const auto done = file_.frames_done("fields");
    if (done.empty() || !file_.has(held) || !file_.has(loaded))
      return {std::vector<double>(numbers_.begin(), numbers_.end()), "frame"};
    const std::size_t axis = file_.read_text("case/axis") == "x" ? 0 : 1;
    std::vector<double> elongation(numbers_.size(), std::nan(""));
    for (const auto frame : done) {
      const auto u = file_.read("fields/displacement", frame);
      const auto mean = [&](const std::string& group) {
        double sum = 0.0;
        const auto nodes = file_.read_integers(group);
        for (int node : nodes) sum += u[3 * static_cast<std::size_t>(node) + axis];
        return sum / static_cast<double>(nodes.size());
      };
      elongation[frame] = mean(loaded) - mean(held);
    }
    return {elongation, fmt::format("elongation between the ends [{}]", file_.unit("fields/displacement"))};
  }

  void iterations() {
    const std::string group = "identification/iterations/";
    if (!file_.has(group + "count")) return;
    const auto count = static_cast<std::size_t>(file_.read_integers(group + "count")[0]);
    if (count < 2) return;
    const auto names = file_.read_texts("identification/parameters"), units = file_.read_texts("identification/units");
    std::vector<double> row(count);
    std::string plots;
    for (std::size_t i = 0; i < count; ++i) row[i] = static_cast<double>(i);
    for (std::size_t p = 0; p < names.size(); ++p) {
      std::vector<double> values;
      for (std::size_t i = 0; i < count; ++i) values.push_back(file_.read(group + "values", i)[p]);
      if (std::all_of(values.begin(), values.end(), [&](double value) { return value == values[0]; })) continue;
      plots += svg({.title = names[p],
                    .x_label = "iteration, all stages",
                    .y_label = fmt::format("{} [{}]", names[p], units[p]),
                    .curves = {{"", row, values, dic_colour, true, true}},
                    .width = 340,
                    .height = 230});
    }
    if (!plots.empty()) out_ += "<h2>Parameters by iteration</h2>\n<div class=\"plots\">\n" + plots + "</div>\n";
  }

  void show(const std::vector<ReportPicture>& pictures) {
    std::string figures;
    for (const auto& picture : pictures) {
      std::ifstream stream(picture.file, std::ios::binary);
      const std::string bytes((std::istreambuf_iterator<char>(stream)), {});
      if (bytes.empty()) continue;
      figures += fmt::format(
          "<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>\n",
          escaped(picture.caption), base64(bytes));
    }
    if (!figures.empty()) out_ += "<h2>Pictures</h2>\n<div class=\"pictures\">\n" + figures + "</div>\n";
  }

  void frames() {
    const auto time = file_.read("frames/time"), measured = file_.read("frames/force_measured"),
               predicted = file_.read("frames/force_predicted");
    const auto use = file_.read_integers("frames/use");
    const std::vector<double> none(numbers_.size(), std::nan(""));
    const bool has_residual = file_.has("residual/rms_model");
    const auto model = has_residual ? file_.read("residual/rms_model") : none,
               dic = has_residual ? file_.read("residual/rms_dic") : none;
    const auto force = file_.unit("frames/force_measured");
    out_ += fmt::format(
        "<h2>Frames</h2>\n<details{}><summary>{} frames</summary>\n<table>\n<tr><th>frame</th><th>use</th>"
        "<th>time [{}]</th><th>force measured [{}]</th><th>predicted [{}]</th><th>difference</th>"
        "<th>residual model [grey level]</th><th>DIC</th></tr>\n",
        numbers_.size() <= 60 ? " open" : "", numbers_.size(), file_.unit("frames/time"), force, force);
    constexpr std::array<const char*, 4> uses{"", "fitted", "held out", "reference"};
    for (std::size_t i = 0; i < numbers_.size(); ++i) {
      const auto kind = static_cast<std::size_t>(std::clamp(use[i], 0, 3));
      out_ += fmt::format(
          "<tr{}><td>{}</td><td class=\"left\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>"
          "<td>{}</td></tr>\n",
          kind == 2 ? " class=\"held\"" : "", numbers_[i], uses[kind],
          std::isfinite(time[i]) ? fmt::format("{:.6g}", time[i]) : "–", shown(measured[i]), shown(predicted[i]),
          shown(measured[i] - predicted[i], 3), shown(model[i], 4), shown(dic[i], 4));
    }
    out_ += "</table>\n</details>\n";
  }

  void sources() {
    out_ += fmt::format("<h2>Case file</h2>\n<details><summary>{}</summary>\n<pre>{}</pre>\n</details>\n",
                        escaped(file_.read_text("case/file")), escaped(file_.read_text("case/text")));
    out_ += "<h2>Made with</h2>\n<table>\n";
    for (const auto& name : file_.names())
      if (name.starts_with("program/"))
        out_ += fmt::format("<tr><td>{}</td><td class=\"left\">{}</td></tr>\n", escaped(name.substr(8)),
                            escaped(file_.read_text(name)));
    out_ += "</table>\n";
  }

  static bool any(const std::vector<double>& values) {
    return std::any_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
  }

  const ResultsFile& file_;
  std::vector<int> numbers_;
  std::string out_;
};

}  // namespace

std::vector<ReportPicture> pictures_in(const std::filesystem::path& folder) {
  std::vector<ReportPicture> pictures;
  for (const auto& file : matching_files(folder, "*.png")) {
    auto caption = file.stem().string();
    std::replace(caption.begin(), caption.end(), '_', ' ');
    if (!caption.empty()) caption[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(caption[0])));
    pictures.push_back({file, caption});
  }
  return pictures;
}

void write_report(const std::filesystem::path& page, const ResultsFile& file,
                  const std::vector<ReportPicture>& pictures, const std::vector<std::string>& doubts) {
  write_text_file(page, Report(file).page(pictures, doubts));
}

}  // namespace imic3d::io
