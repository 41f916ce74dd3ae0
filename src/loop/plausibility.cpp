#include "plausibility.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace {

using Objection = std::optional<std::string>;

double square(double x) { return x * x; }

/// A trial's model, the one that its effect was added to, and the frames that both are fitted on.
struct Comparison {
  const Experiment& experiment;
  const Appraisal& appraisal;
  const Candidate& effect;
  const Model &model, &before;
  const std::vector<Eigen::Index>& rows;

  const Parameter& parameter(int j) const { return experiment.parameters()[static_cast<std::size_t>(j)]; }
  double value(int j) const { return model.fit.values[static_cast<std::size_t>(j)]; }
};

/// What takes away no more than chance does has let another one fall below its limit, which is a little higher after an
/// addition.
Objection explains_no_more_than_chance(const Comparison& c) {
  // Both by what is in doubt of the model before: one that doubts itself leaves little in its own units.
  const double of_residual = c.appraisal.drop(c.before, c.model);
  const auto of_known = [&](const Fit& fit) { return fit.cost - Eigen::VectorXd(fit.residual(c.rows)).squaredNorm(); };
  const double drop = std::max({0.0, of_residual, of_residual + of_known(c.before.fit) - of_known(c.model.fit)});
  if (chi_squared_tail(drop, static_cast<int>(c.effect.parameters.size())) <= level_after_addition) return {};
  const Misfit &now = c.model.misfit, &was = c.before.misfit;
  return fmt::format("it explains no more than chance does: chi^2 falls by {:.2g}{}", drop,
                     now.fitted < was.fitted && now.null_fitted > was.null_fitted
                         ? fmt::format(" in units of what the model before is in doubt by; chi is less only in its own "
                                       "units (null {:.3f} after {:.3f})",
                                       now.null_fitted, was.null_fitted)
                         : "");
}

Objection at_a_bound(const Comparison& c) {
  for (int k : c.model.added)
    for (int j : c.experiment.candidates()[static_cast<std::size_t>(k)].parameters)
      if (on_bound(c.parameter(j), c.value(j)))
        return fmt::format("{} = {:.4g} is at its bound", c.parameter(j).info.name, c.value(j));
  return {};
}

/// Behaviour that no material has: what takes that much of it stands for something else.
Objection is_many_times_the_usual_size(const Comparison& c) {
  constexpr double many = 20.0;
  if (c.effect.link != Link::material) return {};
  for (int j : c.effect.parameters) {
    const auto& info = c.parameter(j).info;
    const double times = std::abs(c.value(j) - info.null_value.value_or(0.0)) / info.scale;
    if (!info.shape && info.scale > 0.0 && times > many)
      return fmt::format("{} = {:.4g} is {:.0f} times what is usual of it ({:.2g})", info.name, c.value(j), times,
                         info.scale);
  }
  return {};
}

Objection contradicted_by_the_record(const Comparison& c, int candidate) {
  const std::string reason = c.experiment.contradiction(candidate, c.model.fit.values);
  return reason.empty() ? Objection() : reason;
}

Objection explains_half_of_the_surface_worse(const Comparison& c) {
  const Misfit &now = c.model.misfit, &was = c.before.misfit;
  if (now.checkerboard <= was.checkerboard * 1.02 || was.checkerboard <= was.null_checkerboard) return {};
  return fmt::format("half of the surface is explained worse by the other half: chi {:.3f} after {:.3f}",
                     now.checkerboard, was.checkerboard);
}

/// A model whose own error of mesh and correlation is in doubt by more than it explains would explain anything. Both
/// before any weighing, in units of the noise.
Objection doubts_more_than_it_explains(const Comparison& c) {
  const Ground &ground = *c.model.ground, &before = *c.before.ground;
  if (&ground == &before) return {};
  const auto mean_square = [&](const Ground& of, const Eigen::MatrixXd& weighed) {
    return Eigen::MatrixXd(of.weight.undone(weighed)(c.rows, Eigen::all)).squaredNorm() /
           static_cast<double>(weighed.cols()) / static_cast<double>(c.rows.size());
  };
  const double grown = mean_square(ground, ground.null) - mean_square(before, before.null);
  const double explained =
      std::max(0.0, mean_square(before, c.before.fit.residual) - mean_square(ground, c.model.fit.residual));
  if (grown <= explained) return {};
  const bool of_record = c.effect.link == Link::record;  // which the simulation gives at the frames alone
  return fmt::format(
      "what {} in this model is in doubt by more ({:.2f} of the noise) than it explains ({:.2f}); {} would tell",
      of_record ? "is recorded between the frames" : "the mesh and the correlation err by", std::sqrt(grown),
      std::sqrt(explained), of_record ? "frames that are closer in time" : "a finer mesh");
}

Objection explains_a_rig_worse(const Comparison& c) {
  for (std::size_t k = 0; k < c.model.misfit.cameras.size(); ++k) {
    const auto &now = c.model.misfit.cameras[k], &was = c.before.misfit.cameras[k];
    if (now.chi > was.chi * 1.02 && was.chi > was.null &&
        now.chi > now.null)  // within its null a rig speaks against nothing
      return fmt::format("the others explain the {} cameras worse: chi {:.3f} after {:.3f}",
                         c.experiment.channel_name(now.channel), now.chi, was.chi);
  }
  return {};
}

/// Sizes that the fitted frames do not tell leave any residual of the held-out ones within the null: nothing checks
/// such an effect.
Objection is_checked_by_no_frame(const Comparison& c) {
  const Misfit &now = c.model.misfit, &was = c.before.misfit;
  const double doubt = square(now.null_held_out) - square(was.null_held_out);
  if (doubt <= std::max(3.0 * square(was.null_held_out), square(was.held_out) - square(now.held_out))) return {};
  return fmt::format(
      "no held-out frame checks it: what it would be there is in doubt by more (null {:.3f} after {:.3f}) than it "
      "explains",
      now.null_held_out, was.null_held_out);
}

/// Whether the held-out frames' chi^2 grows from one model to the other by no more than chance lets it where the other
/// is right: they say what differs by d (in standard deviations, of all numbers together), then it is less by d^2 in
/// the mean, with a standard deviation of 2 d.
bool held_out_frames_cannot_tell(const Comparison& c) {
  const auto& held = c.appraisal.held_out_rows();
  const Eigen::VectorXd was = c.before.fit.residual(held), now = residual_in_weights_of(c.before, c.model)(held);
  const double d = (now - was).norm();
  return now.squaredNorm() - was.squaredNorm() < d * (4.0 - d);  // two of them
}

/// What leaves nothing of the fitted frames, but no less of held-out ones of which noise does not explain all, is not
/// what is missing, if they can tell; one that helps may leave a little more of these.
Objection explains_held_out_frames_worse(const Comparison& c, bool sufficient) {
  const Misfit &now = c.model.misfit, &was = c.before.misfit;
  const bool all_noise = now.held_out <= now.null_held_out && was.held_out <= was.null_held_out;
  if (all_noise || now.held_out <= (sufficient ? 1.0 : 1.02) * was.held_out || held_out_frames_cannot_tell(c))
    return {};
  return fmt::format("the held-out frames are explained worse: chi {:.3f} (null {:.3f}) after {:.3f}", now.held_out,
                     now.null_held_out, was.held_out);
}

/// One frame in which something else happened may ask for an effect that the others speak against (each of these in
/// doubt by a tenth of the size).
Objection asked_for_by_one_frame(const Comparison& c, int candidate) {
  const auto lone = told_by_one_frame(c.experiment, c.model, candidate, c.rows);
  if (!lone) return {};
  const auto& info = c.parameter(lone->parameter).info;
  const double size = c.value(lone->parameter) - info.null_value.value_or(0.0);
  if (std::abs(lone->size - size) < 3.5 * std::hypot(lone->deviation, 0.1 * size)) return {};
  return fmt::format("{} alone asks for it: of the others {} - {:.4g} is {:.2g} +- {:.2g}",
                     c.experiment.frame_name(lone->frame), info.name, info.null_value.value_or(0.0), lone->size,
                     lone->deviation);
}

/// Thirds of the frames must agree about the sizes: each third's own wish for another one, the other parameters held,
/// s^T r/s^T s, over its standard deviation (with a tenth of the size).
Objection thirds_disagree(const Comparison& c) {
  const Fit& fit = c.model.fit;
  const Eigen::MatrixXd J = fit.sensitivity(c.rows, Eigen::all), null = c.model.ground->null(c.rows, Eigen::all);
  const Eigen::VectorXd r = fit.residual(c.rows);
  const int frames = static_cast<int>(c.experiment.frame_numbers().size());
  double disagreement = 0.0;
  int compared = 0;
  for (int third = 0; third < 3; ++third) {
    std::vector<Eigen::Index> rows;
    for (std::size_t i = 0; i < c.rows.size(); ++i)
      if (3 * c.experiment.data()[static_cast<std::size_t>(c.rows[i])].frame / frames == third)
        rows.push_back(static_cast<Eigen::Index>(i));
    if (rows.size() < static_cast<std::size_t>(J.cols()) + 1) continue;
    for (int j : c.effect.parameters) {
      const auto column = std::find(fit.free.begin(), fit.free.end(), j) - fit.free.begin();
      if (column == J.cols()) continue;
      const Eigen::VectorXd s = J.col(column)(rows);
      const double s2 = s.squaredNorm();
      if (s2 < 0.02 * J.col(column).squaredNorm()) continue;
      const Eigen::VectorXd noise = null(rows, Eigen::all).transpose() * s / s2;
      const double size = c.value(j) - c.parameter(j).info.null_value.value_or(0.0);
      const double deviation = std::sqrt(noise.squaredNorm() / static_cast<double>(noise.size()) + square(0.1 * size));
      disagreement = std::max(disagreement, std::abs(s.dot(r(rows))) / s2 / std::max(1e-300, deviation));
      ++compared;
    }
  }
  if (compared < 2 || disagreement <= 4.5) return {};
  return fmt::format("parts of the test disagree about its size by {:.1f} standard deviations", disagreement);
}

}  // namespace

std::optional<LoneFrame> told_by_one_frame(const Experiment& experiment, const Model& model, int candidate,
                                           const std::vector<Eigen::Index>& rows) {
  const Fit& fit = model.fit;
  const Sizes its = sizes_of(experiment, fit, candidate);
  if (its.places.empty()) return std::nullopt;
  const auto& of_it = experiment.candidates()[static_cast<std::size_t>(candidate)].parameters;
  std::vector<Eigen::Index> columns, places;
  for (Eigen::Index k = 0; k < std::ssize(fit.free); ++k) {
    const int j = fit.free[static_cast<std::size_t>(k)];
    if (std::find(of_it.begin(), of_it.end(), j) == of_it.end() ||
        !experiment.parameters()[static_cast<std::size_t>(j)].info.shape)
      columns.push_back(k);
  }
  for (const auto place : its.places)
    places.push_back(std::lower_bound(columns.begin(), columns.end(), place) - columns.begin());
  const Known prior = known_of(experiment, model);
  const Eigen::MatrixXd J = stacked(fit.sensitivity(rows, columns), prior.sensitivity(Eigen::all, columns));
  const Eigen::VectorXd scale = J.colwise().norm().cwiseMax(1e-300).cwiseInverse();
  const Eigen::MatrixXd S = J * scale.asDiagonal();
  const Eigen::VectorXd r = stacked(fit.residual(rows), prior.residual);
  const Eigen::MatrixXd null = stacked(model.ground->null(rows, Eigen::all), prior.null);
  const Eigen::MatrixXd all = S.transpose() * S, of_null = S.transpose() * null;
  const Eigen::VectorXd gradient = S.transpose() * r;
  // A size that no frame is left to tell may be anything, a hundred thousand times as large.
  const Eigen::MatrixXd any = 1e-10 * Eigen::MatrixXd::Identity(all.rows(), all.cols());
  /// What the null makes of the sizes, by the frames of this information: what is in doubt goes on from frame to frame.
  const auto covariance_of = [&](const Eigen::MatrixXd& pull, const Eigen::MatrixXd& noise) {
    return Eigen::MatrixXd(scale.asDiagonal() * pull *
                           (noise * noise.transpose() / static_cast<double>(noise.cols()) + any) * pull *
                           scale.asDiagonal());
  };
  const auto pull_of = [&](const Eigen::MatrixXd& information) {
    return solve_symmetric(information + any, Eigen::MatrixXd::Identity(any.rows(), any.cols()));
  };
  if (!told_from_zero(its.values, covariance_of(pull_of(all), of_null)(places, places))) return std::nullopt;
  std::map<int, std::vector<Eigen::Index>> of_frame;
  for (std::size_t i = 0; i < rows.size(); ++i)
    of_frame[experiment.data()[static_cast<std::size_t>(rows[i])].frame].push_back(static_cast<Eigen::Index>(i));
  for (const auto& [frame, its_rows] : of_frame) {
    const Eigen::MatrixXd own = S(its_rows, Eigen::all);
    const Eigen::MatrixXd pull = pull_of(all - own.transpose() * own);
    const Eigen::MatrixXd covariance = covariance_of(pull, of_null - own.transpose() * null(its_rows, Eigen::all));
    const Eigen::VectorXd step = scale.asDiagonal() * (pull * (gradient - own.transpose() * r(its_rows)));
    const Eigen::VectorXd without = its.values + step(places);
    if (told_from_zero(without, covariance(places, places))) continue;
    LoneFrame lone{.frame = frame};
    double most = -1.0;
    for (std::size_t k = 0; k < places.size(); ++k) {
      const auto at = static_cast<Eigen::Index>(k);
      const double deviation = std::sqrt(covariance(places[k], places[k])),
                   moved = std::abs(step[places[k]]) / std::max(1e-300, deviation);
      if (moved > most)
        most = moved, lone.parameter = its.parameters[k], lone.size = without[at], lone.deviation = deviation;
    }
    return lone;
  }
  return std::nullopt;
}

void weigh(Trial& trial, const Model& at, const Experiment& experiment, const Appraisal& appraisal) {
  const Comparison c{experiment,  appraisal, experiment.candidates()[static_cast<std::size_t>(trial.candidate)],
                     trial.model, at,        appraisal.fitted_rows()};
  trial.sufficient = !significant(trial.model);
  if (most_frames_beyond(trial.model))
    trial.objection = fmt::format("{} of {} frames have more left than noise leaves", frames_beyond(trial.model),
                                  trial.model.misfit.frames.size());
  if (const auto untold = without_size(experiment, trial.model); untold && trial.sufficient) {
    trial.sufficient = false;
    trial.objection = fmt::format("nothing is left, but the size of {} is not told",
                                  experiment.candidates()[static_cast<std::size_t>(*untold)].name);
  }
  const auto object = [&](Objection reason) {  // the first one is said
    if (reason && std::exchange(trial.plausible, false)) trial.objection = *reason;
  };
  object(explains_no_more_than_chance(c));
  object(at_a_bound(c));
  object(is_many_times_the_usual_size(c));
  object(contradicted_by_the_record(c, trial.candidate));
  object(explains_half_of_the_surface_worse(c));
  object(doubts_more_than_it_explains(c));
  object(explains_a_rig_worse(c));
  object(is_checked_by_no_frame(c));
  object(explains_held_out_frames_worse(c, trial.sufficient));
  if (const Objection torn = trial.sufficient ? Objection() : thirds_disagree(c)) {
    trial.disagrees = trial.plausible;
    object(torn);
  }
  if (trial.plausible) object(asked_for_by_one_frame(c, trial.candidate));
}

}  // namespace imic3d::loop
