#include "sentence.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "appraisal.hpp"
#include "plausibility.hpp"

namespace imic3d::loop {

std::string to_a_digit(double value, double deviation) {
  if (!(deviation > 0.0)) return fmt::format("{:.6g}", value);
  const int last = static_cast<int>(std::floor(std::log10(deviation))),
            first = static_cast<int>(std::floor(std::log10(std::max(std::abs(value), deviation))));
  return first > 6 ? fmt::format("{:.{}e}", value, first - last)
                   : fmt::format("{:.{}f}", value, std::clamp(-last, 0, 12));
}

namespace {

std::string size_of(const Experiment& experiment, int k, const Model& model) {
  const Candidate& its = experiment.candidates()[static_cast<std::size_t>(k)];
  std::string text;
  for (int j : its.parameters) {
    const auto place = std::find(model.fit.free.begin(), model.fit.free.end(), j) - model.fit.free.begin();
    if (place >= static_cast<std::ptrdiff_t>(model.fit.free.size())) continue;
    const auto& info = experiment.parameters()[static_cast<std::size_t>(j)].info;
    if (its.parameters.size() > 6 &&
        std::abs(model.fit.values[static_cast<std::size_t>(j)] - info.null_value.value_or(0.0)) <
            3.0 * std::sqrt(model.covariance(place, place)))
      continue;  // of many, those that are there
    text += fmt::format("{}{} = {:.4g} +- {:.2g}{}", text.empty() ? "" : ", ", info.name,
                        model.fit.values[static_cast<std::size_t>(j)], std::sqrt(model.covariance(place, place)),
                        info.unit == "-" ? "" : " " + info.unit);
  }
  return text;
}

/// What became of the declared law's parameters that moved by more than a standard deviation, to a digit of that.
std::string changes(const Experiment& experiment, const Model& before, const Model& after) {
  std::string text;
  for (std::size_t i = 0; i < before.fit.free.size(); ++i) {
    const int j = before.fit.free[i];
    const auto& info = experiment.parameters()[static_cast<std::size_t>(j)].info;
    const auto now = std::find(after.fit.free.begin(), after.fit.free.end(), j) - after.fit.free.begin(),
               was = static_cast<std::ptrdiff_t>(i);
    const double deviation = std::sqrt(std::max(before.covariance(was, was), after.covariance(now, now)));
    const double from = before.fit.values[static_cast<std::size_t>(j)],
                 to = after.fit.values[static_cast<std::size_t>(j)];
    if (info.null_value || !(std::abs(to - from) > deviation)) continue;
    text += fmt::format("{}{} {} -> {}{}", text.empty() ? " " : ", ", info.name, to_a_digit(from, deviation),
                        to_a_digit(to, deviation), info.unit == "-" ? "" : " " + info.unit);
  }
  return text.empty() ? "" : text + ".";
}

/// Where several effects explain it alike: what the declared law's parameters are with the others, where that is
/// another one by more than a standard deviation.
std::string with_the_others(const Experiment& experiment, const Report& report) {
  if (report.verdict != Verdict::ambiguous || report.named.empty()) return "";
  const Model& taken = report.final;
  std::string text;
  for (const Round& round : report.rounds)
    for (const Trial& trial : round.trials) {
      const bool other = trial.candidate != report.named.back() && round.kept &&
                         std::count(report.set.begin(), report.set.end(), trial.candidate) > 0 &&
                         trial.model.added.size() == taken.added.size() && !trial.model.fit.values.empty();
      if (!other) continue;
      std::string values;
      for (std::size_t i = 0; i < taken.fit.free.size(); ++i) {
        const auto j = static_cast<std::size_t>(taken.fit.free[i]);
        const auto place = static_cast<Eigen::Index>(i);
        const auto& info = experiment.parameters()[j].info;
        const double deviation = std::sqrt(taken.covariance(place, place)), now = trial.model.fit.values[j];
        if (info.null_value || !(std::abs(now - taken.fit.values[j]) > deviation)) continue;
        values += fmt::format("{}{} {}{}", values.empty() ? "" : ", ", info.name, to_a_digit(now, deviation),
                              info.unit == "-" ? "" : " " + info.unit);
      }
      if (!values.empty())
        text += fmt::format(" With {}{}: {}.", experiment.candidates()[static_cast<std::size_t>(trial.candidate)].name,
                            text.empty() ? " instead" : "", values);
    }
  return text;
}

/// The declared model's parameters that are not seen, or stand on a bound.
std::string bounds(const Experiment& experiment, const Model& declared, const Model& after) {
  std::vector<std::string> together;
  for (const int j : after.undetermined)
    together.push_back(experiment.parameters()[static_cast<std::size_t>(j)].info.name);
  std::string text = together.empty()
                         ? ""
                         : fmt::format(" These data show a combination of {} alone: each of them may be another one.",
                                       fmt::join(together, ", "));
  for (const int j : declared.fit.free) {
    const auto& parameter = experiment.parameters()[static_cast<std::size_t>(j)];
    const double value = after.fit.values[static_cast<std::size_t>(j)];
    if (std::count(after.fit.unseen.begin(), after.fit.unseen.end(), j) > 0)
      text += fmt::format(" These data do not show {}.", parameter.info.name);
    else if (on_bound(parameter, value))
      text += fmt::format(" {} = {:.4g}{} is on its bound: these data ask for more, or do not show it.",
                          parameter.info.name, value, parameter.info.unit == "-" ? "" : " " + parameter.info.unit);
  }
  return text;
}

/// The declared model's parameters that stand far from what was known of them.
std::string unlike_known(const Experiment& experiment, const Model& model) {
  constexpr double far = 3.5;
  std::string text;
  for (const int j : model.fit.free) {
    const auto& parameter = experiment.parameters()[static_cast<std::size_t>(j)];
    const double value = model.fit.values[static_cast<std::size_t>(j)];
    if (parameter.info.null_value || parameter.prior <= 0.0 ||
        std::abs(value - parameter.expected()) < far * parameter.prior)
      continue;
    text +=
        fmt::format(" {} = {:.4g}{}, where {:.4g} +- {:.2g} was known.", parameter.info.name, value,
                    parameter.info.unit == "-" ? "" : " " + parameter.info.unit, parameter.expected(), parameter.prior);
  }
  return text;
}

/// The declared parameters that leave nothing beyond the bounds that hold them.
std::string beyond_bounds(const Experiment& experiment, const Report& report) {
  std::vector<std::string> values;
  if (report.beyond_bounds)
    for (const int j : report.beyond_bounds->released) {
      const auto& info = experiment.parameters()[static_cast<std::size_t>(j)].info;
      values.push_back(fmt::format("{} = {:.4g}{}", info.name,
                                   report.beyond_bounds->fit.values[static_cast<std::size_t>(j)],
                                   info.unit == "-" ? "" : " " + info.unit));
    }
  return values.empty()
             ? ""
             : fmt::format("{} beyond {}", fmt::join(values, ", "), values.size() == 1 ? "its bound" : "their bounds");
}

/// Where the frames that were held out have far more left than noise explains: something happens there alone, in a
/// picture out of focus for instance, of which the verdict on the fitted ones knows nothing.
std::string left_in_held_out(const Experiment& experiment, const Report& report) {
  constexpr double far = 1.5;  // of the null's 95 % quantile
  const Misfit& misfit = report.final.misfit;
  if (report.verdict == Verdict::unexplained || !(misfit.held_out > far * misfit.null_held_out)) return "";
  int worst = -1;
  const auto beyond = [&](int t) { return misfit.frames[t] - misfit.null_frames[t]; };
  for (std::size_t t = 0; t < report.held_out.size(); ++t)
    if (report.held_out[t] != 0 && (worst < 0 || beyond(static_cast<int>(t)) > beyond(worst)))
      worst = static_cast<int>(t);
  return worst < 0 ? ""
                   : fmt::format(" What was held out has more left, {:.2f} (null {:.2f}), most in {}.", misfit.held_out,
                                 misfit.null_held_out, experiment.frame_name(worst));
}

/// What no second frame checks.
std::string told_by_one_frame(const Experiment& experiment, const Report& report) {
  if (report.verdict != Verdict::attributed && report.verdict != Verdict::ambiguous) return "";
  std::vector<char> fitted;
  for (char out : report.held_out) fitted.push_back(out == 0 ? 1 : 0);
  const auto rows = rows_of_frames(experiment.data(), fitted);
  std::string text;
  for (int k : report.named)
    if (const auto alone = told_by_one_frame(experiment, report.final, k, rows))
      text +=
          fmt::format(" Nothing that is fitted tells of {} but {}.",
                      experiment.candidates()[static_cast<std::size_t>(k)].name, experiment.frame_name(alone->frame));
  return text;
}

/// Whether most of what a frame has left beyond noise (one a number) is in its force, where it has other numbers, too.
bool in_its_force(const Experiment& experiment, const Model& model, int frame) {
  double force = 0.0, other = 0.0;
  int others = 0;
  for (std::size_t i = 0; i < experiment.data().size(); ++i) {
    const Datum& datum = experiment.data()[i];
    if (datum.frame != frame) continue;
    const double r = model.fit.residual[static_cast<Eigen::Index>(i)], excess = r * r - 1.0;
    if (datum.channel == force_channel)
      force += excess;
    else
      other += excess, ++others;
  }
  return others > 0 && force > 0.0 && force > other;
}

/// Where chi, in which all numbers count alike, and what was known of parameters not at all, says otherwise.
std::string energy_decides(const Model& model) {
  const bool beyond = model.scores.omnibus > model.scores.omnibus_threshold;
  if ((model.misfit.fitted > model.misfit.null_fitted) == beyond) return "";
  return fmt::format(
      "; what decides is the energy, which counts what is in doubt for less and what was known of the parameters, too: "
      "{:+.1f} standard deviations, limit {:.1f}",
      model.scores.omnibus, model.scores.omnibus_threshold);
}

std::string verdict_in_words(const Experiment& experiment, const Report& report) {
  const Model &before = report.declared, &after = report.final;
  const bool is_held_out =
      std::any_of(report.held_out.begin(), report.held_out.end(), [](char out) { return out != 0; });
  const std::string change =
      !is_held_out ? "Nothing was held out that would check it."
      : !report.searched
          ? fmt::format("Held-out error {:.2f} (null {:.2f}).", after.misfit.held_out, after.misfit.null_held_out)
          : fmt::format("Held-out error {:.2f} -> {:.2f} (null {:.2f}).", before.misfit.held_out, after.misfit.held_out,
                        after.misfit.null_held_out);
  const auto candidate = [&](int k) -> const Candidate& {
    return experiment.candidates()[static_cast<std::size_t>(k)];
  };
  std::string by_chance;
  for (std::size_t i = 0; i < after.others.size(); ++i)
    if (after.scores.candidates[i].contradicted)
      by_chance += (by_chance.empty() ? " Beyond the limit, but not so in what was held out: " : ", ") +
                   candidate(after.others[i]).name;
  if (!by_chance.empty()) by_chance += ".";
  std::string by_formula;
  for (std::size_t i = 0; i < after.others.size(); ++i)
    if (stands_out(after, after.scores.candidates[i]) && within_formula(after, after.scores.candidates[i]))
      by_formula += (by_formula.empty() ? " Just beyond the limit, but within a tenth of what these formulas explain, "
                                          "which need not be the material's own: "
                                        : ", ") +
                    candidate(after.others[i]).name;
  if (!by_formula.empty()) by_chance += by_formula + ".";
  if (report.verdict == Verdict::nothing_found)
    return fmt::format("{} (chi {:.2f}, null up to {:.2f}{}).{}",
                       report.searched ? "Nothing is missing that this test could show"
                                       : "The model leaves what noise leaves, no effect was looked for",
                       before.misfit.fitted, before.misfit.null_fitted, energy_decides(before), by_chance);
  std::string by_score;  // where the residual as a whole is no larger than noise makes it
  if (!omnibus_significant(before)) {
    std::size_t largest = before.others.size();
    for (std::size_t i = 0; i < before.others.size(); ++i)
      if (stands_out(before, before.scores.candidates[i]) &&
          (largest == before.others.size() || before.scores.candidates[i].z > before.scores.candidates[largest].z))
        largest = i;
    if (largest < before.others.size())
      by_score = fmt::format("; one score of {} tells, that of {}: {:.1f}, noise alone up to {:.1f}",
                             before.others.size(), candidate(before.others[largest]).name,
                             before.scores.candidates[largest].z, before.scores.threshold);
  }
  std::string text = fmt::format("Something is missing (chi {:.2f}, null up to {:.2f}{}). ", before.misfit.fitted,
                                 before.misfit.null_fitted, by_score.empty() ? energy_decides(before) : by_score);
  const auto list = [&](const std::vector<int>& which) {
    std::string all;
    for (int k : which) {
      const std::string sizes = size_of(experiment, k, after);
      all += (all.empty() ? "" : "; ") + candidate(k).sentence + (sizes.empty() ? "" : " (" + sizes + ")");
    }
    return all;
  };
  // Whatever has the same course has left the same marks.
  const auto courses = [&](const std::vector<int>& which) {
    std::vector<std::string> functions;
    for (int k : which)
      if (const auto& one = candidate(k).formula_for;
          !one.empty() && std::find(functions.begin(), functions.end(), one) == functions.end())
        functions.push_back(one);
    return functions.empty()
               ? ""
               : fmt::format("Of {} the test shows the course, not the formula. ", fmt::join(functions, " and "));
  };
  if (report.verdict == Verdict::attributed) {
    text += report.named.size() == 1
                ? "One candidate alone explains it: " + list(report.named) + ". "
                : "It takes " + std::to_string(report.named.size()) + " effects: " + list(report.named) + ". ";
    text += courses(report.named);
  } else if (report.verdict == Verdict::ambiguous) {
    std::vector<std::string> names, separators;
    for (int k : report.set) {
      names.push_back(candidate(k).name);
      std::istringstream all(candidate(k).separated_by);
      for (std::string one; std::getline(all >> std::ws, one, ';');)
        if (std::find(separators.begin(), separators.end(), one) == separators.end()) separators.push_back(one);
    }
    if (report.beyond_bounds) names.push_back(beyond_bounds(experiment, report));
    const std::vector<int> sure(report.named.begin(), report.named.end() - 1);
    text += sure.empty() ? "It is one of: " : "It takes " + list(sure) + ", and one of: ";
    text += fmt::format("{}; these data cannot tell. What would: {}. ", fmt::join(names, ", "),
                        fmt::join(separators, "; "));
    std::vector<int> all = sure;
    all.insert(all.end(), report.set.begin(), report.set.end());
    text += courses(all);
  } else {
    text += !report.searched        ? "No effect was looked for (imic3d loop does)"
            : report.rounds.empty() ? "No effect was tried"
                                    : "No known effect explains it";
    if (report.beyond_bounds) text += " (nothing is left with " + beyond_bounds(experiment, report) + ")";
    if (!report.named.empty()) text += ", though it helps to add: " + list(report.named);
    if (const auto k = without_size(experiment, after); k && !significant(after)) {
      text += fmt::format(
          ". Nothing is left with these, but the size of {} is not told from its null value: they may stand for "
          "something else. ",
          candidate(*k).name);
      return text + change + changes(experiment, before, after) + by_chance;
    }
    Eigen::Index worst = 0;
    (after.misfit.frames - after.misfit.null_frames).maxCoeff(&worst);
    text += fmt::format(". It is largest in {}{}{}. ", experiment.frame_name(static_cast<int>(worst)),
                        in_its_force(experiment, after, static_cast<int>(worst)) ? ", in its force" : "",
                        most_frames_beyond(after) ? fmt::format(", and more than noise leaves in {} of {} frames",
                                                                frames_beyond(after), after.misfit.frames.size())
                                                  : "");
  }
  return text + change + changes(experiment, before, after) + by_chance;
}

}  // namespace

std::string sentence_of(const Experiment& experiment, const Report& report) {
  return verdict_in_words(experiment, report) + with_the_others(experiment, report) +
         told_by_one_frame(experiment, report) + left_in_held_out(experiment, report) +
         bounds(experiment, report.declared, report.final) + unlike_known(experiment, report.final);
}

}  // namespace imic3d::loop
