#include "loop_summary.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "imic3d/io/run_results.hpp"

namespace imic3d::app {

nlohmann::json numbers(const Eigen::VectorXd& values) {
  auto list = nlohmann::json::array();
  for (double value : values) list.push_back(std::isfinite(value) ? nlohmann::json(value) : nlohmann::json());
  return list;
}

namespace {

class Summary {
  using json = nlohmann::json;

 public:
  Summary(const loop::Experiment& experiment, const loop::Report& report) : experiment_(experiment), report_(report) {
    for (const auto& datum : experiment.data()) (datum.channel == loop::force_channel ? forces_ : images_) = true;
  }

  [[nodiscard]] json all() const {
    json summary = {{"verdict", std::string(name(report_.verdict))},
                    {"set", names(report_.set)},
                    {"named", names(report_.named)},
                    {"sentence", report_.sentence},
                    {"invisible", names(report_.invisible)},
                    {"next", next()}};
    if (report_.set.size() > 1 && report_.verdict == loop::Verdict::ambiguous)
      for (int k : report_.set) summary["ambiguity"].push_back(words_of(k));
    if (report_.part) summary["part_of_several_tests"] = true;
    summary["searched"] = report_.searched;
    if (report_.beyond_bounds)
      for (int j : report_.beyond_bounds->released)
        summary["beyond_bounds"][parameter(j).info.name] =
            report_.beyond_bounds->fit.values[static_cast<std::size_t>(j)];
    summary["frames"] = experiment_.frame_numbers();
    summary["held_out"] = json::array();
    for (std::size_t t = 0; t < report_.held_out.size(); ++t)
      if (report_.held_out[t] != 0) summary["held_out"].push_back(experiment_.frame_numbers()[t]);
    const auto& rounds = report_.rounds;
    summary["before"] = of_model(report_.declared, rounds.empty() ? nullptr : &rounds.front());
    summary["after"] = of_model(report_.final, rounds.empty() || rounds.back().kept ? nullptr : &rounds.back());
    summary["rounds"] = json::array();
    for (const auto& round : rounds) summary["rounds"].push_back(of_round(round));
    // what the case declares of effects as known
    for (const auto& one : experiment_.parameters())
      if (!one.free && one.info.null_value && one.value != *one.info.null_value)
        summary["known"][one.info.name] = {{"value", one.value}, {"unit", one.info.unit}};
    // as imic3d identify has them, of the final model
    summary["parameters"] = summary["after"]["parameters"];
    std::vector<std::string> free;
    for (const int j : report_.final.fit.free) free.push_back(parameter(j).info.name);
    if (auto covariance = io::covariance_of(free, covariance_of_seen(report_.final)); !covariance.is_null())
      summary["covariance"] = std::move(covariance);
    summary["remainder"] = {{"share_of_first_mode", report_.remainder.share},
                            {"time", numbers(report_.remainder.time)}};
    return summary;
  }

 private:
  [[nodiscard]] const loop::Candidate& candidate(int k) const {
    return experiment_.candidates()[static_cast<std::size_t>(k)];
  }
  [[nodiscard]] const loop::Parameter& parameter(int j) const {
    return experiment_.parameters()[static_cast<std::size_t>(j)];
  }
  [[nodiscard]] json names(const std::vector<int>& which) const {
    json list = json::array();
    for (int k : which) list.push_back(candidate(k).name);
    return list;
  }

  [[nodiscard]] json chi_of(const loop::Misfit& misfit) const {
    json chi = {{"fitted", misfit.fitted},           {"held_out", misfit.held_out},
                {"null_fitted", misfit.null_fitted}, {"null_held_out", misfit.null_held_out},
                {"frames", numbers(misfit.frames)},  {"null_frames", numbers(misfit.null_frames)}};
    if (images_ && forces_) {
      chi["images"] = misfit.images, chi["null_images"] = misfit.null_images;
      chi["force"] = misfit.force, chi["null_force"] = misfit.null_force;
    }
    if (misfit.null_checkerboard > 0.0)
      chi["checkerboard"] = misfit.checkerboard, chi["null_checkerboard"] = misfit.null_checkerboard;
    for (const auto& one : misfit.cameras)
      chi["cameras"][experiment_.channel_name(one.channel)] = {{"left_out", one.chi}, {"null", one.null}};
    return chi;
  }

  /// What is said of a candidate whatever was measured.
  [[nodiscard]] json words_of(int k) const {
    const auto& its = candidate(k);
    json one = {{"name", its.name},
                {"link", std::string(name(its.link))},
                {"sentence", its.sentence},
                {"confused_with", its.confused_with},
                {"separated_by", its.separated_by}};
    if (!its.formula_for.empty()) one["formula_for"] = its.formula_for;
    return one;
  }

  /// Shift of the free parameters by a size that is left out.
  [[nodiscard]] json shift(const loop::Model& model, const loop::Score& score, Eigen::Index column, double size) const {
    json shifts = json::object();
    for (Eigen::Index j = 0; j < score.bias.rows(); ++j)
      shifts[parameter(model.fit.free[static_cast<std::size_t>(j)]).info.name] = score.bias(j, column) * size;
    return shifts;
  }

  /// The sizes of a candidate, which come before its shapes.
  void add_sizes(json& one, int k, const loop::Model& model, const loop::Score& score) const {
    const auto& its = candidate(k).parameters;
    const auto sizes = std::count_if(its.begin(), its.end(), [&](int j) { return !parameter(j).info.shape; });
    Eigen::Index other = sizes;
    for (std::size_t c = 0; c < its.size(); ++c) {
      const auto& info = parameter(its[c]).info;
      if (info.shape) {
        if (!candidate(k).elsewhere.empty()) continue;  // looked for at many places
        for (double value : loop::other_shapes(parameter(its[c]), model.fit.values[static_cast<std::size_t>(its[c])])) {
          if (sizes == 1 && std::isfinite(score.detectable[other]))
            one["with_other_shapes"].push_back(
                {{"parameter", info.name}, {"value", value}, {"detectable", score.detectable[other]}});
          ++other;
        }
        continue;
      }
      const auto column = static_cast<Eigen::Index>(c);
      const double size = score.size[column], deviation = score.deviation[column],
                   detectable = score.detectable[column], usual = info.scale > 0.0 ? info.scale : 1.0;
      one["sizes"].push_back(
          {{"parameter", info.name},
           {"unit", info.unit},
           {"size", size},
           {"standard_deviation", deviation},
           {"interval", deviation > 0.0 ? json{size - 1.96 * deviation, size + 1.96 * deviation} : json()},
           {"detectable", detectable},
           {"shift_of_parameters_at_detectable_size", shift(model, score, column, detectable)},
           {"usual_size", usual},
           {"usual_size_is_unit", !(info.scale > 0.0)},
           {"shift_of_parameters_at_usual_size", shift(model, score, column, usual)}});
    }
  }

  [[nodiscard]] json scored(int k, const loop::Model& model, const loop::Score& score) const {
    json one = words_of(k);
    one["visible"] = score.visible(), one["shown_by_prior"] = score.shown_by_prior;
    one["kappa"] = score.visibility, one["z"] = score.z, one["p"] = score.p, one["degrees"] = score.degrees,
    one["predicted_drop"] = score.drop;
    one["significant"] = beyond_limit(model, score), one["contradicted"] = score.contradicted;
    add_sizes(one, k, model, score);
    return one;
  }

  [[nodiscard]] static bool beyond_limit(const loop::Model& model, const loop::Score& score) {
    return score.z > model.scores.threshold && !score.contradicted;
  }

  /// Candidates of a model; `round`: what was added to it on trial.
  [[nodiscard]] json candidates_of(const loop::Model& model, const loop::Round* round) const {
    json all = json::array();
    for (std::size_t i = 0; i < model.others.size(); ++i) {
      const int k = model.others[i];
      json one = scored(k, model, model.scores.candidates[i]);
      one["in_set"] = std::find(report_.set.begin(), report_.set.end(), k) != report_.set.end();
      if (!model.baselines.cosine.empty()) one["cosine"] = model.baselines.cosine[i];
      if (round != nullptr)
        for (const auto& trial : round->trials)
          if (trial.candidate == k)
            one["tried"] = {{"achieved_drop", trial.drop},
                            {"fitted", !trial.model.fit.values.empty()},
                            {"sufficient", trial.sufficient},
                            {"plausible", trial.plausible},
                            {"objection", trial.objection}};
      all.push_back(one);
    }
    return all;
  }

  [[nodiscard]] json not_tested(const loop::Model& model) const {
    json all = json::array();
    for (const auto& one : model.untested) {
      all.push_back(one.score ? scored(one.candidate, model, *one.score) : words_of(one.candidate));
      all.back()["reason"] = one.reason;
    }
    return all;
  }

  /// Without a number where a parameter is not seen, or not apart from others.
  [[nodiscard]] static Eigen::MatrixXd covariance_of_seen(const loop::Model& model) {
    Eigen::MatrixXd covariance = model.covariance;
    for (std::size_t i = 0; i < model.fit.free.size(); ++i)
      if (!loop::is_determined(model, model.fit.free[i])) {
        const auto place = static_cast<Eigen::Index>(i);
        covariance.row(place).setConstant(std::nan("")), covariance.col(place).setConstant(std::nan(""));
      }
    return covariance;
  }

  /// The largest score of those that are visible.
  [[nodiscard]] json largest_score(const loop::Model& model) const {
    json largest = {{"z", 0.0}, {"limit", model.scores.threshold}, {"contradicted", false}};
    double z = 0.0;
    for (std::size_t i = 0; i < model.others.size(); ++i) {
      const auto& score = model.scores.candidates[i];
      if (!score.visible() || score.z <= z) continue;
      z = score.z;
      largest["z"] = z, largest["candidate"] = candidate(model.others[i]).name,
      largest["contradicted"] = score.contradicted;
    }
    return largest;
  }

  [[nodiscard]] json fit_of(const loop::Model& model) const {
    json one = {{"added", names(model.added)},
                {"chi", chi_of(model.misfit)},
                {"converged", model.fit.converged},
                {"iterations", model.fit.iterations}};
    const Eigen::MatrixXd covariance = covariance_of_seen(model);
    for (std::size_t j = 0; j < model.fit.free.size(); ++j) {
      const auto& info = parameter(model.fit.free[j]).info;
      const auto place = static_cast<Eigen::Index>(j);
      const double value = model.fit.values[static_cast<std::size_t>(model.fit.free[j])];
      one["parameters"][info.name] = {{"value", value},
                                      {"standard_deviation", std::sqrt(covariance(place, place))},
                                      {"unit", info.unit},
                                      {"on_bound", loop::on_bound(parameter(model.fit.free[j]), value)}};
    }
    one["omnibus"] = {{"deviations", model.scores.omnibus},
                      {"threshold", model.scores.omnibus_threshold},
                      {"p", model.scores.omnibus_p}};
    one["threshold"] = model.scores.threshold, one["largest_p"] = model.scores.largest_p;
    one["level"] = model.added.empty() ? loop::level_of_scores : loop::level_after_addition;
    if (model.traced && !model.others.empty()) one["largest_score"] = largest_score(model);
    return one;
  }

  [[nodiscard]] json of_model(const loop::Model& model, const loop::Round* round) const {
    json one = fit_of(model);
    if (model.added.empty())
      one["baselines"] = {{"chi_squared_p", model.baselines.chi_squared_p}, {"bic", json::array()}};
    for (int i : model.baselines.bic)
      one["baselines"]["bic"].push_back(candidate(model.others[static_cast<std::size_t>(i)]).name);
    one["candidates"] = candidates_of(model, round);
    one["not_tested"] = not_tested(model);
    return one;
  }

  [[nodiscard]] json of_round(const loop::Round& round) const {
    json one = {{"set", names(round.set)}, {"trials", json::array()}};
    for (const auto& trial : round.trials) {
      json t = trial.model.fit.values.empty() ? json::object() : fit_of(trial.model);
      t["candidate"] = candidate(trial.candidate).name, t["sufficient"] = trial.sufficient,
      t["plausible"] = trial.plausible, t["objection"] = trial.objection, t["achieved_drop"] = trial.drop;
      one["trials"].push_back(t);
    }
    return one;
  }

  /// What to measure next: what separates the effects that the verdict leaves open, or shows those that this test
  /// cannot see.
  [[nodiscard]] json next() const {
    const auto verdict = report_.verdict;
    const auto& which = verdict == loop::Verdict::ambiguous       ? report_.set
                        : verdict == loop::Verdict::nothing_found ? report_.invisible
                                                                  : report_.named;
    json list = json::array();
    for (int k : which) {
      const auto& measurement = candidate(k).separated_by;
      if (measurement.empty()) continue;
      const auto same =
          std::find_if(list.begin(), list.end(), [&](const json& one) { return one["measurement"] == measurement; });
      if (same == list.end())
        list.push_back({{"measurement", measurement}, {"for", {candidate(k).name}}});
      else
        (*same)["for"].push_back(candidate(k).name);
    }
    json result = {{"measurements", list}};
    if (verdict != loop::Verdict::unexplained) return result;
    Eigen::Index worst = 0;
    (report_.final.misfit.frames - report_.final.misfit.null_frames).maxCoeff(&worst);
    result["look_at"] = experiment_.frame_name(static_cast<int>(worst));
    return result;
  }

  const loop::Experiment& experiment_;
  const loop::Report& report_;
  bool images_ = false, forces_ = false;  // whether there are numbers of the one and of the other
};

}  // namespace

nlohmann::json loop_summary(const loop::Experiment& experiment, const loop::Report& report) {
  return Summary(experiment, report).all();
}

std::string answer(const loop::Report& report, const std::string& sentence) {
  return report.searched ? fmt::format("{}: {}", name(report.verdict), sentence) : sentence;
}

}  // namespace imic3d::app
