#pragma once
// Stress-strain curves of bars: what the loop needs of uniform tests.

#include <functional>
#include <map>
#include <memory>

#include "imic3d/core/parallel.hpp"
#include "imic3d/core/whitening.hpp"
#include "imic3d/identification/curves.hpp"
#include "imic3d/identification/gauge.hpp"
#include "imic3d/loop/effect.hpp"
#include "imic3d/loop/experiment.hpp"

namespace imic3d::loop {

/// The declared law, and the effects that it may lack.
struct CurveModel {
  /// The declared law with these effects beside its own; not one of plane stress.
  std::function<std::shared_ptr<const material::FiniteStrainLaw>(const std::vector<std::string>& effects)> extended;
  /// of the parameters of the law with all of them, in its order
  std::vector<ParameterInfo> information;
  /// null values of what is not declared; priors: 0 where nothing is known
  std::vector<double> values, priors;
  /// whether a parameter belongs to the declared law; whether it is unknown
  std::vector<char> declared, free;
  std::vector<DeclaredEffect> effects{};  ///< no candidates any more
  /// `stress`, `time` in the units of the test
  std::function<std::string(std::string)> unit = [](std::string word) { return word; };
};

struct CurveLoopOptions {
  int bins = 24;               ///< of the way that strain and stress go, of curves that are repeated
  int numbers_per_frame = 24;  ///< of a curve that is not
};

/// A frame is a bar, or a piece of a curve that has no repetition. Repeated bars are compared in bins: the mean of
/// measured - predicted in each. These have equal shares of the way that strain, over its whole way, and stress, over
/// its own, go along the longest bar of the group, so that what is steep has its share; each is an interval of the way
/// of the strain, the same for all bars. Bars of one material differ: each is off by a random cubic of that way, whose
/// covariance all groups of repetitions share, by what is left of it in each bin, both estimated from the bars'
/// deviations from the mean of their group (expectation-maximisation), and by the mean noise of the points in the bin.
/// Where the stress is small (a bar starts, a cycle passes zero) bars do not differ as they do elsewhere: bin by bin
/// they may be off by as much as their cubics are. The null are bars that differ so, one half of their covariance being
/// that of the deviations themselves, whatever their course, grown by what few bars tell of it; see `freedom`. A curve
/// without repetitions has the noise of its points: what is declared, or their scatter about the prediction from point
/// to point, which is an estimate, too; where it is steep more, if its points scatter more there (noise of the strain),
/// and a branch is off as a whole by what is not known of the turn that it began with. Whitened with that.
class CurveExperiment final : public Experiment {
 public:
  CurveExperiment(Communicator world, std::vector<identification::Curve> curves, CurveModel model,
                  const CurveLoopOptions& options = {});

  [[nodiscard]] const std::vector<Parameter>& parameters() const override { return parameters_; }
  [[nodiscard]] const std::vector<Candidate>& candidates() const override { return candidates_; }
  [[nodiscard]] const std::vector<Datum>& data() const override { return data_; }
  [[nodiscard]] std::vector<int> frame_numbers() const override;
  [[nodiscard]] std::string frame_name(int frame) const override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override;
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals_near(const std::vector<double>& values,
                                                            std::vector<std::vector<double>> sets) override;
  /// The first curve that the law cannot follow, and its row.
  [[nodiscard]] std::string obstacle(const std::vector<double>& values) const override;
  /// What a load cell reads where the record begins, unstrained, is what it reads without load.
  [[nodiscard]] std::string contradiction(int candidate, const std::vector<double>& values) const override;
  [[nodiscard]] int most_iterations() const override { return 200; }
  /// 1e-6 of the stress: a law with an effect at its null value solves other equations than one without it.
  [[nodiscard]] double round_off() const override;
  /// Bars beyond one of each group, less the coefficients that they differ in, plus one; where none is repeated those
  /// of the noise of the points.
  [[nodiscard]] Eigen::VectorXd freedom() const override;
  void learn_bias(const std::vector<double>& values) override;
  /// The covariance of forty scores takes far more draws than are worth their time where each is a simulation.
  [[nodiscard]] int draws(int asked) const override;
  [[nodiscard]] Eigen::MatrixXd noise(const std::vector<double>& values, int draws) override;
  [[nodiscard]] Eigen::MatrixXd noise_of_squares(const std::vector<double>& values,
                                                 const Eigen::MatrixXd& noise) override;

  /// Frames that are held out: those that the curves say; else every fourth of the bars of a group, none where there is
  /// no group.
  [[nodiscard]] std::vector<int> held_out() const;
  /// The former alone.
  [[nodiscard]] std::vector<int> declared_held_out() const;
  [[nodiscard]] const std::vector<identification::Curve>& curves() const { return curves_; }
  [[nodiscard]] int curve_of(int frame) const;
  /// Whether a curve is several frames.
  [[nodiscard]] bool cut_into_pieces(int curve) const;
  /// Stress at all rows of each curve; empty if the law cannot follow one of them.
  [[nodiscard]] std::vector<Eigen::VectorXd> predict(const std::vector<double>& values) const;
  /// Standard deviation of a number of a curve that is not explained by the bars' cubics, rms [stress].
  [[nodiscard]] double bin_noise(int curve) const;
  /// Predictions of the whole set made so far.
  [[nodiscard]] int simulations() const { return simulations_; }

 private:
  struct Bin {
    int curve = 0, number = 0;
    double x = 0.0;       // way of strain and stress, 1 at the end of the longest bar of the group
    double stress = 0.0;  // its size, of the largest of the group
    std::vector<Eigen::Index> rows;
    bool held_out = false;
  };
  static constexpr int degree = 3;  // of a bar's own polynomial

  /// The law with the effects that are there.
  struct Law {
    std::shared_ptr<const material::FiniteStrainLaw> law;
    std::vector<std::string> effects;
    std::vector<double> values;
    std::vector<std::size_t> places;  // of its parameters among all
  };
  [[nodiscard]] Law law_of(const std::vector<double>& values) const;
  /// The strain that the extensometer did not show [rows].
  [[nodiscard]] Eigen::VectorXd true_strain(std::size_t curve, const std::vector<double>& values) const;
  /// Of grips and load train [length^2/force].
  [[nodiscard]] double compliance(std::size_t curve, const std::vector<double>& values) const;
  /// What the gauge of a curve is taken for to have gone through.
  [[nodiscard]] material::BarHistory true_history(std::size_t curve, const std::vector<double>& values) const;
  /// Stress at the rows of a curve, and where it turned between them, before it is recorded, and its derivatives by
  /// `free` parameters of the law [rows and turns x 1 + free]; empty if the law cannot follow.
  [[nodiscard]] Eigen::MatrixXd follow(std::size_t curve, const Law& law, const material::BarHistory& history,
                                       std::span<const int> free = {}) const;
  /// What load cell and group make of it at the rows.
  [[nodiscard]] Eigen::VectorXd recorded(std::size_t curve, const std::vector<double>& values,
                                         Eigen::VectorXd stress) const;
  void pass_turns();
  void make_bins(const CurveLoopOptions& options);
  /// How bars of one material differ.
  struct Scatter {
    Eigen::MatrixXd covariance;  // of the bars' coefficients [degree + 1 square]; empty: none
    // how far the bar is elastic at each number: it differs by another cubic there, `share_of_elastic` times as much
    // [N]
    Eigen::VectorXd elastic;
    double share_of_elastic = 1.0;
    Eigen::VectorXd noise;    // of each number beyond them [N, stress]
    Eigen::VectorXd freedom;  // of the square of that where nothing is repeated [N]
    // what the numbers of each curve are off by where a turn that they remember was elsewhere [its numbers x turns,
    // stress]
    std::vector<Eigen::MatrixXd> turns;
    // of the repeated bars of each group, from its mean: in bins; of the cubics
    std::map<std::string, std::vector<Eigen::VectorXd>> deviations, coefficients;
  };
  struct Repeated;
  void find_repetitions();
  // freedom of the noise of the points before any is seen in the strain
  [[nodiscard]] Eigen::VectorXd known_noise() const;
  [[nodiscard]] double coefficients_that_differ() const;
  [[nodiscard]] double cubic(const Repeated& bar, Eigen::Index bin, const Eigen::VectorXd& coefficients) const;
  [[nodiscard]] double correlation_beyond_cubics(const std::string& group) const;
  /// Bars that differ as `scatter_` says, `grown` times as much [N x draws, stress].
  [[nodiscard]] Eigen::MatrixXd bars_like_these(int draws, double grown, unsigned seed) const;
  void learn_noise_of_bins(std::size_t curve, const Eigen::VectorXd& predicted, const Eigen::VectorXd& slope);
  [[nodiscard]] Scatter scatter_of(const Eigen::VectorXd& raw) const;
  // of one that has no repetition
  [[nodiscard]] identification::PointNoise points_of(std::size_t curve, const Eigen::VectorXd& raw) const;
  [[nodiscard]] bool noise_is_estimated(std::size_t curve) const;  // from the points of this curve
  [[nodiscard]] std::vector<Whitening> whitening_of(const Scatter& scatter) const;
  // measured - predicted [N, stress]
  [[nodiscard]] Eigen::VectorXd binned(const std::vector<Eigen::VectorXd>& predicted) const;
  [[nodiscard]] Eigen::VectorXd whitened(const Eigen::VectorXd& raw, const std::vector<Whitening>& whitening) const;
  [[nodiscard]] Eigen::VectorXd whitened(const Eigen::VectorXd& raw) const { return whitened(raw, whitening_); }
  [[nodiscard]] Eigen::MatrixXd basis(Eigen::Index first, Eigen::Index count) const;
  void make_candidates();
  /// Calls act(effect, its values) for the effects that act on a curve.
  template <typename Act>
  void for_effects(std::size_t curve, const std::vector<double>& values, const Act& act) const;

  Communicator world_;
  std::vector<identification::Curve> curves_;
  CurveModel model_;
  std::vector<Scene> scenes_;  // of each curve
  /// A force that rubs or lags does so at the turns, whether a row has them or not.
  struct Passed {
    Scene scene;                     // of rows, and turns between them
    std::vector<Eigen::Index> rows;  // among these
  };
  std::vector<Passed> passed_;  // of each curve
  struct Acting {
    std::shared_ptr<const Effect> effect;
    std::string group;                 // empty: on all curves
    std::size_t first = 0, count = 0;  // its parameters
    bool read_at_rest = false;         // a record that begins unstrained shows it there
  };
  std::vector<Acting> effects_;
  std::vector<Parameter> parameters_;
  std::vector<Candidate> candidates_;
  std::vector<Datum> data_;
  std::vector<Bin> bins_;
  std::vector<std::pair<Eigen::Index, Eigen::Index>> bars_;  // first bin, bins of each curve
  Eigen::VectorXd of_points_;                                // noise of the mean of a bin's points [N, stress]
  Eigen::VectorXd slope_;  // of the prediction where nothing is repeated, d(stress)/d(strain) [N, stress]
  std::vector<identification::TurnMemory> turns_;  // of each curve that has no repetition, at its numbers
  /// A bar that has repetitions: its bins that others of the group have too.
  struct Repeated {
    std::size_t curve = 0;
    std::vector<Eigen::Index> rows;
    std::vector<int> numbers;
    Eigen::MatrixXd B;
  };
  std::map<std::string, std::vector<Repeated>> repeated_;  // by group
  Scatter scatter_;
  double freedom_ = 0.0;              // bars beyond one of each group
  std::vector<Whitening> whitening_;  // of each bar
  mutable int simulations_ = 0;
};

}  // namespace imic3d::loop
