#include "imic3d/loop/recorded.hpp"

#include "imic3d/core/error.hpp"

namespace imic3d::loop {

namespace {

enum class Kind { residuals = 1, near, learned, noise, disturbed };

Eigen::MatrixXd question_of(Kind kind, int draws, const std::vector<std::vector<double>>& sets) {
  const auto parameters = static_cast<Eigen::Index>(sets.empty() ? 0 : sets.front().size());
  Eigen::MatrixXd question(2 + parameters, static_cast<Eigen::Index>(sets.size()));
  for (Eigen::Index s = 0; s < question.cols(); ++s)
    question.col(s) << static_cast<double>(kind), draws,
        Eigen::Map<const Eigen::VectorXd>(sets[static_cast<std::size_t>(s)].data(), parameters);
  return question;
}

/// But for round-off, in which steps that follow from the measured data may differ on other ranks; steps themselves are
/// larger by far.
bool same(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return a.rows() == b.rows() && a.cols() == b.cols() &&
         ((a - b).cwiseAbs().array() <= 1e-9 * a.cwiseAbs().array()).all();
}

// Residuals, of which some may be empty: which ones are not, and these.
std::vector<Eigen::MatrixXd> packed(const std::vector<Eigen::VectorXd>& residuals) {
  Eigen::RowVectorXd there(static_cast<Eigen::Index>(residuals.size()));
  Eigen::MatrixXd all;
  for (std::size_t s = 0; s < residuals.size(); ++s) {
    const Eigen::VectorXd& one = residuals[s];
    there[static_cast<Eigen::Index>(s)] = one.size() > 0 ? 1.0 : 0.0;
    if (one.size() == 0) continue;
    all.conservativeResize(one.size(), all.cols() + 1);
    all.rightCols(1) = one;
  }
  return {there, all};
}
std::vector<Eigen::VectorXd> unpacked(const std::vector<Eigen::MatrixXd>& numbers) {
  std::vector<Eigen::VectorXd> residuals;
  Eigen::Index next = 0;
  for (const double there : numbers.at(0).reshaped())
    residuals.emplace_back(there > 0.5 ? Eigen::VectorXd(numbers.at(1).col(next++)) : Eigen::VectorXd());
  return residuals;
}

}  // namespace

RecordedExperiment::RecordedExperiment(Experiment& experiment, std::deque<Answer> known,
                                       std::function<void(const Answer&)> keep)
    : experiment_(experiment), known_(std::move(known)), keep_(std::move(keep)) {}

std::optional<Answer> RecordedExperiment::known_answer(const Eigen::MatrixXd& question) {
  if (known_.empty()) return std::nullopt;
  if (!same(known_.front().question, question)) {
    known_.clear();
    return std::nullopt;
  }
  Answer answer = std::move(known_.front());
  known_.pop_front();
  if (!answer.failure.empty()) throw ConvergenceError(answer.failure);
  return answer;
}

std::vector<Eigen::MatrixXd> RecordedExperiment::kept(const Eigen::MatrixXd& question,
                                                      const std::function<std::vector<Eigen::MatrixXd>()>& answer) {
  try {
    auto numbers = answer();
    keep_({question, numbers, {}});
    return numbers;
  } catch (const ConvergenceError& error) {
    keep_({question, {}, error.what()});
    throw;
  }
}

std::vector<Eigen::VectorXd> RecordedExperiment::residuals(const Eigen::MatrixXd& question,
                                                           const std::function<std::vector<Eigen::VectorXd>()>& ask) {
  if (const auto known = known_answer(question)) return unpacked(known->numbers);
  std::vector<Eigen::VectorXd> found;
  static_cast<void>(kept(question, [&] { return packed(found = ask()); }));
  return found;
}

std::vector<Eigen::VectorXd> RecordedExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  return residuals(question_of(Kind::residuals, 0, sets), [&] { return experiment_.residuals(sets); });
}

std::vector<Eigen::VectorXd> RecordedExperiment::residuals_near(const std::vector<double>& values,
                                                                std::vector<std::vector<double>> sets) {
  auto all = sets;
  all.insert(all.begin(), values);
  return residuals(question_of(Kind::near, 0, all),
                   [&] { return experiment_.residuals_near(values, std::move(sets)); });
}

std::vector<Eigen::VectorXd> RecordedExperiment::residuals_disturbed(const std::vector<double>& values,
                                                                     std::vector<std::vector<double>> sets,
                                                                     double times) {
  auto all = sets;
  all.insert(all.begin(), values);
  return residuals(question_of(Kind::disturbed, static_cast<int>(times), all), [&] {
    auto found = experiment_.residuals_disturbed(values, std::move(sets), times);
    if (found.empty()) found.emplace_back();  // an answer has a number
    return found;
  });
}

void RecordedExperiment::learn_bias(const std::vector<double>& values) {
  const auto question = question_of(Kind::learned, 0, {values});
  if (const auto known = known_answer(question)) {
    experiment_.learn_again(values, known->numbers);
    return;
  }
  static_cast<void>(kept(question, [&] {
    experiment_.learn_bias(values);
    return experiment_.learned_numbers();
  }));
}

Eigen::MatrixXd RecordedExperiment::noise(const std::vector<double>& values, int draws) {
  const auto question = question_of(Kind::noise, draws, {values});
  if (const auto known = known_answer(question)) return known->numbers.at(0);
  return kept(question, [&] { return std::vector<Eigen::MatrixXd>{experiment_.noise(values, draws)}; }).front();
}

}  // namespace imic3d::loop
