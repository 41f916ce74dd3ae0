#pragma once
// Several tests of one material, each of its own kind: images, displacement fields, curves.

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/experiment.hpp"

namespace imic3d::loop {

/// The residuals of several experiments one after another, each in units of its own noise. The numbers of the law, the
/// declared ones and those that it may lack, are one in all of them; what belongs to a test (its record, cameras,
/// specimen, numerics) is a candidate for each test that has it, named with the test's name. Their noise is
/// independent. Cameras of the same number are one channel: leaving out a whole test would ask of the others what only
/// it shows (its load cell's gain).
class JointExperiment final : public Experiment {
 public:
  struct Test {
    std::string name;
    Experiment* experiment;       ///< outlives this
    std::vector<int> held_out{};  ///< its frames (places in its record) that are never fitted
  };
  /// Throws InputError where the tests declare a number of the law differently (value, prior, whether it is free).
  explicit JointExperiment(std::vector<Test> tests);

  [[nodiscard]] const std::vector<Parameter>& parameters() const override { return parameters_; }
  [[nodiscard]] const std::vector<Candidate>& candidates() const override { return candidates_; }
  [[nodiscard]] const std::vector<Datum>& data() const override { return data_; }
  [[nodiscard]] std::vector<int> frame_numbers() const override;  ///< from 0, tests one after another
  [[nodiscard]] std::pair<int, int> test_of(int frame) const override;
  [[nodiscard]] std::string frame_name(int frame) const override;
  [[nodiscard]] std::string channel_name(int channel) const override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_near(const std::vector<double>& values,
                                                            std::vector<std::vector<double>> sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_disturbed(const std::vector<double>& values,
                                                                 std::vector<std::vector<double>> sets,
                                                                 double times) override;
  [[nodiscard]] std::string obstacle(const std::vector<double>& values) const override;
  [[nodiscard]] std::string contradiction(int candidate, const std::vector<double>& values) const override;
  [[nodiscard]] bool takes_simulations(int parameter) const override;
  [[nodiscard]] int most_iterations() const override;
  [[nodiscard]] double round_off() const override;
  [[nodiscard]] Eigen::VectorXd freedom() const override;
  void learn_bias(const std::vector<double>& values) override;
  [[nodiscard]] Doubt doubt() const override;
  [[nodiscard]] std::shared_ptr<const Learned> learned() const override;
  void put_back(const std::shared_ptr<const Learned>& learned) override;
  [[nodiscard]] std::vector<Eigen::MatrixXd> learned_numbers() const override;
  void learn_again(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& numbers) override;
  [[nodiscard]] Eigen::MatrixXd noise(const std::vector<double>& values, int draws) override;
  [[nodiscard]] Eigen::MatrixXd noise_of_squares(const std::vector<double>& values,
                                                 const Eigen::MatrixXd& noise) override;

  /// Frames of all tests that are never fitted.
  [[nodiscard]] std::vector<int> held_out() const;
  /// The first frame of each test.
  [[nodiscard]] std::vector<int> first_frames() const { return {first_frame_.begin(), first_frame_.end() - 1}; }
  /// The values of a test's own parameters.
  [[nodiscard]] std::vector<double> values_of(std::size_t test, const std::vector<double>& values) const;
  /// What the report says of a test, in the test's own candidates, parameters and frames; verdict, sentence and the
  /// misfits of all frames are those of all tests. The remainder is the test's own.
  [[nodiscard]] Report report_of(std::size_t test, const Report& all);
  [[nodiscard]] const std::vector<Test>& tests() const { return tests_; }

 private:
  /// What every test answers, put together: its own sets, each once, the first those of `values`.
  using Question =
      std::function<std::vector<Eigen::VectorXd>(Experiment& test, const std::vector<std::vector<double>>& own)>;
  [[nodiscard]] std::vector<Eigen::VectorXd> asked(const std::vector<double>& values,
                                                   const std::vector<std::vector<double>>& sets,
                                                   const Question& question);
  [[nodiscard]] Model model_of(std::size_t test, const Model& all) const;
  [[nodiscard]] std::vector<int> candidates_of(std::size_t test, const std::vector<int>& all) const;
  void take_parameters(std::size_t test);
  void take_candidates(std::size_t test);

  std::vector<Test> tests_;
  std::vector<Parameter> parameters_;
  std::vector<std::vector<int>> place_;  // of each test's parameters among all
  std::vector<Candidate> candidates_;
  std::vector<std::vector<std::string>> names_;  // of each test's candidates among all
  std::vector<Datum> data_;
  [[nodiscard]] std::size_t test_with(int frame) const;
  std::vector<int> first_frame_;
  std::vector<Eigen::Index> first_row_;  // and the number of rows
  std::vector<double> learned_at_;
};

}  // namespace imic3d::loop
