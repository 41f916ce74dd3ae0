#include "imic3d/loop/joint_experiment.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "appraisal.hpp"
#include "imic3d/core/error.hpp"
#include "remainder.hpp"

namespace imic3d::loop {

namespace {

/// A number of the law, which all tests of a material share: of the declared one, or of an effect of it.
bool of_the_law(const Parameter& p) { return !p.info.null_value || !p.info.effect.empty(); }

std::string with_test(const std::string& name, const std::string& test) { return name + " (" + test + ")"; }

/// What every test has learned.
struct LearnedByTests final : Experiment::Learned {
  std::vector<std::shared_ptr<const Learned>> of;
};

}  // namespace

JointExperiment::JointExperiment(std::vector<Test> tests) : tests_(std::move(tests)), first_row_{0} {
  int frame = 0;
  for (std::size_t k = 0; k < tests_.size(); ++k) {
    const Experiment& one = *tests_[k].experiment;
    take_parameters(k);
    take_candidates(k);
    first_frame_.push_back(frame);
    for (Datum datum : one.data()) datum.frame += frame, data_.push_back(datum);
    frame += static_cast<int>(one.frame_numbers().size());
    first_row_.push_back(static_cast<Eigen::Index>(data_.size()));
  }
  first_frame_.push_back(frame);
  std::stable_sort(candidates_.begin(), candidates_.end(),
                   [](const auto& a, const auto& b) { return a.link < b.link; });
}

void JointExperiment::take_parameters(std::size_t test) {
  auto& places = place_.emplace_back();
  for (Parameter p : tests_[test].experiment->parameters()) {
    if (!of_the_law(p)) p.info.name = with_test(p.info.name, tests_[test].name);
    const auto same = std::find_if(parameters_.begin(), parameters_.end(),
                                   [&](const Parameter& other) { return other.info.name == p.info.name; });
    places.push_back(static_cast<int>(same - parameters_.begin()));
    const auto usual = [](const Parameter& q) { return q.info.shape && !q.free && q.value == q.info.null_value; };
    if (same == parameters_.end())
      parameters_.push_back(std::move(p));
    else if (usual(*same) && usual(p)) {
      if (p.value < same->value) *same = std::move(p);  // a reference rate is that of the slowest test
    } else if (same->value != p.value || same->prior != p.prior || same->free != p.free)
      throw InputError("material.parameters." + p.info.name,
                       fmt::format("{}, {}free, in {}", p.value, p.free ? "" : "not ", tests_[test].name),
                       fmt::format("{}, {}free, as in {}", same->value, same->free ? "" : "not ", tests_.front().name));
  }
}

void JointExperiment::take_candidates(std::size_t test) {
  auto& names = names_.emplace_back();
  for (Candidate candidate : tests_[test].experiment->candidates()) {
    const bool shared = std::all_of(candidate.parameters.begin(), candidate.parameters.end(), [&](int j) {
      return of_the_law(tests_[test].experiment->parameters()[static_cast<std::size_t>(j)]);
    });
    for (int& j : candidate.parameters) j = place_[test][static_cast<std::size_t>(j)];
    if (!shared) {
      candidate.name = with_test(candidate.name, tests_[test].name),
      candidate.sentence = tests_[test].name + ": " + candidate.sentence;
      if (!candidate.after.empty()) candidate.after = with_test(candidate.after, tests_[test].name);
    }
    names.push_back(candidate.name);
    if (std::none_of(candidates_.begin(), candidates_.end(),
                     [&](const Candidate& other) { return other.name == candidate.name; }))
      candidates_.push_back(std::move(candidate));
  }
}

std::vector<int> JointExperiment::frame_numbers() const {
  std::vector<int> all;
  for (int t = 0; t < first_frame_.back(); ++t) all.push_back(t);
  return all;
}

std::size_t JointExperiment::test_with(int frame) const {
  return static_cast<std::size_t>(std::upper_bound(first_frame_.begin(), first_frame_.end(), frame) -
                                  first_frame_.begin()) -
         1;
}

std::pair<int, int> JointExperiment::test_of(int frame) const {
  const auto test = test_with(frame);
  return {first_frame_[test], first_frame_[test + 1] - 1};
}

std::string JointExperiment::frame_name(int frame) const {
  const auto test = test_with(frame);
  return tests_[test].name + ", " + tests_[test].experiment->frame_name(frame - first_frame_[test]);
}

std::string JointExperiment::channel_name(int channel) const {
  for (const Test& test : tests_)
    if (const auto& data = test.experiment->data();
        std::any_of(data.begin(), data.end(), [channel](const Datum& d) { return d.channel == channel; }))
      return test.experiment->channel_name(channel);
  return Experiment::channel_name(channel);
}

std::vector<double> JointExperiment::values_of(std::size_t test, const std::vector<double>& values) const {
  std::vector<double> own;
  for (int j : place_[test]) own.push_back(values[static_cast<std::size_t>(j)]);
  return own;
}

/// Each test is asked once for each set of its own values.
std::vector<Eigen::VectorXd> JointExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  if (sets.empty()) return {};
  return asked(sets.front(), {sets.begin() + 1, sets.end()},
               [](Experiment& test, const std::vector<std::vector<double>>& own) { return test.residuals(own); });
}

std::vector<Eigen::VectorXd> JointExperiment::residuals_near(const std::vector<double>& values,
                                                             std::vector<std::vector<double>> sets) {
  return asked(values, sets, [](Experiment& test, const std::vector<std::vector<double>>& own) {
    return test.residuals_near(own.front(), {own.begin() + 1, own.end()});
  });
}

std::vector<Eigen::VectorXd> JointExperiment::residuals_disturbed(const std::vector<double>& values,
                                                                  std::vector<std::vector<double>> sets, double times) {
  return asked(values, sets, [times](Experiment& test, const std::vector<std::vector<double>>& own) {
    auto found = test.residuals_disturbed(own.front(), {own.begin() + 1, own.end()}, times);
    return found.size() != own.size() ? test.residuals_near(own.front(), {own.begin() + 1, own.end()}) : found;
  });
}

std::vector<Eigen::VectorXd> JointExperiment::asked(const std::vector<double>& values,
                                                    const std::vector<std::vector<double>>& sets,
                                                    const Question& question) {
  const Eigen::Index rows = first_row_.back();
  std::vector<Eigen::VectorXd> all(1 + sets.size(), Eigen::VectorXd(rows));
  for (std::size_t k = 0; k < tests_.size(); ++k) {
    std::vector<std::vector<double>> own = {values_of(k, values)};
    std::vector<std::size_t> use = {0};  // of each set, among the test's own
    for (const auto& set : sets) {
      auto wanted = values_of(k, set);
      const auto found = std::find(own.begin(), own.end(), wanted);
      use.push_back(static_cast<std::size_t>(found - own.begin()));
      if (found == own.end()) own.push_back(std::move(wanted));
    }
    const auto found = question(*tests_[k].experiment, own);
    for (std::size_t s = 0; s < all.size(); ++s) {
      if (all[s].size() == 0) continue;
      if (found[use[s]].size() == 0)
        all[s].resize(0);
      else
        all[s].segment(first_row_[k], first_row_[k + 1] - first_row_[k]) = found[use[s]];
    }
  }
  return all;
}

std::string JointExperiment::obstacle(const std::vector<double>& values) const {
  for (std::size_t k = 0; k < tests_.size(); ++k)
    if (const auto its = tests_[k].experiment->obstacle(values_of(k, values)); !its.empty())
      return tests_[k].name + ": " + its;
  return {};
}

std::string JointExperiment::contradiction(int candidate, const std::vector<double>& values) const {
  for (std::size_t k = 0; k < tests_.size(); ++k)
    for (int own : candidates_of(k, {candidate}))
      if (const auto its = tests_[k].experiment->contradiction(own, values_of(k, values)); !its.empty()) return its;
  return {};
}

bool JointExperiment::takes_simulations(int parameter) const {
  for (std::size_t k = 0; k < tests_.size(); ++k)
    if (const auto own = std::find(place_[k].begin(), place_[k].end(), parameter);
        own != place_[k].end() && tests_[k].experiment->takes_simulations(static_cast<int>(own - place_[k].begin())))
      return true;
  return false;
}

int JointExperiment::most_iterations() const {
  int least = tests_.front().experiment->most_iterations();
  for (const Test& test : tests_) least = std::min(least, test.experiment->most_iterations());
  return least;
}

double JointExperiment::round_off() const {
  double squares = 0.0;
  for (const Test& test : tests_) squares += std::pow(test.experiment->round_off(), 2);
  return std::sqrt(squares);
}

Eigen::VectorXd JointExperiment::freedom() const {
  Eigen::VectorXd all = Eigen::VectorXd::Constant(first_row_.back(), std::numeric_limits<double>::infinity());
  for (std::size_t k = 0; k < tests_.size(); ++k)
    if (const Eigen::VectorXd own = tests_[k].experiment->freedom(); own.size() > 0)
      all.segment(first_row_[k], own.size()) = own;
  return all;
}

void JointExperiment::learn_bias(const std::vector<double>& values) {
  learned_at_ = values;
  for (std::size_t k = 0; k < tests_.size(); ++k) tests_[k].experiment->learn_bias(values_of(k, values));
}

Experiment::Doubt JointExperiment::doubt() const {
  Doubt all{Eigen::VectorXd::Zero(first_row_.back()), Eigen::MatrixXd::Zero(first_row_.back(), 0)};
  for (std::size_t k = 0; k < tests_.size(); ++k) {
    const auto own = tests_[k].experiment->doubt();
    if (own.each.size() == 0) continue;
    const auto column = all.whole.cols();
    all.each.segment(first_row_[k], own.each.size()) = own.each;
    all.whole.conservativeResize(Eigen::NoChange, column + own.whole.cols());
    all.whole.rightCols(own.whole.cols()).setZero();
    all.whole.block(first_row_[k], column, own.whole.rows(), own.whole.cols()) = own.whole;
  }
  return all;
}

std::shared_ptr<const Experiment::Learned> JointExperiment::learned() const {
  auto all = std::make_shared<LearnedByTests>();
  all->at = learned_at_;
  for (const Test& test : tests_) all->of.push_back(test.experiment->learned());
  const bool any = std::any_of(all->of.begin(), all->of.end(), [](const auto& one) { return one != nullptr; });
  return any ? all : nullptr;
}

void JointExperiment::put_back(const std::shared_ptr<const Learned>& learned) {
  const auto all = std::dynamic_pointer_cast<const LearnedByTests>(learned);
  if (!all) return;
  learned_at_ = all->at;
  for (std::size_t k = 0; k < tests_.size(); ++k) tests_[k].experiment->put_back(all->of[k]);
}

/// How many numbers each test has, then these.
std::vector<Eigen::MatrixXd> JointExperiment::learned_numbers() const {
  Eigen::RowVectorXd counts(static_cast<Eigen::Index>(tests_.size()));
  std::vector<Eigen::MatrixXd> all(1);
  for (std::size_t k = 0; k < tests_.size(); ++k) {
    const auto own = tests_[k].experiment->learned_numbers();
    counts[static_cast<Eigen::Index>(k)] = static_cast<double>(own.size());
    all.insert(all.end(), own.begin(), own.end());
  }
  all.front() = counts;
  return all;
}

void JointExperiment::learn_again(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& numbers) {
  learned_at_ = values;
  auto next = numbers.begin() + 1;
  for (std::size_t k = 0; k < tests_.size(); ++k) {
    const auto count = static_cast<std::ptrdiff_t>(numbers.front()(0, static_cast<Eigen::Index>(k)));
    tests_[k].experiment->learn_again(values_of(k, values), {next, next + count});
    next += count;
  }
}

Eigen::MatrixXd JointExperiment::noise(const std::vector<double>& values, int draws) {
  Eigen::MatrixXd all(first_row_.back(), draws);
  for (std::size_t k = 0; k < tests_.size(); ++k)
    all.middleRows(first_row_[k], first_row_[k + 1] - first_row_[k]) =
        tests_[k].experiment->noise(values_of(k, values), draws);
  return all;
}

Eigen::MatrixXd JointExperiment::noise_of_squares(const std::vector<double>& values, const Eigen::MatrixXd& noise) {
  Eigen::MatrixXd all(noise.rows(), noise.cols());
  for (std::size_t k = 0; k < tests_.size(); ++k) {
    const auto first = first_row_[k], count = first_row_[k + 1] - first;
    all.middleRows(first, count) =
        tests_[k].experiment->noise_of_squares(values_of(k, values), noise.middleRows(first, count));
  }
  return all;
}

std::vector<int> JointExperiment::held_out() const {
  std::vector<int> all;
  for (std::size_t k = 0; k < tests_.size(); ++k)
    for (int frame : tests_[k].held_out) all.push_back(first_frame_[k] + frame);
  return all;
}

std::vector<int> JointExperiment::candidates_of(std::size_t test, const std::vector<int>& all) const {
  std::vector<int> own;
  for (int k : all)
    if (const auto found =
            std::find(names_[test].begin(), names_[test].end(), candidates_[static_cast<std::size_t>(k)].name);
        found != names_[test].end())
      own.push_back(static_cast<int>(found - names_[test].begin()));
  return own;
}

Model JointExperiment::model_of(std::size_t test, const Model& all) const {
  Model model = all;
  const auto own_place = [&](int parameter) {
    return static_cast<int>(std::find(place_[test].begin(), place_[test].end(), parameter) - place_[test].begin());
  };
  std::vector<Eigen::Index> kept;  // free parameters that the test has
  model.fit.free.clear(), model.fit.held.clear(), model.fit.unseen.clear(), model.undetermined.clear();
  for (std::size_t i = 0; i < all.fit.free.size(); ++i)
    if (const int own = own_place(all.fit.free[i]); own < static_cast<int>(place_[test].size()))
      kept.push_back(static_cast<Eigen::Index>(i)), model.fit.free.push_back(own);
  for (auto [from, to] : {std::pair(&all.fit.held, &model.fit.held), std::pair(&all.fit.unseen, &model.fit.unseen),
                          std::pair(&all.undetermined, &model.undetermined)})
    for (int parameter : *from)
      if (const int own = own_place(parameter); own < static_cast<int>(place_[test].size())) to->push_back(own);
  if (!all.fit.values.empty()) model.fit.values = values_of(test, all.fit.values);
  if (all.covariance.size() > 0) model.covariance = all.covariance(kept, kept).eval();
  model.added = candidates_of(test, all.added);
  model.untested.clear();
  for (Untested one : all.untested)
    if (const auto own = candidates_of(test, {one.candidate}); !own.empty()) {
      one.candidate = own.front();
      if (one.score) one.score->bias = one.score->bias(kept, Eigen::all).eval();
      model.untested.push_back(std::move(one));
    }
  model.others.clear(), model.scores.candidates.clear(), model.baselines.cosine.clear(), model.baselines.bic.clear();
  for (std::size_t i = 0; i < all.others.size(); ++i)
    if (const auto own = candidates_of(test, {all.others[i]}); !own.empty()) {
      model.others.push_back(own.front());
      if (!all.baselines.cosine.empty()) model.baselines.cosine.push_back(all.baselines.cosine[i]);
      Score score = all.scores.candidates[i];
      score.bias = score.bias(kept, Eigen::all).eval();
      model.scores.candidates.push_back(std::move(score));
    }
  for (int i : all.baselines.bic)
    if (const auto own = candidates_of(test, {all.others[static_cast<std::size_t>(i)]}); !own.empty())
      model.baselines.bic.push_back(
          static_cast<int>(std::find(model.others.begin(), model.others.end(), own.front()) - model.others.begin()));
  model.misfit.cameras.clear();  // counted over all tests
  const int first = first_frame_[test], frames = first_frame_[test + 1] - first;
  if (all.misfit.frames.size() > 0)
    model.misfit.frames = all.misfit.frames.segment(first, frames).eval(),
    model.misfit.null_frames = all.misfit.null_frames.segment(first, frames).eval();
  if (all.ground)
    if (const auto learned = std::dynamic_pointer_cast<const LearnedByTests>(all.ground->learned)) {
      auto ground = std::make_shared<Ground>();
      ground->learned = learned->of[test];
      model.ground = std::move(ground);
    }
  return model;
}

Report JointExperiment::report_of(std::size_t test, const Report& all) {
  Report report;
  report.part = true;
  report.held_out.assign(all.held_out.begin() + first_frame_[test], all.held_out.begin() + first_frame_[test + 1]);
  report.declared = model_of(test, all.declared), report.final = model_of(test, all.final);
  report.verdict = all.verdict, report.sentence = all.sentence;
  report.set = candidates_of(test, all.set), report.named = candidates_of(test, all.named),
  report.invisible = candidates_of(test, all.invisible);
  for (const Round& round : all.rounds) {
    Round& own = report.rounds.emplace_back();
    own.set = candidates_of(test, round.set), own.kept = round.kept;
    for (const Trial& trial : round.trials)
      if (const auto candidate = candidates_of(test, {trial.candidate}); !candidate.empty())
        own.trials.push_back({candidate.front(), model_of(test, trial.model), trial.visible, trial.sufficient,
                              trial.plausible, trial.disagrees, trial.objection, trial.drop});
  }
  const Appraisal appraisal(*this, all.held_out, {});
  const auto left = [&](const Model& model) {
    return leftover_of(model, appraisal.left_of_null(model))
        .of(first_row_[test], first_row_[test + 1] - first_row_[test]);
  };
  report.remainder = remainder_of(*tests_[test].experiment, left(all.declared), left(all.final));
  return report;
}

}  // namespace imic3d::loop
