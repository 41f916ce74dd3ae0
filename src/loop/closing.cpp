#include "imic3d/loop/closing.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "appraisal.hpp"
#include "ground.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/loop/effect.hpp"
#include "plausibility.hpp"
#include "remainder.hpp"
#include "sentence.hpp"
#include "starts.hpp"

namespace imic3d::loop {

std::string_view name(Verdict verdict) {
  switch (verdict) {
    case Verdict::nothing_found: return "nothing found";
    case Verdict::attributed: return "attributed";
    case Verdict::ambiguous: return "ambiguous";
    default: return "unexplained";
  }
}

bool is_determined(const Model& model, int parameter) {
  return std::count(model.fit.unseen.begin(), model.fit.unseen.end(), parameter) == 0 &&
         std::count(model.undetermined.begin(), model.undetermined.end(), parameter) == 0;
}

std::vector<int> held_out_blocks(int frames, int blocks) {
  std::vector<int> held;
  const int length = std::max(1, frames / (4 * blocks));
  for (int k = 0; k < blocks; ++k) {
    const int middle = static_cast<int>(std::lround((k + 0.5) * frames / blocks));
    for (int t = middle - length / 2; t < middle - length / 2 + length; ++t)
      if (t > 0 && t < frames - 1) held.push_back(t);
  }
  return held;
}

namespace {

std::vector<char> flags(int frames, const std::vector<int>& chosen) {
  std::vector<char> flag(static_cast<std::size_t>(frames), 0);
  for (int t : chosen) flag.at(static_cast<std::size_t>(t)) = 1;
  return flag;
}

std::vector<std::string> names_of(const std::vector<Candidate>& candidates) {
  std::vector<std::string> names;
  for (const auto& one : candidates) names.push_back(one.name);
  return names;
}

class Loop {
 public:
  Loop(Experiment& experiment, const LoopOptions& options, const std::function<void(const std::string&)>& say)
      : experiment_(experiment),
        options_(options),
        say_(say),
        frames_(static_cast<int>(experiment.frame_numbers().size())),
        held_out_(
            flags(frames_, options.held_out.empty() && options.search ? held_out_blocks(frames_) : options.held_out)),
        appraisal_(experiment, held_out_, options.search ? options.leave_out : names_of(experiment.candidates())),
        rows_(appraisal_.fitted_rows()) {}

  Report run() {
    identify_declared();
    Model at = report_.declared;
    search(at);
    if (report_.verdict == Verdict::unexplained && report_.named.size() > 1) exchange_formulas(at);
    if (report_.verdict == Verdict::unexplained && !report_.rounds.empty()) look_ahead(at);
    if (report_.verdict == Verdict::attributed && report_.rounds.size() > 1 && report_.named.size() == 1)
      compare_with_alike(at);
    if (report_.set.empty() && report_.verdict == Verdict::attributed) report_.set = report_.named;
    if (report_.verdict != Verdict::nothing_found) look_beyond_bounds(at);
    report_.held_out = held_out_, report_.searched = options_.search;
    report_.final = std::move(at);
    find_invisible();
    find_remainder();
    report_.sentence = sentence_of(experiment_, report_);
    return std::move(report_);
  }

 private:
  const Candidate& candidate(int j) const { return experiment_.candidates()[static_cast<std::size_t>(j)]; }
  void say(const std::string& line) const {
    if (say_) say_(line);
  }

  /// Adds what suffices, or helps most, to the model, until nothing is left or nothing helps.
  void search(Model& at) {
    while (true) {
      if (!significant(at)) {
        report_.verdict = report_.named.empty()           ? Verdict::nothing_found
                          : without_size(experiment_, at) ? Verdict::unexplained
                                                          : Verdict::attributed;
        return;
      }
      if (!options_.search || static_cast<int>(at.added.size()) >= options_.additions) {
        report_.verdict = Verdict::unexplained;
        return;
      }
      if (!add(try_candidates(at), at)) return;
    }
  }

  /// Adds what is kept of a round, and keeps the round. False where the search is over: one suffices, or none helps.
  bool add(Round round, Model& at) {
    for (Trial& trial : round.trials)
      if (!trial.model.fit.values.empty()) trial.drop = appraisal_.drop(at, trial.model);
    const bool last = !round.set.empty();
    const Trial* best = choose(round, at);
    round.kept = best != nullptr;
    report_.rounds.push_back(round);
    if (best == nullptr) {
      report_.verdict = Verdict::unexplained;
      return false;
    }
    report_.named.push_back(best->candidate);
    say(fmt::format("added: {}", candidate(best->candidate).name));
    at = best->model;
    experiment_.put_back(at.ground->learned);
    if (!at.traced) appraisal_.trace(at);
    if (last || !significant(at)) take_out_needless(at);
    if (!last) return true;
    report_.set = round.set;
    report_.verdict = round.set.size() == 1 ? Verdict::attributed : Verdict::ambiguous;
    return false;
  }

  std::vector<int> free_of(const std::vector<int>& added, const std::vector<int>& idle = {}) const {
    std::vector<int> free;
    for (std::size_t j = 0; j < experiment_.parameters().size(); ++j)
      if (experiment_.parameters()[j].free) free.push_back(static_cast<int>(j));
    for (int k : added)
      for (int j : candidate(k).parameters)
        if (std::find(free.begin(), free.end(), j) == free.end() &&
            std::find(idle.begin(), idle.end(), j) == idle.end())
          free.push_back(j);
    return free;
  }

  void identify_declared() {
    std::vector<double> values;
    for (const auto& p : experiment_.parameters()) values.push_back(p.value);
    const auto free = free_of({});
    Weight plain(experiment_.data(), {});
    say("identification under the declared model");
    Fit best;
    std::string failure;
    for (double factor : options_.starts) {
      std::vector<double> start = values;
      for (int j : free) {
        const auto& info = experiment_.parameters()[static_cast<std::size_t>(j)].info;
        auto& value = start[static_cast<std::size_t>(j)];
        if (!info.null_value) value = std::clamp(factor * value, info.lower, info.upper);
      }
      try {
        Fit one = fit(experiment_, plain, rows_, free, start);
        say(fmt::format("  from {:.0f} %: chi {:.3f} after {} iterations", 100.0 * factor, chi(one), one.iterations));
        if (best.values.empty() || one.cost < best.cost) best = std::move(one);
      } catch (const ConvergenceError& error) {
        failure = error.what();
        say(fmt::format("  from {:.0f} %: {}", 100.0 * factor, failure));
      }
    }
    if (best.values.empty()) throw ConvergenceError(failure);
    // What the mesh and the correlation err by is learned at the first parameters, unless it was near them, and again
    // at those that it leads to.
    for (int pass = 0; pass < 2; ++pass) {
      if (const auto known = experiment_.learned(); known && !known->at.empty() && !moved_far(known->at, best))
        break;  // scatter of bars, which is put back with no model, is learned again
      const std::vector<double> at = best.values;
      say("  synthetic tests, made by finer models: what mesh, correlation and scatter err by");
      try {
        experiment_.learn_bias(at);
      } catch (const ConvergenceError& error) {
        if (const auto known = experiment_.learned(); !known || known->at.empty()) throw;
        say(fmt::format("  what was learned before stands: {}", error.what()));
        break;
      }
      best = fit(experiment_, plain, rows_, free, at);
      say(fmt::format("  what mesh, correlation and scatter err by is learned: chi {:.3f}", chi(best)));
    }
    say(fmt::format("null ensemble: {} + {} draws of the noise", options_.draws, experiment_.draws(options_.draws)));
    report_.declared.ground = ground_of(experiment_, best.values, options_.draws);
    report_.declared.fit = fit(experiment_, report_.declared.ground->weight, rows_, free, best.values);
    if (!std::isfinite(report_.declared.fit.cost))
      throw ConvergenceError("the residual of the declared model is no number in units of its noise");
    appraisal_.judge(report_.declared);
    announce(report_.declared, "declared model");
  }

  /// Whether what was learned at `values` is to be learned again: it goes with the motion, and what is learned of it is
  /// doubted by far more than a fiftieth.
  static bool moved_far(const std::vector<double>& values, const Fit& fit) {
    return std::any_of(fit.free.begin(), fit.free.end(), [&](int j) {
      const double was = values[static_cast<std::size_t>(j)], now = fit.values[static_cast<std::size_t>(j)];
      return std::abs(now - was) > 0.02 * std::abs(was);
    });
  }

  double chi(const Fit& fit) const { return std::sqrt(fit.cost / static_cast<double>(rows_.size())); }
  double chi_held_out(const Fit& fit) const {
    const auto& rows = appraisal_.held_out_rows();
    return Eigen::VectorXd(fit.residual(rows)).norm() /
           std::sqrt(static_cast<double>(std::max<std::size_t>(1, rows.size())));
  }
  /// Square of the residual. Frames that are fitted leave places or moments alike between which a held-out frame lies:
  /// that one tells them apart.
  double cost(const Fit& fit, bool held_out_too) const {
    return fit.cost + (held_out_too ? Eigen::VectorXd(fit.residual(appraisal_.held_out_rows())).squaredNorm() : 0.0);
  }

  /// Identifies a model from `start`. What acts somewhere stays there, and has its size alone, unless setting it free
  /// takes more off chi^2 than chance would (10 a number), that of the held-out frames, too: of a moment between two
  /// frames that are fitted these say no more, and it would go astray.
  Fit identified(const Weight& weight, const Model& model, const std::vector<double>& start) const {
    const std::vector<int> free = free_of(model.added, model.idle);
    std::vector<int> held = free;
    for (int k : model.added)
      if (!candidate(k).elsewhere.empty())
        std::erase_if(held, [&](int j) {
          return experiment_.parameters()[static_cast<std::size_t>(j)].info.shape &&
                 std::count(candidate(k).parameters.begin(), candidate(k).parameters.end(), j) > 0;
        });
    if (held.size() == free.size()) return fit(experiment_, weight, rows_, free, start, {.released = model.released});
    const Fit there = fit(experiment_, weight, rows_, held, start);
    Fit all = fit(experiment_, weight, rows_, free, there.values);
    if (cost(there, true) - cost(all, true) > 10.0 * static_cast<double>(free.size() - held.size())) return all;
    all = fit(experiment_, weight, rows_, free, there.values, {.max_iterations = 0});
    all.converged = there.converged, all.iterations = there.iterations;
    return all;
  }

  /// A model that is another one than that under which the ground was laid: what it errs by, and what noise leaves, is
  /// found anew.
  void settle(Model& model) const {
    experiment_.learn_bias(model.fit.values);
    const Weight weight = model.ground->weight;
    const std::vector<double> at = model.fit.values;
    model.fit = identified(weight, model, at);
    if (moved_far(at, model.fit)) experiment_.learn_bias(model.fit.values);
    model.ground = ground_of(experiment_, model.fit.values, options_.draws);
    model.fit = identified(model.ground->weight, model, model.fit.values);
  }

  void announce(const Model& model, const std::string& what) const {
    say(fmt::format(
        "{}: chi {:.3f} (null {:.3f}), held out {:.3f} (null {:.3f}), images {:.3f}, force {:.3f}; energy {:+.1f} sd "
        "(limit {:.1f})",
        what, model.misfit.fitted, model.misfit.null_fitted, model.misfit.held_out, model.misfit.null_held_out,
        model.misfit.images, model.misfit.force, model.scores.omnibus, model.scores.omnibus_threshold));
    for (const auto& one : model.misfit.cameras)
      say(fmt::format("    {} under the parameters of the others: chi {:.3f} (null {:.3f})",
                      experiment_.channel_name(one.channel), one.chi, one.null));
    std::vector<std::size_t> order(model.others.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
      return model.scores.candidates[a].z > model.scores.candidates[b].z;
    });
    for (std::size_t i = 0; i < std::min<std::size_t>(5, order.size()); ++i) {
      const auto& s = model.scores.candidates[order[i]];
      say(fmt::format("    {:24} z {:6.2f} (limit {:.2f})  kappa {:.3f}  size {:.3g} +- {:.2g}{}",
                      candidate(model.others[order[i]]).name, s.z, model.scores.threshold, s.visibility, s.size[0],
                      s.deviation[0], s.contradicted ? "; not so in the held-out frames" : ""));
    }
  }

  /// Beside an effect that is still missing another formula for the same function may have helped more. Where the
  /// search ends unexplained each that was added gives way to the others that have been tried, those beside it staying.
  void exchange_formulas(Model& at) {
    const auto& tried = report_.rounds.front().trials;
    for (std::size_t i = 0; i < at.added.size(); ++i)
      for (const Trial& other : tried) {
        const Candidate &was = candidate(at.added[i]), &now = candidate(other.candidate);
        if (was.formula_for.empty() || now.formula_for != was.formula_for || other.model.fit.values.empty() ||
            std::count(at.added.begin(), at.added.end(), other.candidate) > 0)
          continue;
        Trial trial;
        trial.candidate = other.candidate;
        trial.model.added = at.added, trial.model.added[i] = other.candidate;
        trial.model.ground = at.ground;
        std::copy_if(at.idle.begin(), at.idle.end(), std::back_inserter(trial.model.idle),
                     [&](int j) { return std::count(was.parameters.begin(), was.parameters.end(), j) == 0; });
        std::vector<double> start = other.model.fit.values;
        for (const int k : at.added)
          for (const int j : k == at.added[i] ? std::vector<int>{} : candidate(k).parameters)
            start[static_cast<std::size_t>(j)] = at.fit.values[static_cast<std::size_t>(j)];
        say(fmt::format("{} in the place of {}:", now.name, was.name));
        experiment_.put_back(at.ground->learned);
        try {
          trial.model.fit = identified(at.ground->weight, trial.model, start);
          if (at.ground->learned && trial.model.fit.cost < at.fit.cost) settle(trial.model);
        } catch (const ConvergenceError& error) {
          say(fmt::format("    {}: {}", now.name, error.what()));
          continue;
        }
        judge_by_what_is_told(trial, report_.declared);
        if (!trial.sufficient || !trial.plausible) continue;
        at = trial.model;
        trial.drop = appraisal_.drop(report_.declared, at);
        report_.named = at.added;
        report_.verdict = Verdict::attributed;
        if (!at.traced) appraisal_.trace(at);
        take_out_needless(at);
        report_.set = {at.added.back()};
        report_.rounds.push_back({.trials = {std::move(trial)}, .set = report_.set, .kept = true});
        return;
      }
    experiment_.put_back(at.ground->learned);
  }

  /// Of two large effects together each has a size that the parts of the test disagree about while the other is
  /// missing, and one that is like both may have none. Where the search ends unexplained those that the parts disagree
  /// about, and that help more than what was added first, have a round beside them, `rivals` of them at most. Where
  /// another one suffices there, the search is taken up from that one, if it helps alone: the set is then of all that
  /// the first may be.
  void look_ahead(Model& at) {
    if (options_.additions < 2) return;
    const Model& declared = report_.declared;
    const Round first = report_.rounds.front();
    const Trial* best = choose(first, declared);
    std::vector<const Trial*> torn;
    for (const Trial& trial : first.trials)
      if (trial.disagrees && helps(trial, declared) && (best == nullptr || trial.model.fit.cost < best->model.fit.cost))
        torn.push_back(&trial);
    std::sort(torn.begin(), torn.end(),
              [](const Trial* a, const Trial* b) { return a->model.fit.cost < b->model.fit.cost; });
    if (torn.size() > static_cast<std::size_t>(options_.rivals)) torn.resize(static_cast<std::size_t>(options_.rivals));
    const auto beside = [&](const Trial& trial) {
      std::pair both(trial.model, Round{});
      say(fmt::format("beside {}, about whose size parts of the test may disagree for another effect's sake:",
                      candidate(trial.candidate).name));
      try {
        experiment_.put_back(both.first.ground->learned);
        if (!both.first.traced) appraisal_.trace(both.first);
        both.second = try_candidates(both.first, false);
      } catch (const ConvergenceError& error) {  // the verdict stays as it is
        say(fmt::format("    beside {}: {}", candidate(trial.candidate).name, error.what()));
      }
      return both;
    };
    for (const Trial* trial : torn) {
      auto [model, round] = beside(*trial);
      if (round.set.empty()) continue;
      const auto other = std::find_if(first.trials.begin(), first.trials.end(), [&](const Trial& one) {
        return one.candidate == round.set.front() && (one.plausible || one.disagrees);
      });
      if (other != first.trials.end())
        if (auto turned = beside(*other);
            turned.second.set.size() >= round.set.size() &&
            std::count(turned.second.set.begin(), turned.second.set.end(), trial->candidate) > 0)
          std::tie(model, round) = std::move(turned);
      report_.rounds.resize(1);
      report_.rounds.front().kept = true;
      report_.named = {model.added.back()};
      at = std::move(model);
      add(std::move(round), at);
      return;
    }
    experiment_.put_back(at.ground->learned);
  }

  /// A bound that was declared may be what is wrong: whether nothing is left where the parameters that their bounds
  /// hold may go farther.
  void look_beyond_bounds(const Model& at) {
    const Model& declared = report_.declared;
    if (declared.fit.held.empty()) return;
    Model beyond;
    beyond.released = declared.fit.held;
    beyond.ground = declared.ground;
    experiment_.put_back(declared.ground->learned);
    try {
      beyond.fit = identified(beyond.ground->weight, beyond, declared.fit.values);
      settle(beyond);
      appraisal_.judge(beyond);
      announce(beyond, "declared model, beyond its bounds");
      if (!significant(beyond)) report_.beyond_bounds = std::move(beyond);
    } catch (const ConvergenceError& error) {  // the verdict stays as it is
      say(fmt::format("    beyond its bounds: {}", error.what()));
    }
    experiment_.put_back(at.ground->learned);
    if (report_.beyond_bounds && report_.verdict == Verdict::attributed) report_.verdict = Verdict::ambiguous;
  }

  /// `all`: those that do not belong to the best ones have their turn, too, where none of these suffices.
  Round try_candidates(const Model& at, bool all = true) {
    const std::vector<Score>& scores = at.scores.candidates;
    const auto is_in = [](const std::vector<std::size_t>& list, std::size_t i) {
      return std::find(list.begin(), list.end(), i) != list.end();
    };
    double best = INFINITY;
    for (const Score& one : scores)
      if (beyond_limit(at, one)) best = std::isinf(best) ? one.z : std::max(best, one.z);
    // Where one is beyond the limit, it is by chance that another one which is as good is not.
    std::vector<std::size_t> waiting, doubtful;
    for (std::size_t i = 0; i < at.others.size(); ++i)
      if (stands_out(at, scores[i]) || (scores[i].visible() && !scores[i].contradicted && as_good(scores[i].z, best)))
        waiting.push_back(i);
    for (std::size_t i = 0; i < at.others.size(); ++i)
      if (!is_in(waiting, i) && (waiting.empty() ? beyond_limit(at, scores[i]) : scores[i].z > at.scores.threshold))
        doubtful.push_back(i);
    for (auto* list : {&waiting, &doubtful})
      std::sort(list->begin(), list->end(), [&](std::size_t a, std::size_t b) { return scores[a].z > scores[b].z; });
    // As many as are asked for, and all that are as good as the best.
    const auto taken_from = [&](std::vector<std::size_t>& list) {
      std::size_t count = std::min(list.size(), static_cast<std::size_t>(options_.rivals));
      while (count < list.size() && as_good(scores[list[count]].z, scores[list.front()].z)) ++count;
      const auto end = list.begin() + static_cast<std::ptrdiff_t>(count);
      const std::vector<std::size_t> taken(list.begin(), end);
      list.erase(list.begin(), end);
      return taken;
    };
    const std::vector<std::size_t> seen = taken_from(waiting);
    doubtful = taken_from(doubtful);
    // Far from the truth the linear score says nothing of an effect whose mark changes with its size: it may be that of
    // a negative one.
    std::vector<std::size_t> afar;
    for (std::size_t i = 0; i < at.others.size(); ++i)
      if (from_afar(experiment_, at, at.others[i]) && scores[i].visible() && !is_in(seen, i)) afar.push_back(i);
    std::erase_if(waiting, [&](std::size_t i) { return is_in(afar, i); });
    // An invisible effect, or one that the held-out frames speak against, whose score is as large as those of all
    // others, within their noise, may be what is there: it is named where it suffices, after those.
    std::erase_if(doubtful, [&](std::size_t i) {
      return is_in(afar, i) || (!seen.empty() && scores[i].z < scores[seen.front()].z - 1.0);
    });

    Round round;
    for (std::size_t i : seen) try_out(round, at, i, true);
    for (std::size_t i : afar) {
      // Only the large misfit asks for it: not where the test itself, its record or its cameras explain all of it.
      if (std::any_of(round.set.begin(), round.set.end(), [&](int k) { return candidate(k).link != Link::material; }))
        break;
      try_out(round, at, i, true);
    }
    for (std::size_t i : doubtful) try_out(round, at, i, false);
    // Of two effects together a third that is like both may have the larger score, and help nothing: before no known
    // effect explains it, all beyond the limit have their turn. So have, before one that does not suffice is added,
    // those whose score is at least half of the largest: the ones before them may only be like what is there.
    const auto near_the_largest = [&](std::size_t i) { return scores[i].z > 0.5 * scores[seen.front()].z; };
    while (all && !waiting.empty() &&
           (choose(round, at) == nullptr || (round.set.empty() && near_the_largest(waiting.front()))))
      for (std::size_t i : taken_from(waiting)) try_out(round, at, i, true);
    // "Alone" is said of what was told from all that are as good as it.
    const auto as_good_as_one_that_suffices = [&](std::size_t i) {
      return std::any_of(round.set.begin(), round.set.end(), [&](int k) {
        const auto& other =
            scores[static_cast<std::size_t>(std::find(at.others.begin(), at.others.end(), k) - at.others.begin())];
        return stands_out(at, other) && as_good(scores[i].z, other.z);
      });
    };
    for (auto next = waiting.begin(); next != waiting.end();) {
      if (!as_good_as_one_that_suffices(*next)) break;
      const std::size_t i = *next;
      next = waiting.erase(next);
      try_out(round, at, i, true);
    }
    // A law's formula need not be the material's own: the little that it leaves is no second effect.
    if (round.set.empty())
      for (Trial& trial : round.trials)
        if (trial.visible && trial.plausible && formulas_alone(trial.model) && !without_size(experiment_, trial.model))
          trial.sufficient = true, round.set.push_back(trial.candidate);
    // The earlier link first where the data do not tell, invisible effects behind.
    const auto place = [&](int k) {
      const auto trial =
          std::find_if(round.trials.begin(), round.trials.end(), [k](const Trial& one) { return one.candidate == k; });
      return std::pair(!trial->visible, candidate(k).link);
    };
    std::stable_sort(round.set.begin(), round.set.end(), [&](int a, int b) { return place(a) < place(b); });
    experiment_.put_back(at.ground->learned);
    return round;
  }

  /// Identifies `at` with its candidate `i` added, judges what that leaves, and puts it into the round.
  void try_out(Round& round, const Model& at, std::size_t i, bool visible) {
    Trial trial;
    experiment_.put_back(at.ground->learned);
    trial.model.ground = at.ground;
    trial.candidate = at.others[i];
    trial.visible = visible;
    trial.model.added = at.added, trial.model.idle = at.idle;
    trial.model.added.push_back(trial.candidate);
    const bool several_ways = shaped(experiment_, trial.candidate) || from_afar(experiment_, at, trial.candidate),
               somewhere = !candidate(trial.candidate).elsewhere.empty();
    bool fitted = false;
    const auto starts = starts_of(experiment_, at, i);
    for (std::size_t n = 0; n < starts.size(); ++n) {
      try {
        Fit one = identified(at.ground->weight, trial.model, starts[n]);
        say(fmt::format("    {}, start {} of up to {}: chi {:.3f} after {} iterations", candidate(trial.candidate).name,
                        n + 1, starts.size(), chi(one), one.iterations));
        if (!fitted || cost(one, somewhere) < cost(trial.model.fit, somewhere)) trial.model.fit = std::move(one);
        fitted = true;
        const bool down_to_noise = chi(trial.model.fit) < at.misfit.null_fitted &&
                                   !(somewhere && chi_held_out(trial.model.fit) > at.misfit.null_held_out);
        if (trial.model.fit.converged && trial.model.fit.cost < at.fit.cost && (!several_ways || down_to_noise)) break;
      } catch (const ConvergenceError& error) {
        trial.model.message = error.what();
      }
    }
    if (!fitted) {
      trial.plausible = false;
      trial.objection = trial.model.message;
      round.trials.push_back(std::move(trial));
      return;
    }
    if (at.ground->learned && trial.model.fit.cost < 0.7 * at.fit.cost && !outdone(round, trial.model.fit, at)) {
      Model settled = trial.model;
      say("    what the model with it errs by, and its null, are found anew");
      try {
        settle(settled);
        trial.model = std::move(settled);
      } catch (const ConvergenceError& error) {
        experiment_.put_back(at.ground->learned);
        say(fmt::format("    with {}: {}", candidate(trial.candidate).name, error.what()));
      }
    }
    judge_by_what_is_told(trial, at);
    // What bends freely enough to take up what is left, and is not told from nothing, names nothing; an invisible
    // effect may stand beside one that does.
    if (trial.sufficient && trial.plausible && (trial.visible || round.set.empty()) &&
        !has_size(experiment_, trial.model, trial.candidate)) {
      trial.sufficient = false, trial.objection = "nothing is left, but its size is not told from its null value";
      say_objection(trial);
    }
    if (trial.sufficient && trial.plausible) round.set.push_back(trial.candidate);
    round.trials.push_back(std::move(trial));
  }

  void judge_by_what_is_told(Trial& trial, const Model& at) {
    judge_trial(trial, at);
    while (trial.sufficient)
      if (!leave_out_untold(trial, at)) break;
    say_objection(trial);
  }

  /// Whether a candidate leaves more than a quarter of what noise does not explain, where another one leaves nothing:
  /// what its model errs by would make it another answer only if that were as large as what is missing.
  bool outdone(const Round& round, const Fit& fit, const Model& at) const {
    const double null = at.misfit.null_fitted * at.misfit.null_fitted;
    return !round.set.empty() && chi(fit) * chi(fit) - null > 0.25 * (at.misfit.fitted * at.misfit.fitted - null);
  }

  void say_objection(const Trial& trial) const {
    if (!trial.objection.empty()) say((trial.plausible ? "    " : "    not plausible: ") + trial.objection);
  }

  void judge_trial(Trial& trial, const Model& at) {
    trial.model.of_law = at.of_law;
    if (candidate(trial.candidate).link == Link::material)
      trial.model.of_law += std::max(0.0, appraisal_.drop(at, trial.model));
    try {
      appraisal_.judge(trial.model);
      weigh(trial, at, experiment_, appraisal_);
      announce(trial.model, "with " + candidate(trial.candidate).name);
    } catch (const ConvergenceError& error) {
      trial.model.others.clear();  // without scores
      trial.sufficient = trial.plausible = false;
      trial.objection = error.what();
    }
  }

  /// Of an effect that suffices one of the sizes that the data do not tell beside its others goes to its null value, if
  /// the effect suffices and is plausible then. A uniform tension tells R_33 and dilatancy by the width; R_22 and
  /// friction are the yield stress by another name there, and would take it anywhere. A shape goes to its usual value,
  /// unless chi^2 grows by more than chance then.
  bool leave_out_untold(Trial& trial, const Model& at) {
    for (const int j : appraisal_.untold(trial.model, trial.candidate)) {
      const auto& info = experiment_.parameters()[static_cast<std::size_t>(j)].info;
      Trial less;
      less.candidate = trial.candidate, less.visible = trial.visible;
      less.model.added = trial.model.added, less.model.idle = trial.model.idle, less.model.ground = trial.model.ground;
      less.model.idle.push_back(j);
      std::vector<double> start = trial.model.fit.values;
      if (!info.shape) start[static_cast<std::size_t>(j)] = info.null_value.value_or(0.0);
      for (const int k : info.shape ? candidate(trial.candidate).parameters : std::vector<int>{})
        start[static_cast<std::size_t>(k)] = at.fit.values[static_cast<std::size_t>(k)];
      say(fmt::format("    {} {}, which is not told", info.shape ? "with a fixed" : "without", info.name));
      try {
        less.model.fit = identified(less.model.ground->weight, less.model, start);
        judge_trial(less, at);
      } catch (const ConvergenceError& error) {
        say(fmt::format("    without {}: {}", info.name, error.what()));
        continue;
      }
      if (!less.sufficient || !less.plausible || (info.shape && less.model.fit.cost > trial.model.fit.cost + 10.0)) {
        say_objection(less);
        continue;
      }
      trial = std::move(less);
      return true;
    }
    return false;
  }

  /// An effect that helped before another one sufficed may be needed no more: what is left without it tells.
  void take_out_needless(Model& at) {
    for (std::size_t i = at.added.size() - 1; i-- > 0;) {
      const int needless = at.added[i];
      Model without;
      without.ground = at.ground;
      without.added = at.added;
      without.added.erase(without.added.begin() + static_cast<std::ptrdiff_t>(i));
      std::copy_if(at.idle.begin(), at.idle.end(), std::back_inserter(without.idle), [&](int j) {
        return std::count(candidate(needless).parameters.begin(), candidate(needless).parameters.end(), j) == 0;
      });
      std::vector<double> start = at.fit.values;
      for (int j : candidate(needless).parameters)
        start[static_cast<std::size_t>(j)] = experiment_.parameters()[static_cast<std::size_t>(j)].value;
      const auto suffices = [&] {
        appraisal_.judge(without);
        announce(without, "without " + candidate(needless).name);
        return !significant(without) &&
               without.misfit.held_out <= std::max(1.02 * at.misfit.held_out, at.misfit.null_held_out);
      };
      bool enough = false;
      try {
        without.fit = identified(at.ground->weight, without, start);
        enough = suffices();
        if (enough && at.ground->learned) settle(without), enough = suffices();
      } catch (const ConvergenceError& error) {
        say(fmt::format("without {}: {}", candidate(needless).name, error.what()));
        enough = false;
      }
      if (!enough) {
        experiment_.put_back(at.ground->learned);
        continue;
      }
      say("taken out again: " + candidate(needless).name);
      if (!without.traced) appraisal_.trace(without);
      std::erase(report_.named, needless);
      at = std::move(without);
    }
  }

  /// One that is left alone where those before it were taken out again: those that were as good as it under the
  /// declared model, and have not been tried there, may be what is missing as well.
  void compare_with_alike(const Model& at) {
    const Model& declared = report_.declared;
    const auto& tried = report_.rounds.front().trials;
    const int alone = report_.named.front();
    const auto score_of = [&](int k) {
      const auto place = std::find(declared.others.begin(), declared.others.end(), k) - declared.others.begin();
      return place < std::ssize(declared.others) ? declared.scores.candidates[static_cast<std::size_t>(place)].z
                                                 : INFINITY;
    };
    Round round;
    for (std::size_t i = 0; i < declared.others.size(); ++i) {
      const int k = declared.others[i];
      const bool was_tried =
          std::any_of(tried.begin(), tried.end(), [k](const Trial& trial) { return trial.candidate == k; });
      if (k != alone && !was_tried && stands_out(declared, declared.scores.candidates[i]) &&
          as_good(score_of(k), score_of(alone)))
        try_out(round, declared, i, true);
    }
    experiment_.put_back(at.ground->learned);
    if (round.set.empty()) return;
    report_.set = round.set;
    report_.set.push_back(alone);
    std::stable_sort(report_.set.begin(), report_.set.end(),
                     [&](int a, int b) { return candidate(a).link < candidate(b).link; });
    report_.verdict = Verdict::ambiguous;
    round.kept = true;
    report_.rounds.push_back(std::move(round));
  }

  /// Whether a score is as large as another one, within noise and a twentieth: marks are tangents, which err by some
  /// percent.
  static bool as_good(double z, double other) { return z >= other - std::max(1.0, other / 20.0); }

  /// Whether it takes a fifth of what noise does not explain, on fitted and on held-out frames.
  bool helps(const Trial& trial, const Model& at) const {
    const auto excess = [](double chi, double null) { return std::max(0.0, chi * chi - null * null); };
    const Misfit &now = trial.model.misfit, &was = at.misfit;
    return trial.visible && excess(now.held_out, now.null_held_out) <= 0.8 * excess(was.held_out, was.null_held_out) &&
           excess(now.fitted, now.null_fitted) <= 0.8 * excess(was.fitted, was.null_fitted) &&
           trial.model.fit.cost < at.fit.cost;
  }

  /// What is kept of a round: the sufficient candidate of the earliest link, else the one that helps most, if any does.
  const Trial* choose(const Round& round, const Model& at) const {
    const Trial* best = nullptr;
    for (const Trial& trial : round.trials) {
      if (!trial.plausible) continue;
      if (!round.set.empty()) {
        if (trial.candidate == round.set.front()) return &trial;
        continue;
      }
      if (helps(trial, at) && (best == nullptr || trial.model.fit.cost < best->model.fit.cost)) best = &trial;
    }
    return best;
  }

  void find_invisible() {
    const Model& model = report_.declared;
    for (std::size_t i = 0; i < model.others.size(); ++i)
      if (!model.scores.candidates[i].visible()) report_.invisible.push_back(model.others[i]);
    for (const Untested& one : model.untested)
      if (one.score) report_.invisible.push_back(one.candidate);
  }

  void find_remainder() {
    const auto leftover = [&](const Model& model) { return leftover_of(model, appraisal_.left_of_null(model)); };
    const Leftover after = leftover(report_.final);
    report_.remainder = report_.named.empty() ? remainder_of(experiment_, after, after)
                                              : remainder_of(experiment_, leftover(report_.declared), after);
  }

  Experiment& experiment_;
  const LoopOptions& options_;
  const std::function<void(const std::string&)>& say_;
  int frames_;
  std::vector<char> held_out_;
  Appraisal appraisal_;
  const std::vector<Eigen::Index>& rows_;  // those that are fitted
  Report report_;
};

}  // namespace

Report close_loop(Experiment& experiment, const LoopOptions& options,
                  const std::function<void(const std::string&)>& say) {
  return Loop(experiment, options, say).run();
}

}  // namespace imic3d::loop
