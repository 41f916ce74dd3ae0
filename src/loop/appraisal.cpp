#include "appraisal.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <tuple>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/loop/effect.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace {
/// Of a usual step of a candidate, in units of the noise: less than that is round-off.
constexpr double no_mark = 1e-7;

/// Whether what is left of a mark is what the noise of the ends makes of it, told by opposite draws of that: a
/// twentieth of its square moves a score by about a standard deviation.
bool is_noise(const Eigen::VectorXd& own, const Eigen::VectorXd& up, const Eigen::VectorXd& down) {
  return 0.25 * (up - down).squaredNorm() > 0.05 * own.squaredNorm();
}

/// What the sensitivities leave of these columns.
Eigen::MatrixXd left(const Eigen::MatrixXd& sensitivity, const Eigen::MatrixXd& columns) {
  return columns - sensitivity * (pseudo_inverse(sensitivity) * columns);
}

std::string why_without(const Mark& mark, double step) {
  if (mark.failed > 0) return "the model could not be computed with it";
  return mark.columns.norm() * step < no_mark ? "it changes nothing that was measured"
                                              : "it changes nothing in the frames that are fitted";
}

/// Importance beside significance: a fifth of the excess energy, or a shift of a parameter by 1 % or by one standard
/// deviation.
bool matters(const Model& model, const Score& s) {
  const double excess = std::max(0.0, model.scores.energy - model.scores.null_energy);
  if (s.statistic >= 0.2 * excess) return true;
  const Eigen::VectorXd shift = (s.bias * s.size).cwiseAbs();
  for (Eigen::Index j = 0; j < shift.size(); ++j)
    if (shift[j] > 0.0 &&
        (shift[j] >=
             0.01 * std::abs(model.fit.values[static_cast<std::size_t>(model.fit.free[static_cast<std::size_t>(j)])]) ||
         shift[j] >= std::sqrt(model.covariance(j, j))))
      return true;
  return false;
}
}  // namespace

Known known_of(const Experiment& experiment, const Model& model) {
  const Fit& fit = model.fit;
  const auto& parameters = experiment.parameters();
  const auto place_of = [&](int j) { return std::find(fit.free.begin(), fit.free.end(), j) - fit.free.begin(); };
  std::vector<int> of;
  for (int j = 0; j < static_cast<int>(parameters.size()); ++j)
    if (const Parameter& p = parameters[static_cast<std::size_t>(j)];
        p.prior > 0.0 && (p.reading || place_of(j) < std::ssize(fit.free)))
      of.push_back(j);
  const auto count = std::ssize(of);
  Known result{of, Eigen::VectorXd(count), Eigen::MatrixXd::Zero(count, std::ssize(fit.free)),
               Eigen::MatrixXd(count, model.ground->null.cols())};
  for (Eigen::Index k = 0; k < count; ++k) {
    const auto j = static_cast<std::size_t>(of[static_cast<std::size_t>(k)]);
    result.residual[k] = (parameters[j].expected() - fit.values[j]) / parameters[j].prior;
    if (const auto i = place_of(static_cast<int>(j)); i < std::ssize(fit.free))
      result.sensitivity(k, i) = 1.0 / parameters[j].prior;
  }
  std::mt19937_64 random(13);
  std::normal_distribution<double> normal;
  for (double& x : result.null.reshaped()) x = normal(random);
  return result;
}

Appraisal::Appraisal(Experiment& experiment, const std::vector<char>& held_out,
                     const std::vector<std::string>& leave_out)
    : experiment_(experiment), frames_(static_cast<int>(held_out.size())) {
  std::vector<char> fitted;
  for (char held : held_out) fitted.push_back(held == 0 ? 1 : 0);
  rows_ = rows_of_frames(experiment.data(), fitted);
  held_rows_ = rows_of_frames(experiment.data(), held_out);
  for (const Datum& d : experiment.data()) rigs_ = std::max(rigs_, d.channel + 1);
  const auto& all = experiment_.candidates();
  left_out_.assign(all.size(), 0);
  std::vector<std::string> names;
  for (const auto& one : all) names.push_back(one.name);
  std::vector<Mistake> mistakes;
  for (const auto& name : leave_out) {
    const auto found = std::find_if(names.begin(), names.end(),
                                    [&](const std::string& other) { return key_of(other) == key_of(name); });
    if (found == names.end())
      mistakes.push_back({"loop.leave_out", name, fmt::format("any of {}", fmt::join(names, ", "))});
    else
      left_out_[static_cast<std::size_t>(found - names.begin())] = 1;
  }
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
}

/// What a residual of the fitted rows and of what is known beforehand moves the free parameters by [free x rows].
Eigen::MatrixXd Appraisal::pull_of(const Model& model, const Known& prior) const {
  return pseudo_inverse(stacked(model.fit.sensitivity(rows_, Eigen::all), prior.sensitivity));
}

/// What the free parameters, fitted to draws of the null, leave of these.
Eigen::MatrixXd Appraisal::left_by_fit(const Eigen::MatrixXd& draws, const Model& model, const Eigen::MatrixXd& pull,
                                       const Known& prior) const {
  return draws - model.fit.sensitivity * (pull * stacked(draws(rows_, Eigen::all), prior.null.leftCols(draws.cols())));
}

void Appraisal::judge(Model& model) const {
  const Known prior = known_of(experiment_, model);
  const Eigen::MatrixXd& null = model.ground->null;
  const Eigen::MatrixXd pull = pull_of(model, prior);
  // of the parameters by the noise
  const Eigen::MatrixXd moved = pull * stacked(null(rows_, Eigen::all), prior.null);
  model.covariance = moved * moved.transpose() / static_cast<double>(moved.cols());
  constexpr double by_differences = 1e-8;  // derivatives are found to 1e-4 where they take simulations
  const Eigen::MatrixXd J = stacked(model.fit.sensitivity(rows_, Eigen::all), prior.sensitivity);
  model.undetermined.clear();
  for (const Eigen::Index i : inverse_of_seen(J.transpose() * J, by_differences).undetermined)
    if (const int j = model.fit.free[static_cast<std::size_t>(i)];
        std::count(model.fit.unseen.begin(), model.fit.unseen.end(), j) == 0 &&
        std::count(model.fit.held.begin(), model.fit.held.end(), j) == 0)
      model.undetermined.push_back(j);
  const Eigen::MatrixXd left = left_by_fit(model.ground->squares, model, pull, prior);
  const auto chi = [](const auto& r) {
    return std::sqrt(r.squaredNorm() / static_cast<double>(std::max<Eigen::Index>(1, r.size())));
  };
  const auto null_of = [&](const std::vector<Eigen::Index>& rows) {
    Eigen::VectorXd all(left.cols());
    for (Eigen::Index b = 0; b < left.cols(); ++b) all[b] = chi(Eigen::VectorXd(left.col(b)(rows)));
    return quantile(all, 0.95);
  };
  Misfit& misfit = model.misfit;
  misfit.fitted = chi(Eigen::VectorXd(model.fit.residual(rows_)));
  misfit.held_out = chi(Eigen::VectorXd(model.fit.residual(held_rows_)));
  misfit.null_fitted = null_of(rows_), misfit.null_held_out = null_of(held_rows_);
  std::vector<Eigen::Index> images, force;
  for (Eigen::Index i : rows_)
    (experiment_.data()[static_cast<std::size_t>(i)].channel == force_channel ? force : images).push_back(i);
  misfit.images = chi(Eigen::VectorXd(model.fit.residual(images))),
  misfit.force = chi(Eigen::VectorXd(model.fit.residual(force)));
  misfit.null_images = null_of(images), misfit.null_force = null_of(force);
  cross_validate(model, prior);
  misfit.frames.resize(frames_), misfit.null_frames.resize(frames_);
  for (int t = 0; t < frames_; ++t) {
    std::vector<char> one(static_cast<std::size_t>(frames_), 0);
    one[static_cast<std::size_t>(t)] = 1;
    const auto rows = rows_of_frames(experiment_.data(), one);
    misfit.frames[t] = chi(Eigen::VectorXd(model.fit.residual(rows)));
    misfit.null_frames[t] = null_of(rows);
  }
  model.scores = score(problem_of(model, prior));
  if (model.added.empty() || !omnibus_significant(model)) trace(model);
}

Eigen::MatrixXd Appraisal::left_of_null(const Model& model) const {
  const Known prior = known_of(experiment_, model);
  return left_by_fit(model.ground->null, model, pull_of(model, prior), prior);
}

Eigen::VectorXd residual_in_weights_of(const Model& from, const Model& to) {
  return from.ground->weight(to.ground->weight.undone(to.fit.residual));
}

double Appraisal::drop(const Model& from, const Model& to) const {
  const Eigen::VectorXd now = residual_in_weights_of(from, to);
  return from.fit.residual(rows_).squaredNorm() - now(rows_).squaredNorm();
}

/// chi of the chosen rows of the residual r under the parameters of the others, and its 95 % quantile under the null; 0
/// where nothing is chosen.
std::pair<double, double> Appraisal::left_out(const Eigen::MatrixXd& r, const Eigen::MatrixXd& J,
                                              const Eigen::MatrixXd& null, const Known& prior,
                                              const std::function<bool(const Datum&)>& chosen) const {
  std::vector<Eigen::Index> others, those;
  for (Eigen::Index i : rows_) (chosen(experiment_.data()[static_cast<std::size_t>(i)]) ? those : others).push_back(i);
  if (those.empty()) return {0.0, 0.0};
  const Eigen::MatrixXd pull = pseudo_inverse(stacked(J(others, Eigen::all), prior.sensitivity));
  const auto left = [&](const Eigen::MatrixXd& rows, const Eigen::MatrixXd& of_prior) {
    return Eigen::MatrixXd(rows(those, Eigen::all) -
                           J(those, Eigen::all) * (pull * stacked(rows(others, Eigen::all), of_prior)));
  };
  const auto scale = 1.0 / std::sqrt(static_cast<double>(those.size()));
  return {scale * left(r, prior.residual).norm(),
          quantile(scale * left(null, prior.null).colwise().norm().transpose(), 0.95)};
}

/// The white squares under the parameters of the black ones, and each rig under those of the others.
void Appraisal::cross_validate(Model& model, const Known& prior) const {
  Misfit& misfit = model.misfit;
  const Ground& ground = *model.ground;
  std::tie(misfit.checkerboard, misfit.null_checkerboard) = left_out(
      model.fit.residual, model.fit.sensitivity, ground.null, prior, [](const Datum& d) { return d.side == 1; });
  if (rigs_ < 2) return;
  const auto apart = [&](const Eigen::MatrixXd& rows) { return ground.apart(ground.weight.undone(rows)); };
  const Eigen::MatrixXd r = apart(model.fit.residual), J = apart(model.fit.sensitivity), null = apart(ground.null);
  for (int k = 0; k < rigs_; ++k) {
    const auto [chi, limit] = left_out(r, J, null, prior, [k](const Datum& d) { return d.channel == k; });
    misfit.cameras.push_back({k, chi, limit});
  }
}

/// What is scored, without any candidate.
ScoreProblem Appraisal::problem_of(const Model& model, const Known& prior) const {
  ScoreProblem problem;
  problem.residual = stacked(model.fit.residual(rows_), prior.residual);
  problem.sensitivity = stacked(model.fit.sensitivity(rows_, Eigen::all), prior.sensitivity);
  if (const Eigen::VectorXd freedom = experiment_.freedom(); freedom.size() > 0)
    problem.freedom = stacked(
        freedom(rows_), Eigen::VectorXd::Constant(prior.residual.size(), std::numeric_limits<double>::infinity()));
  problem.null = stacked(model.ground->null(rows_, Eigen::all), prior.null);
  problem.squares =
      stacked(model.ground->squares(rows_, Eigen::all), prior.null.leftCols(model.ground->squares.cols()));
  problem.known = prior.residual.size();
  if (!model.added.empty()) problem.level = level_after_addition;
  return problem;
}

void Appraisal::trace(Model& model) const {
  const Known prior = known_of(experiment_, model);
  model.traced = true;
  for (int k = 0; k < static_cast<int>(experiment_.candidates().size()); ++k) {
    if (is_in(k, model)) continue;
    if (left_out_[static_cast<std::size_t>(k)] != 0)
      model.untested.push_back({k, "the case leaves it out"});
    else if (!has_its_turn(k, model))
      model.untested.push_back({k, fmt::format("without {} it would be that one itself", candidate(k).after)});
    else
      model.others.push_back(k);
  }
  const auto signatures = marks(experiment_, model.ground->weight, model.fit.values, model.others);
  ScoreProblem problem = problem_of(model, prior);
  problem.held_out.residual = model.fit.residual(held_rows_),
  problem.held_out.sensitivity = model.fit.sensitivity(held_rows_, Eigen::all);
  std::vector<int> kept;
  std::vector<Mark> marks_of_kept;
  for (std::size_t i = 0; i < signatures.size(); ++i) {
    const Eigen::MatrixXd signature = signatures[i].columns(rows_, Eigen::all);
    const auto& its = candidate(model.others[i]).parameters;
    double step = 0.0;
    for (int j : its) step = std::max(step, experiment_.parameters()[static_cast<std::size_t>(j)].step);
    if (signature.norm() * step < no_mark) {
      model.untested.push_back({model.others[i], why_without(signatures[i], step)});
      continue;
    }
    Eigen::MatrixXd of_prior = Eigen::MatrixXd::Zero(prior.residual.size(), signature.cols());
    for (std::size_t c = 0; c < its.size() && its.size() == static_cast<std::size_t>(signature.cols()); ++c)
      if (const auto read = std::find(prior.of.begin(), prior.of.end(), its[c]); read != prior.of.end())
        of_prior(read - prior.of.begin(), static_cast<Eigen::Index>(c)) =
            1.0 / experiment_.parameters()[static_cast<std::size_t>(its[c])].prior;
    const auto with_prior = [&](const Eigen::MatrixXd& columns) {
      return stacked(columns, Eigen::MatrixXd::Zero(prior.residual.size(), columns.cols()));
    };
    problem.signatures.push_back(stacked(signature, of_prior));
    const Eigen::MatrixXd none(signatures[i].columns.rows(), 0),
        &elsewhere = signatures[i].elsewhere.size() > 0 ? signatures[i].elsewhere : none;
    problem.elsewhere.push_back(with_prior(elsewhere(rows_, Eigen::all)));
    problem.held_out.elsewhere.emplace_back(elsewhere(held_rows_, Eigen::all));
    problem.sizes.push_back(static_cast<int>(std::count_if(its.begin(), its.end(), [&](int j) {
      return !experiment_.parameters()[static_cast<std::size_t>(j)].info.shape;
    })));
    kept.push_back(model.others[i]);
    marks_of_kept.push_back(signatures[i]);
  }
  model.scores = score(problem);
  const auto forget = [&](std::size_t i, const char* why) {
    model.untested.push_back({kept[i], why, model.scores.candidates[i]});
    const auto place = static_cast<std::ptrdiff_t>(i);
    kept.erase(kept.begin() + place), marks_of_kept.erase(marks_of_kept.begin() + place),
        problem.signatures.erase(problem.signatures.begin() + place),
        problem.sizes.erase(problem.sizes.begin() + place);
    problem.elsewhere.erase(problem.elsewhere.begin() + place),
        problem.held_out.elsewhere.erase(problem.held_out.elsewhere.begin() + place);
  };
  if (const auto noisy = made_of_noise(kept, problem, model); !noisy.empty()) {
    for (const auto& [i, c] : noisy) problem.signatures[i].col(c).setZero(), marks_of_kept[i].columns.col(c).setZero();
    for (std::size_t i = kept.size(); i-- > 0;)
      if (problem.signatures[i].isZero(0.0))
        forget(i, "what the free parameters leave of its mark is what the noise of the ends makes of it");
    model.scores = score(problem);
  }
  // A mark that stays below the noise at every size that the candidate may have consists of it (an undisturbed strip
  // has no mesh error: what a finer mesh changes is what the ends' noise makes of it), and would be found again in the
  // residual.
  for (std::size_t i = kept.size(); i-- > 0;) {
    if (within_reach(kept[i], model.scores.candidates[i], model)) continue;
    forget(i, "no size within its bounds would be found");
  }
  if (kept.size() < model.scores.candidates.size()) model.scores = score(problem);
  if (model.added.empty()) model.baselines = baselines(problem);
  model.others = kept;
  for (std::size_t i = 0; i < kept.size(); ++i) hold_within_bounds(model.scores.candidates[i], kept[i], model);
  for (std::size_t i = 0; i < kept.size(); ++i)
    if (Score& one = model.scores.candidates[i];
        one.z > model.scores.threshold && one.z < 2.0 * model.scores.threshold && !one.shown_by_prior)
      one.contradicted = contradicted(one, marks_of_kept[i], problem, model);
}

/// Columns of which the free parameters leave little else than what the noise of the ends makes of them: the residual
/// holds the model's answer to that noise, too, and they would be found in it. That is told by a pair of opposite
/// draws, of candidates about the limit and somewhat beyond it; [candidate, column] of each.
std::vector<std::pair<std::size_t, Eigen::Index>> Appraisal::made_of_noise(const std::vector<int>& kept,
                                                                           const ScoreProblem& problem,
                                                                           const Model& model) const {
  // of the limit: columns that are noise alone were found at 3.5 to 7 standard deviations
  constexpr double from = 0.8, to = 3.0;
  std::vector<std::size_t> suspects;
  std::vector<Eigen::MatrixXd> own;
  for (std::size_t i = 0; i < kept.size(); ++i) {
    const double z = model.scores.candidates[i].z, limit = model.scores.threshold;
    if (!candidate(kept[i]).elsewhere.empty() || z < from * limit || z > to * limit) continue;
    suspects.push_back(i), own.push_back(left(problem.sensitivity, problem.signatures[i]));
  }
  std::vector<std::pair<std::size_t, Eigen::Index>> found;
  if (suspects.empty()) return found;
  std::vector<int> asked;
  for (const auto i : suspects) asked.push_back(kept[i]);
  const auto disturbed = [&](double times) {
    return disturbed_marks(experiment_, model.ground->weight, model.fit.values, asked, model.fit.free, times);
  };
  const auto up = disturbed(1.0), down = disturbed(-1.0);
  if (!up || !down) return found;
  const auto fitted = [&](const Eigen::MatrixXd& all) -> Eigen::MatrixXd {
    return stacked(all(rows_, Eigen::all), Eigen::MatrixXd::Zero(problem.known, all.cols()));
  };
  const auto with_known = [&](const Eigen::MatrixXd& sensitivity) -> Eigen::MatrixXd {
    return stacked(sensitivity(rows_, Eigen::all), problem.sensitivity.bottomRows(problem.known));
  };
  const Eigen::MatrixXd S_up = with_known(up->sensitivity), S_down = with_known(down->sensitivity);
  for (std::size_t s = 0; s < suspects.size(); ++s) {
    const Eigen::MatrixXd left_up = left(S_up, fitted(up->columns[s])),
                          left_down = left(S_down, fitted(down->columns[s]));
    for (Eigen::Index c = 0; c < left_up.cols(); ++c)
      if (is_noise(own[s].col(c), left_up.col(c), left_down.col(c))) found.emplace_back(suspects[s], c);
  }
  return found;
}

/// Those of these free parameters of which the others leave little but what the noise of the ends makes of them.
std::vector<int> Appraisal::made_of_noise(const Model& model, const std::vector<int>& sizes) const {
  const auto& free = model.fit.free;
  const auto disturbed = [&](double times) {
    return disturbed_marks(experiment_, model.ground->weight, model.fit.values, {}, free, times);
  };
  const auto up = disturbed(1.0), down = disturbed(-1.0);
  if (!up || !down) return {};
  const Known prior = known_of(experiment_, model);
  const auto with_known = [&](const Eigen::MatrixXd& sensitivity) -> Eigen::MatrixXd {
    return stacked(sensitivity(rows_, Eigen::all), prior.sensitivity);
  };
  const Eigen::MatrixXd S = with_known(model.fit.sensitivity), S_up = with_known(up->sensitivity),
                        S_down = with_known(down->sensitivity);
  std::vector<int> noisy;
  for (int j : sizes) {
    const auto own = std::find(free.begin(), free.end(), j) - free.begin();
    std::vector<Eigen::Index> others;
    for (Eigen::Index i = 0; i < std::ssize(free); ++i)
      if (i != own) others.push_back(i);
    const auto left_of = [&](const Eigen::MatrixXd& all) -> Eigen::VectorXd {
      return left(all(Eigen::all, others), all.col(own));
    };
    if (is_noise(left_of(S), left_of(S_up), left_of(S_down))) noisy.push_back(j);
  }
  return noisy;
}

std::vector<int> Appraisal::untold(const Model& model, int added) const {
  const auto& parameters = experiment_.parameters();
  const auto [sizes, places, values] = sizes_of(experiment_, model.fit, added);
  if (sizes.empty() || !candidate(added).elsewhere.empty()) return {};
  const auto deviation = [&](Eigen::Index place) {
    return std::sqrt(std::max(model.covariance(place, place), 1e-300));
  };
  const auto says_nothing = [&](int j, Eigen::Index place) {
    const auto& info = parameters[static_cast<std::size_t>(j)].info;
    return deviation(place) > info.upper - info.lower;
  };
  std::map<int, double> told;  // in standard deviations
  std::vector<int> nothing;
  for (std::size_t k = 0; k < sizes.size(); ++k) {
    told[sizes[k]] = std::abs(values[static_cast<Eigen::Index>(k)]) / deviation(places[k]);
    if (says_nothing(sizes[k], places[k])) nothing.push_back(sizes[k]);
  }
  std::vector<int> untold;
  if (sizes.size() > 1) {
    std::copy_if(sizes.begin(), sizes.end(), std::back_inserter(untold), [&](int j) {
      return on_bound(parameters[static_cast<std::size_t>(j)], model.fit.values[static_cast<std::size_t>(j)]);
    });
    if (untold.empty()) untold = made_of_noise(model, sizes);
    if (untold.empty()) untold = nothing;
  }
  std::stable_sort(untold.begin(), untold.end(), [&](int a, int b) { return told[a] < told[b]; });
  if (!untold.empty()) return untold;
  const bool without_size = std::any_of(sizes.begin(), sizes.end(), [&](int j) {
    return told[j] < 2.0 ||
           on_bound(parameters[static_cast<std::size_t>(j)], model.fit.values[static_cast<std::size_t>(j)]);
  });
  const auto& its = candidate(added).parameters;
  for (std::size_t k = 0; k < model.fit.free.size(); ++k) {
    const int j = model.fit.free[k];
    if (parameters[static_cast<std::size_t>(j)].info.shape && std::count(its.begin(), its.end(), j) > 0 &&
        (without_size || says_nothing(j, static_cast<Eigen::Index>(k))))
      untold.push_back(j);
  }
  return untold;
}

/// Whether a candidate is in the model, or of a parameter that is free already.
bool Appraisal::is_in(int k, const Model& model) const {
  if (std::find(model.added.begin(), model.added.end(), k) != model.added.end()) return true;
  const auto& its = candidate(k).parameters;
  return std::any_of(its.begin(), its.end(), [&](int j) {
    return std::find(model.fit.free.begin(), model.fit.free.end(), j) != model.fit.free.end();
  });
}

/// Whether held-out frames speak against a score just beyond the limit; far beyond, the linear size may be off by more
/// than noise. L is twice the logarithm of how much likelier their residual r is with the candidate's size than without
/// it, (|r|^2 - |r - v|^2)/s^2: v is the change of the prediction there, the free parameters giving way, s^2 the
/// variance of noise along it. T = z^2 and L together are below the limit, or frames that would show the size at two
/// standard deviations are explained worse with it. Of one that acts somewhere: at the place that explains most of what
/// is fitted.
bool Appraisal::contradicted(const Score& one, const Mark& mark, const ScoreProblem& problem,
                             const Model& model) const {
  const Eigen::MatrixXd& J = problem.held_out.sensitivity;
  const Eigen::MatrixXd pull = pseudo_inverse(problem.sensitivity);
  Eigen::MatrixXd signature = mark.columns.leftCols(one.size.size());
  Eigen::VectorXd size = one.size;
  if (Eigen::Index best = 0; one.drop_there.size() > 0) {
    one.drop_there.maxCoeff(&best);
    signature = mark.elsewhere.middleCols(best * size.size(), size.size()), size = one.size_there.col(best);
  }
  const Eigen::MatrixXd bias =
      pull * stacked(signature(rows_, Eigen::all), Eigen::MatrixXd::Zero(problem.known, signature.cols()));
  const Eigen::VectorXd& r = problem.held_out.residual;
  const Eigen::VectorXd v = (signature(held_rows_, Eigen::all) - J * bias) * size;
  const Eigen::MatrixXd& null = model.ground->null;
  const Eigen::VectorXd n =
      null(held_rows_, Eigen::all).transpose() * v - (pull * problem.null).transpose() * (J.transpose() * v);
  const double variance = n.squaredNorm() / static_cast<double>(n.size()) / std::max(v.squaredNorm(), 1e-300);
  const double L = (2.0 * v.dot(r) - v.squaredNorm()) / std::max(variance, 1e-300),
               shown = v.squaredNorm() / std::max(variance, 1e-300);
  return one.z * one.z + L < model.scores.threshold * model.scores.threshold || (shown > 4.0 && L < 0.0);
}

/// Whether a size within its bounds would be found, with the usual shape or with another.
bool Appraisal::within_reach(int k, const Score& one, const Model& model) const {
  const auto& its = candidate(k).parameters;
  for (Eigen::Index c = 0; c < one.size.size(); ++c) {
    const auto j = static_cast<std::size_t>(its[static_cast<std::size_t>(c)]);
    const auto& info = experiment_.parameters()[j].info;
    if (std::max(info.upper - model.fit.values[j], model.fit.values[j] - info.lower) >=
        (one.size.size() == 1 ? one.detectable.minCoeff() : one.detectable[c]))
      return true;
  }
  return !one.visible();  // listed as such
}

/// A size beyond its bounds explains nothing: what counts is the drop T = (2 a a_b - a_b^2)/sd^2 of the size a_b on the
/// bound.
void Appraisal::hold_within_bounds(Score& one, int k, const Model& model) const {
  if (one.degrees != 1 || one.size.size() != 1 || !(one.deviation[0] > 0.0)) return;
  const auto j = static_cast<std::size_t>(candidate(k).parameters.front());
  const auto& info = experiment_.parameters()[j].info;
  const double allowed = std::clamp(one.size[0], info.lower - model.fit.values[j], info.upper - model.fit.values[j]);
  if (allowed == one.size[0]) return;
  one.z = std::min(one.z, std::sqrt(std::max(0.0, (2.0 * one.size[0] - allowed) * allowed)) / one.deviation[0]);
}

/// Whether the candidate without which it would be that one itself is in the model, or is none here.
bool Appraisal::has_its_turn(int k, const Model& model) const {
  const auto& all = experiment_.candidates();
  const auto other = std::find_if(all.begin(), all.end(), [&](const Candidate& c) {
    return !candidate(k).after.empty() && c.name == candidate(k).after;
  });
  return other == all.end() ||
         std::find(model.added.begin(), model.added.end(), static_cast<int>(other - all.begin())) != model.added.end();
}

bool beyond_limit(const Model& model, const Score& score) {
  return score.z > model.scores.threshold && !score.contradicted;
}

bool stands_out(const Model& model, const Score& score) { return beyond_limit(model, score) && score.visible(); }

int frames_beyond(const Model& model) {
  return static_cast<int>((model.misfit.frames.array() > model.misfit.null_frames.array()).count());
}

bool most_frames_beyond(const Model& model) {
  constexpr int few = 3;  // what they share may put them beyond together
  const int beyond = frames_beyond(model);
  return beyond > few && 2 * beyond > static_cast<int>(model.misfit.frames.size());
}

bool omnibus_significant(const Model& model) {
  return model.scores.omnibus > model.scores.omnibus_threshold || most_frames_beyond(model);
}

bool significant(const Model& model) {
  const auto& all = model.scores.candidates;
  return omnibus_significant(model) || std::any_of(all.begin(), all.end(), [&](const Score& one) {
           return stands_out(model, one) && matters(model, one);
         });
}

bool within_formula(const Model& model, const Score& score) {
  return score.statistic < 0.01 * model.of_law && score.z < 1.5 * model.scores.threshold;
}

bool formulas_alone(const Model& model) {
  const auto& all = model.scores.candidates;
  return !omnibus_significant(model) && std::all_of(all.begin(), all.end(), [&](const Score& one) {
    return !stands_out(model, one) || !matters(model, one) || within_formula(model, one);
  });
}

Sizes sizes_of(const Experiment& experiment, const Fit& fit, int candidate) {
  Sizes its;
  std::vector<double> values;
  for (int j : experiment.candidates()[static_cast<std::size_t>(candidate)].parameters) {
    const auto& info = experiment.parameters()[static_cast<std::size_t>(j)].info;
    const auto place = std::find(fit.free.begin(), fit.free.end(), j) - fit.free.begin();
    if (info.shape || place == std::ssize(fit.free)) continue;
    its.parameters.push_back(j), its.places.push_back(place),
        values.push_back(fit.values[static_cast<std::size_t>(j)] - info.null_value.value_or(0.0));
  }
  its.values = Eigen::Map<const Eigen::VectorXd>(values.data(), std::ssize(values));
  return its;
}

bool has_size(const Experiment& experiment, const Model& model, int candidate) {
  const auto function = [&](int k) { return experiment.candidates()[static_cast<std::size_t>(k)].formula_for; };
  Sizes its = sizes_of(experiment, model.fit, candidate);
  for (int other : model.added) {
    if (other == candidate || function(candidate).empty() || function(other) != function(candidate)) continue;
    const Sizes more = sizes_of(experiment, model.fit, other);
    its.places.insert(its.places.end(), more.places.begin(), more.places.end());
    its.values.conservativeResize(its.values.size() + more.values.size());
    its.values.tail(more.values.size()) = more.values;
  }
  return its.places.empty() || told_from_zero(its.values, model.covariance(its.places, its.places));
}

std::optional<int> without_size(const Experiment& experiment, const Model& model) {
  if (model.added.size() < 2) return std::nullopt;
  const auto found =
      std::find_if(model.added.begin(), model.added.end(), [&](int k) { return !has_size(experiment, model, k); });
  return found == model.added.end() ? std::nullopt : std::optional(*found);
}

}  // namespace imic3d::loop
