#pragma once
// What a loop has asked of an experiment and was answered, so that a run that ended too early is not lost.

#include <deque>
#include <functional>
#include <optional>
#include <string>

#include "imic3d/loop/experiment.hpp"

namespace imic3d::loop {

/// A question to an experiment that takes simulations, and what came of it.
struct Answer {
  /// kind and number of draws in the first two rows, the values of all parameters below them, one set a column
  Eigen::MatrixXd question;
  std::vector<Eigen::MatrixXd> numbers;
  std::string failure;  ///< why there are none: the message of a ConvergenceError
};

/// An experiment whose answers are kept. The loop asks the same questions in the same order as long as it is answered
/// alike: those that are known are answered from what was kept, the others by the experiment. What follows from data
/// and values without a simulation is not kept.
class RecordedExperiment final : public Experiment {
 public:
  /// `known`: the answers of an earlier run from its beginning, the same on every rank. `keep` gets every new one, on
  /// every rank. `experiment` outlives this.
  RecordedExperiment(Experiment& experiment, std::deque<Answer> known, std::function<void(const Answer&)> keep);

  [[nodiscard]] const std::vector<Parameter>& parameters() const override { return experiment_.parameters(); }
  [[nodiscard]] const std::vector<Candidate>& candidates() const override { return experiment_.candidates(); }
  [[nodiscard]] const std::vector<Datum>& data() const override { return experiment_.data(); }
  [[nodiscard]] std::vector<int> frame_numbers() const override { return experiment_.frame_numbers(); }
  [[nodiscard]] std::pair<int, int> test_of(int frame) const override { return experiment_.test_of(frame); }
  [[nodiscard]] std::string frame_name(int frame) const override { return experiment_.frame_name(frame); }
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_near(const std::vector<double>& values,
                                                            std::vector<std::vector<double>> sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_disturbed(const std::vector<double>& values,
                                                                 std::vector<std::vector<double>> sets,
                                                                 double times) override;
  [[nodiscard]] std::string obstacle(const std::vector<double>& values) const override {
    return experiment_.obstacle(values);
  }
  [[nodiscard]] bool takes_simulations(int parameter) const override {
    return experiment_.takes_simulations(parameter);
  }
  [[nodiscard]] int most_iterations() const override { return experiment_.most_iterations(); }
  [[nodiscard]] double round_off() const override { return experiment_.round_off(); }
  [[nodiscard]] Eigen::VectorXd freedom() const override { return experiment_.freedom(); }
  void learn_bias(const std::vector<double>& values) override;
  [[nodiscard]] Doubt doubt() const override { return experiment_.doubt(); }
  [[nodiscard]] std::shared_ptr<const Learned> learned() const override { return experiment_.learned(); }
  void put_back(const std::shared_ptr<const Learned>& learned) override { experiment_.put_back(learned); }
  [[nodiscard]] Eigen::VectorXd displacement_of(const Eigen::VectorXd& frame) const override {
    return experiment_.displacement_of(frame);
  }
  [[nodiscard]] Eigen::VectorXd lengths_of(const Eigen::VectorXd& displacement) const override {
    return experiment_.lengths_of(displacement);
  }
  [[nodiscard]] std::string channel_name(int channel) const override { return experiment_.channel_name(channel); }
  [[nodiscard]] int draws(int asked) const override { return experiment_.draws(asked); }
  [[nodiscard]] Eigen::MatrixXd noise(const std::vector<double>& values, int draws) override;
  [[nodiscard]] Eigen::MatrixXd noise_of_squares(const std::vector<double>& values,
                                                 const Eigen::MatrixXd& noise) override {
    return experiment_.noise_of_squares(values, noise);
  }

 private:
  /// The next answer that is known, if it is one to this question; else none is known any more. Throws ConvergenceError
  /// if that was the answer.
  [[nodiscard]] std::optional<Answer> known_answer(const Eigen::MatrixXd& question);
  /// `answer` of the experiment, kept.
  [[nodiscard]] std::vector<Eigen::MatrixXd> kept(const Eigen::MatrixXd& question,
                                                  const std::function<std::vector<Eigen::MatrixXd>()>& answer);
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals(const Eigen::MatrixXd& question,
                                                       const std::function<std::vector<Eigen::VectorXd>()>& ask);

  Experiment& experiment_;
  std::deque<Answer> known_;
  std::function<void(const Answer&)> keep_;
};

}  // namespace imic3d::loop
