#include "imic3d/io/explain_page.hpp"

#include <fmt/format.h>

#include <string>

#include "html.hpp"
#include "imic3d/io/run_results.hpp"
#include "loop_candidates.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

using nlohmann::json;

std::string cells(const json& names, const json& of, const char* format) {
  std::string out;
  for (const auto& name : names)
    out += fmt::format("<td>{}</td>", fmt::format(fmt::runtime(format), of[name.get<std::string>()].get<double>()));
  return out;
}

/// The two sets, and what they differ by.
std::string sets(const json& found, const json& names) {
  std::string out = "<h2>The two sets</h2>\n<table>\n<tr><th></th>";
  for (const auto& name : names) out += "<th>" + escaped(name.get<std::string>()) + "</th>";
  out += "</tr>\n";
  for (const char* set : {"from", "to"})
    out +=
        fmt::format("<tr><td>{} ({})</td>{}</tr>\n", escaped(found[set], found[set]["title"] == "" ? "file" : "title"),
                    set, cells(names, found[set]["values"], "{:.5g}"));
  out += "<tr><td>difference [%]</td>" + cells(names, found["difference_percent"], "{:+.2f}") + "</tr>\n";
  out += "<tr><td>its standard deviation [%]</td>" + cells(names, found["standard_deviation_percent"], "{:.2g}") +
         "</tr>\n</table>\n";
  return out + fmt::format(
                   "<p class=\"note\">χ² of the difference {:.1f} with {} parameters; a tolerance of {:g} % of "
                   "each is in its standard deviation.</p>\n",
                   found["chi_squared_of_the_difference"].get<double>(), names.size(),
                   100.0 * found["tolerance"].get<double>());
}

std::string size_of(const json& effect) {
  std::string out;
  for (const auto& size : effect["sizes"])
    out += fmt::format("{}{} {:+.4g}{}", out.empty() ? "" : ", ", escaped(size, "quantity"), size["size"].get<double>(),
                       size["unit"] == "-" ? "" : " " + escaped(size, "unit"));
  return out;
}

std::string effects(const json& found, const json& names) {
  std::string out = "<h2>What each effect would do to the first set</h2>\n<table>\n<tr><th>effect</th>";
  for (const auto& name : names) out += fmt::format("<th>{0} [%]</th><th>left</th>", escaped(name.get<std::string>()));
  out += "<th>χ² left</th><th>p</th><th></th><th class=\"left\">size</th></tr>\n";
  for (const auto& one : found["effects"]) {
    const std::string message = one["message"] == "" ? "" : " (" + escaped(one, "message") + ")";
    if (one["degrees"].get<int>() <= 0 || one["failed"].get<bool>()) {
      out += fmt::format("<tr><td>{}</td><td class=\"left\" colspan=\"{}\">not judged{}</td></tr>\n",
                         escaped(one, "name"), 2 * names.size() + 4, message);
      continue;
    }
    out += fmt::format("<tr><td>{}</td>", escaped(one, "name"));
    for (const auto& name : names) {
      const auto key = name.get<std::string>();
      out += fmt::format("<td>{:+.2f}</td><td>{:+.2f}</td>", one["explained_percent"][key].get<double>(),
                         one["left_percent"][key].get<double>());
    }
    out += fmt::format("<td>{:.3g}</td><td>{:.1e}</td><td>{}</td><td class=\"words\">{}{}{}</td></tr>\n",
                       one["chi_squared"].get<double>(), one["p"].get<double>(),
                       found["differ"].get<bool>() && one["fits"].get<bool>() ? "<strong>fits</strong>" : "",
                       size_of(one), one["on_bound"].get<bool>() ? ", on its bound" : "", message);
  }
  return out + fmt::format(
                   "</table>\n<p class=\"note\">An effect fits where what it leaves is not refused at {:g} %. "
                   "Each line is an identification of the test with the effect, without it in the model; "
                   "effects with as many sizes as parameters are not judged.</p>\n",
                   100.0 * found["level"].get<double>());
}

/// What those that fit are, and what would tell them.
std::string hypotheses(const json& found) {
  std::string out;
  for (const auto& one : found["effects"])
    if (found["differ"].get<bool>() && one["fits"].get<bool>())
      out += fmt::format("<li><strong>{}</strong>: {}.{}</li>\n", escaped(one, "name"), escaped(one, "sentence"),
                         one["separated_by"] == "" ? "" : " What would tell it: " + escaped(one, "separated_by") + ".");
  return out.empty() ? "" : "<h2>Hypotheses</h2>\n<ul>\n" + out + "</ul>\n";
}

}  // namespace

void write_explain_page(const std::filesystem::path& page, const json& found) {
  const json& names = found["identified"];
  write_text_file(page,
                  fmt::format("<!doctype html>\n<html lang=\"en\"><head><meta "
                              "charset=\"utf-8\"><title>{0}</title><style>{1}</style></head><body>\n<h1>{0}</h1>\n"
                              "<p><strong>{2}</strong></p>\n",
                              escaped(found, "title"), page_style, escaped(found, "sentence")) +
                      sets(found, names) + effects(found, names) + hypotheses(found) + "</body></html>\n");
}

}  // namespace imic3d::io
