#include "loop_candidates.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "html.hpp"
#include "svg_plot.hpp"

namespace imic3d::io {

namespace {

using nlohmann::json;

constexpr std::size_t many = 3;  // sizes, of which only those that are there are shown

std::string unit_of(const json& size) { return size["unit"] == "-" ? "" : " " + escaped(size, "unit"); }

/// A size's parameter, without the name of the test that its effect has already.
std::string parameter_of(const json& size, const json& effect) {
  std::string name = size["parameter"];
  const std::string of = effect["name"];
  if (const auto test = of.rfind(" ("); test != std::string::npos && name.ends_with(of.substr(test)))
    name.resize(name.size() - (of.size() - test));
  return escaped(name);
}

std::string size_and_interval(const json& one) {
  if (!one["interval"].is_array()) return "not determined";
  const double deviation = one["standard_deviation"];
  return fmt::format("{} [{}, {}]{}", shown_with(one["size"], deviation), shown_with(one["interval"][0], deviation),
                     shown_with(one["interval"][1], deviation), unit_of(one));
}

/// A line for each size of an effect, of many those beyond two standard deviations or the largest.
std::string sizes_of(const json& effect) {
  const json& sizes = effect["sizes"];
  const auto ratio = [](const json& one) {
    return std::abs(one["size"].get<double>()) / std::max(1e-300, one["standard_deviation"].get<double>());
  };
  const auto largest =
      std::max_element(sizes.begin(), sizes.end(), [&](const json& a, const json& b) { return ratio(a) < ratio(b); });
  std::string lines;
  for (auto one = sizes.begin(); one != sizes.end(); ++one)
    if (sizes.size() <= many || one == largest || ratio(*one) > 2.0)
      lines += (lines.empty() ? "" : "<br>") + (sizes.size() > 1 ? parameter_of(*one, effect) + " " : "") +
               size_and_interval(*one);
  return sizes.size() <= many ? lines : lines + fmt::format("<br>(of {})", sizes.size());
}

}  // namespace

std::string left_after(const json& trial) {
  const std::string objection = escaped(trial, "objection");
  if (!trial["plausible"].get<bool>()) return "not plausible: " + objection;
  return trial["sufficient"].get<bool>() ? "nothing is left" : objection.empty() ? "something is left" : objection;
}

namespace {

std::string outcome(const json& one) {
  if (!one.contains("tried"))
    return one["contradicted"].get<bool>()  ? "not so in the held-out frames: no more than chance"
           : one["significant"].get<bool>() ? "not tried"
                                            : "";
  const json& tried = one["tried"];
  if (!tried["fitted"].get<bool>()) return "could not be fitted: " + escaped(tried, "objection");
  return (tried["plausible"].get<bool>() ? "plausible; " : "") + left_after(tried);
}

std::string candidate_row(const json& one) {
  const bool tried = one.contains("tried"), in_set = one["in_set"];
  return fmt::format(
      "<tr><td>{0}{1}{2}<br><span class=\"note\">{3}</span></td><td>{4}{5}</td><td>{6}</td><td "
      "class=\"left\">{7}</td><td>{8}</td><td>{9}</td><td class=\"words\">{10}</td></tr>\n",
      in_set ? "<strong>" : "", escaped(one, "name"), in_set ? "</strong>" : "", escaped(one, "link"),
      fmt::format("{:.1f}", one["z"].get<double>()),
      one["significant"].get<bool>()    ? " *"
      : one["contradicted"].get<bool>() ? " (*)"
                                        : "",
      fmt::format("{:.2f}", one["kappa"].get<double>()), sizes_of(one),
      fmt::format("{:.1f}", one["predicted_drop"].get<double>()),
      tried && one["tried"]["fitted"].get<bool>() ? fmt::format("{:.1f}", one["tried"]["achieved_drop"].get<double>())
                                                  : "",
      outcome(one));
}

bool visible(const json& one) { return one["visible"]; }

/// The shifts of the parameters that a size causes, in their standard deviations; the four largest.
std::string shifts(const json& by, const json& parameters) {
  struct Shift {
    double deviations;
    std::string words;
  };
  std::vector<Shift> all;
  for (const auto& [name, shift] : by.items()) {
    if (!parameters.contains(name) || !shift.is_number() || !std::isfinite(shift.get<double>())) continue;
    const json& parameter = parameters[name];
    const double value = shift, deviations = value / std::max(parameter["standard_deviation"].get<double>(), 1e-300);
    if (std::abs(deviations) >= 0.1)
      all.push_back({std::abs(deviations), fmt::format("{} {}{}{} ({} sd)", escaped(name), value > 0.0 ? "+" : "",
                                                       shown(value, 2), unit_of(parameter), shown(deviations, 2))});
  }
  std::stable_sort(all.begin(), all.end(), [](const Shift& a, const Shift& b) { return a.deviations > b.deviations; });
  std::string words;
  for (std::size_t i = 0; i < std::min<std::size_t>(4, all.size()); ++i) words += (i == 0 ? "" : ", ") + all[i].words;
  return words.empty() ? "none beyond 0.1 sd" : words;
}

/// Rows of an effect, one a size.
std::string size_rows(const json& one, const char* size, const char* shift, const json& parameters,
                      const std::string& first, const std::string& last) {
  std::string rows;
  for (const json& its : one["sizes"]) {
    const bool per_unit = std::string(size) == "usual_size" && its["usual_size_is_unit"].get<bool>();
    const bool begins = rows.empty();
    rows += fmt::format("<tr><td>{}</td><td class=\"left\">{} {}{}{}</td><td class=\"words\">{}</td>{}</tr>\n",
                        begins ? first : "", parameter_of(its, one), shown(its[size], 2), unit_of(its),
                        per_unit ? " (a unit)" : "", shifts(its[shift], parameters),
                        last.empty() ? "" : fmt::format("<td class=\"words\">{}</td>", begins ? last : ""));
    if (one["sizes"].size() > many) return rows;
  }
  return rows;
}

std::string invisible_row(const json& one, const json& parameters) {
  const std::string why =
      one.contains("reason") ? escaped(one, "reason") : fmt::format("κ {:.3f}", one["kappa"].get<double>());
  return size_rows(one, "usual_size", "shift_of_parameters_at_usual_size", parameters,
                   fmt::format("{}<br><span class=\"note\">{}</span>", escaped(one, "name"), why),
                   escaped(one, "separated_by").empty() ? "–" : escaped(one, "separated_by"));
}

}  // namespace

std::string escaped(const json& one, const char* key) { return escaped(one[key].get<std::string>()); }

std::string joined(const json& names) {
  std::string all;
  for (const auto& one : names) all += (all.empty() ? "" : ", ") + one.get<std::string>();
  return all.empty() ? "none" : all;
}

std::string candidate_table(const json& model) {
  std::vector<json> all;
  for (const auto& one : model["candidates"])
    if (visible(one) || one.contains("tried")) all.push_back(one);
  std::stable_sort(all.begin(), all.end(),
                   [](const json& a, const json& b) { return a["z"].get<double>() > b["z"].get<double>(); });
  std::string rows =
      "<table class=\"dense\">\n<tr><th>candidate</th><th>z</th><th>κ</th><th class=\"left\">size, 95 % "
      "interval</th><th>drop of χ²,<br>predicted</th><th><br>achieved</th><th class=\"left\">on trial</th></tr>\n";
  for (const auto& one : all) rows += candidate_row(one);
  return rows + fmt::format(
                    "</table>\n<p class=\"note\">* beyond the limit {}, which noise alone exceeds in {:.0f} of 100 "
                    "tests over all candidates, in brackets where with this size the held-out frames are explained "
                    "worse: no more than chance. "
                    "κ: what the free parameters leave of the mark. Sizes are differences from the null value, linear "
                    "estimates ± 1.96 standard deviations. Bold: in the verdict's set.</p>\n",
                    shown(model["threshold"], 3), 100.0 * model["level"].get<double>());
}

std::string blind_spots(const json& model) {
  const json& parameters = model["parameters"];
  std::string hidden, rest;
  std::map<std::string, json> others;  // names by the reason
  for (const auto& one : model["candidates"]) {
    if (!visible(one))
      hidden += invisible_row(one, parameters);
    else
      rest +=
          size_rows(one, "detectable", "shift_of_parameters_at_detectable_size", parameters, escaped(one, "name"), "");
  }
  for (const auto& one : model["not_tested"]) {
    if (one.contains("kappa"))
      hidden += invisible_row(one, parameters);
    else
      others[escaped(one, "reason")].push_back(one["name"]);
  }
  std::string out = hidden.empty()
                        ? "<p>Of the effects that were looked for none is invisible.</p>\n"
                        : "<p>These may be there and leave no trace; each would go into the parameters "
                          "unseen.</p>\n<table>\n<tr><th>effect</th><th class=\"left\">of this size</th><th "
                          "class=\"left\">shifts the parameters by</th><th class=\"left\">seen by</th></tr>\n" +
                              hidden +
                              "</table>\n<p class=\"note\">κ: what the free parameters leave of the mark, below 0.05 "
                              "it is invisible. The size is a usual one, not an estimate; (a unit): none is known, "
                              "shifts are those of one unit. sd: standard deviations of the parameter.</p>\n";
  if (!rest.empty())
    out +=
        "<h3>The smallest sizes of the rest that would be found</h3>\n<table>\n<tr><th>effect</th><th "
        "class=\"left\">found in four of five tests from</th><th class=\"left\">shifts the parameters by, if left "
        "out</th></tr>\n" +
        rest + "</table>\n";
  if (others.empty()) return out;
  out += "<h3>Not tested</h3>\n<ul>\n";
  for (const auto& [reason, names] : others)
    out += fmt::format("<li>{}, because {}</li>\n", escaped(joined(names)), reason);
  return out + "</ul>\n";
}

}  // namespace imic3d::io
