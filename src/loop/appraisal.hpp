#pragma once
// A fitted model, judged by what it leaves: its parameters' covariance, its misfit on fitted and on held-out data, the
// scores of all candidates that it lacks.

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// What is known of the free parameters beforehand, and what was read of any beside the data, is data beside the
/// others.
struct Known {
  std::vector<int> of;          ///< which parameter [priors]
  Eigen::VectorXd residual;     ///< [priors]
  Eigen::MatrixXd sensitivity;  ///< [priors x free]
  Eigen::MatrixXd null;         ///< [priors x draws]
};
[[nodiscard]] Known known_of(const Experiment& experiment, const Model& model);

/// The residual of the model `to`, whitened as that of `from` is [N].
[[nodiscard]] Eigen::VectorXd residual_in_weights_of(const Model& from, const Model& to);

class Appraisal {
 public:
  /// `held_out`: per frame, whether it is never fitted. `leave_out`: names of candidates that are not considered;
  /// throws InputError for what is none.
  Appraisal(Experiment& experiment, const std::vector<char>& held_out, const std::vector<std::string>& leave_out);

  /// Of all data, those that are fitted, and the others.
  [[nodiscard]] const std::vector<Eigen::Index>& fitted_rows() const { return rows_; }
  [[nodiscard]] const std::vector<Eigen::Index>& held_out_rows() const { return held_rows_; }

  /// Covariance, misfit, energy of a model whose fit and ground are there; the scores of all other candidates, whose
  /// marks take most of the time, where the energy does not say already that something is left. Collective.
  void judge(Model& model) const;
  /// The scores of all other candidates. Collective.
  void trace(Model& model) const;
  /// Draws of the null less what the free parameters, fitted to them, explain [N x draws].
  [[nodiscard]] Eigen::MatrixXd left_of_null(const Model& model) const;
  /// Parameters of the effect `added` that the data do not tell beside its others: sizes that have run to a bound, else
  /// those of which the other free parameters leave little but what the noise of the ends makes of them, else those
  /// that the test says nothing of (bars pulled along two directions tell R_22, not R_33): their standard deviation is
  /// more than they may range over; those nearest to their null values first, in standard deviations. Then shapes of
  /// which it says nothing, or which leave a size untold (two rates tell C_rate for a rate_0, not both). None of an
  /// effect that acts somewhere. Collective.
  [[nodiscard]] std::vector<int> untold(const Model& model, int added) const;
  /// What chi^2 of the fitted frames drops by from one model to another, both in the weights of the first.
  [[nodiscard]] double drop(const Model& from, const Model& to) const;

 private:
  [[nodiscard]] const Candidate& candidate(int k) const {
    return experiment_.candidates()[static_cast<std::size_t>(k)];
  }
  [[nodiscard]] Eigen::MatrixXd pull_of(const Model& model, const Known& prior) const;
  [[nodiscard]] Eigen::MatrixXd left_by_fit(const Eigen::MatrixXd& draws, const Model& model,
                                            const Eigen::MatrixXd& pull, const Known& prior) const;
  [[nodiscard]] std::pair<double, double> left_out(const Eigen::MatrixXd& r, const Eigen::MatrixXd& J,
                                                   const Eigen::MatrixXd& null, const Known& prior,
                                                   const std::function<bool(const Datum&)>& chosen) const;
  void cross_validate(Model& model, const Known& prior) const;
  [[nodiscard]] ScoreProblem problem_of(const Model& model, const Known& prior) const;
  [[nodiscard]] bool is_in(int k, const Model& model) const;
  [[nodiscard]] std::vector<int> made_of_noise(const Model& model, const std::vector<int>& sizes) const;
  [[nodiscard]] std::vector<std::pair<std::size_t, Eigen::Index>> made_of_noise(const std::vector<int>& kept,
                                                                                const ScoreProblem& problem,
                                                                                const Model& model) const;
  [[nodiscard]] bool contradicted(const Score& one, const Mark& mark, const ScoreProblem& problem,
                                  const Model& model) const;
  [[nodiscard]] bool within_reach(int k, const Score& one, const Model& model) const;
  void hold_within_bounds(Score& one, int k, const Model& model) const;
  [[nodiscard]] bool has_its_turn(int k, const Model& model) const;

  Experiment& experiment_;
  int frames_, rigs_ = 0;
  std::vector<char> left_out_;
  std::vector<Eigen::Index> rows_, held_rows_;
};

/// Whether a candidate's score is beyond the limit, as one that the held-out frames do not contradict.
[[nodiscard]] bool beyond_limit(const Model& model, const Score& score);
/// Beyond the limit, and visible: what the free parameters leave of an invisible mark says nothing of its effect.
[[nodiscard]] bool stands_out(const Model& model, const Score& score);
/// Frames that have more left than noise leaves of each in 95 tests of 100.
[[nodiscard]] int frames_beyond(const Model& model);
/// Whether most frames have: where the null of one is large (a specimen that necks in it) the energy is that frame's,
/// and says nothing of the others.
[[nodiscard]] bool most_frames_beyond(const Model& model);
/// Whether the energy is beyond its limit, or most frames are.
[[nodiscard]] bool omnibus_significant(const Model& model);
/// Whether the model leaves anything: energy, or a candidate that stands out and matters.
[[nodiscard]] bool significant(const Model& model);
/// Whether a score just beyond the limit is less than what the formulas of the effects in the law may err by: a tenth
/// of their marks, a hundredth of what they took off chi^2.
[[nodiscard]] bool within_formula(const Model& model, const Score& score);
/// Whether what the model leaves, if anything, is no more than that, and no energy.
[[nodiscard]] bool formulas_alone(const Model& model);
/// Of an effect's parameters those that are free and no shape.
struct Sizes {
  std::vector<int> parameters;
  std::vector<Eigen::Index> places;  ///< among the free parameters
  Eigen::VectorXd values;            ///< beyond their null values
};
[[nodiscard]] Sizes sizes_of(const Experiment& experiment, const Fit& fit, int candidate);
/// Whether the size of an effect, or of one of the formulas for the same function beside it, is told from its null
/// value (95 %).
[[nodiscard]] bool has_size(const Experiment& experiment, const Model& model, int candidate);
/// Of several effects together, one whose size is not told from its null value (95 %): whatever bends freely beside
/// others leaves little of anything, and names nothing. Formulas for one function are told together. None, if all are
/// told.
[[nodiscard]] std::optional<int> without_size(const Experiment& experiment, const Model& model);

}  // namespace imic3d::loop
