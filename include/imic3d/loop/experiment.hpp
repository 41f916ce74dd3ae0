#pragma once
// What the loop needs of measured data, whatever they are: images with a force record, displacement fields, curves.

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "imic3d/core/parameter.hpp"

namespace imic3d::loop {

/// Where in the chain of a test an effect acts. In this order candidates are preferred where the data cannot tell.
enum class Link { numerics, record, camera, light, geometry, initial, loading, material };
[[nodiscard]] std::string_view name(Link link);

/// A number that the prediction depends on: a parameter of the law or of an effect.
struct Parameter {
  ParameterInfo info;  ///< null_value: where the effect is absent
  double value = 0.0;  ///< declared; the null value for an effect that is not declared
  double step = 1e-3;  ///< of a finite difference, in its unit
  double prior = 0.0;  ///< standard deviation of the declared value as it is known beforehand; 0: not known
  bool free = false;   ///< declared as unknown
  /// what was read of it beside the data, with the deviation `prior`: one more number, whether it is free or not
  std::optional<double> reading = {};
  [[nodiscard]] double expected() const { return reading.value_or(value); }
};

/// An effect that the declared model may lack.
struct Candidate {
  std::string name;
  Link link = Link::material;
  std::vector<int> parameters;  ///< that it would set free
  std::string sentence;         ///< what it says of the test, to be read after "it is: "
  std::string confused_with;
  std::string separated_by;  ///< the measurement that would tell it from these
  std::string after;         ///< a candidate without which it would be that one itself; empty: none
  /// the function of the model that it is one formula for, of which a test shows the course alone; empty: it is a thing
  /// of its own
  std::string formula_for{};
  /// Values of all its shapes that are as likely [any][shapes]: places or moments, of an effect that acts somewhere or
  /// from some time on. It is looked for at all of them, and identified from the best. Empty: a part and a multiple of
  /// each shape.
  std::vector<std::vector<double>> elsewhere{};
  /// on which the law yields, as the law's own effects do: what is missing bends the parameters, and its mark there
  /// says little
  bool changes_path = false;
};

constexpr int force_channel = -1;

/// What one number of the residual belongs to.
struct Datum {
  int frame = 0;                ///< place in the record
  int channel = force_channel;  ///< rig of cameras from 0, or the force
  int side = -1;                ///< of the checkerboard on the surface that it belongs to: 0, 1; -1: to none
};

/// Measured data and the model of how they come about. Every residual is measured - predicted in units of the measured
/// noise: where the model is complete its covariance is the identity, but for what the noise of the model's inputs
/// adds.
class Experiment {
 public:
  virtual ~Experiment() = default;
  [[nodiscard]] virtual const std::vector<Parameter>& parameters() const = 0;
  [[nodiscard]] virtual const std::vector<Candidate>& candidates() const = 0;
  [[nodiscard]] virtual const std::vector<Datum>& data() const = 0;  ///< [N]
  [[nodiscard]] virtual std::vector<int> frame_numbers() const = 0;  ///< of the record, as the user knows them
  /// First and last frame of the test that a frame is of.
  [[nodiscard]] virtual std::pair<int, int> test_of(int /*frame*/) const {
    return {0, static_cast<int>(frame_numbers().size()) - 1};
  }
  [[nodiscard]] virtual std::string frame_name(int frame) const {
    return "frame " + std::to_string(frame_numbers()[static_cast<std::size_t>(frame)]);
  }
  /// One residual [N] for each set of parameter values; the sets as concurrent groups of ranks. Collective. Empty where
  /// the model could not follow (a set out of reach of the solver).
  [[nodiscard]] virtual std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) = 0;
  /// The residual at `values`, then those of `sets`, each no farther from it than the step of a finite difference, so
  /// that the derivatives of the model may serve. Collective. The first is empty where the model could not follow.
  [[nodiscard]] virtual std::vector<Eigen::VectorXd> residuals_near(const std::vector<double>& values,
                                                                    std::vector<std::vector<double>> sets) {
    sets.insert(sets.begin(), values);
    return residuals(sets);
  }
  /// The same where what drives the model has one more draw of its noise, taken `times` times; empty where that noise
  /// is not known.
  [[nodiscard]] virtual std::vector<Eigen::VectorXd> residuals_disturbed(const std::vector<double>& /*values*/,
                                                                         std::vector<std::vector<double>> /*sets*/,
                                                                         double /*times*/) {
    return {};
  }
  /// What the model cannot follow with these values, where that can be said.
  [[nodiscard]] virtual std::string obstacle(const std::vector<double>& /*values*/) const { return {}; }
  /// What of the record that takes no part in the fit speaks against a candidate of this size; empty: nothing.
  [[nodiscard]] virtual std::string contradiction(int /*candidate*/, const std::vector<double>& /*values*/) const {
    return {};
  }
  /// Whether the derivative by a parameter takes simulations of its own.
  [[nodiscard]] virtual bool takes_simulations(int /*parameter*/) const { return false; }
  /// Of a fit, which may creep along a curved valley: as many as what a simulation takes lets be.
  [[nodiscard]] virtual int most_iterations() const { return 30; }
  /// Norm of a difference of two residuals that is round-off.
  [[nodiscard]] virtual double round_off() const { return 0.0; }
  /// Degrees of freedom that the noise of each number was estimated from, in the same data [N]; empty, or infinite,
  /// where it is known otherwise.
  [[nodiscard]] virtual Eigen::VectorXd freedom() const { return {}; }
  /// Learns what the procedure itself errs by with these values: a synthetic test without noise is made of the model on
  /// a finer mesh and taken through the measurement; what is left of it is taken off every residual from then on.
  /// Collective.
  virtual void learn_bias(const std::vector<double>& /*values*/) {}
  /// Standard deviations of what is not known of that, in units of the noise: of each number by itself [N], and of all
  /// together [N x what is unknown]; empty if nothing was learned.
  struct Doubt {
    Eigen::VectorXd each;
    Eigen::MatrixXd whole;
  };
  [[nodiscard]] virtual Doubt doubt() const { return {}; }
  /// The same to be kept, and put back: another model errs otherwise. Null where what is learned is a matter of the
  /// data alone.
  struct Learned {
    std::vector<double> at;  ///< the values of the parameters that it was learned with; empty: nothing was
    virtual ~Learned() = default;
  };
  [[nodiscard]] virtual std::shared_ptr<const Learned> learned() const { return nullptr; }
  virtual void put_back(const std::shared_ptr<const Learned>& /*learned*/) {}
  /// What `learn_bias` left, as numbers that `learn_again` takes up where it was called with the same values; empty
  /// where that takes no simulation.
  [[nodiscard]] virtual std::vector<Eigen::MatrixXd> learned_numbers() const { return {}; }
  virtual void learn_again(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& /*numbers*/) {
    learn_bias(values);
  }
  /// The numbers of one frame, in units of the noise, as the displacement of the surface's nodes that has them
  /// [unknowns, length]; empty where there is no surface.
  [[nodiscard]] virtual Eigen::VectorXd displacement_of(const Eigen::VectorXd& /*frame*/) const { return {}; }
  /// The length of each node's displacement [nodes, length] of such a one.
  [[nodiscard]] virtual Eigen::VectorXd lengths_of(const Eigen::VectorXd& displacement) const {
    return Eigen::Map<const Eigen::Matrix2Xd>(displacement.data(), 2, displacement.size() / 2)
        .colwise()
        .norm()
        .transpose();
  }
  [[nodiscard]] virtual std::string channel_name(int channel) const { return "camera " + std::to_string(channel); }
  /// Draws of the null that are made where `asked` are asked for: more where they cost next to nothing.
  [[nodiscard]] virtual int draws(int asked) const { return asked; }
  /// Residuals of a complete model with these values: random draws of all noise, that of the inputs propagated through
  /// the model [N x draws]. The same on every rank. Collective.
  [[nodiscard]] virtual Eigen::MatrixXd noise(const std::vector<double>& values, int draws) = 0;
  /// The same for sums of squares, where the noise was estimated from the data: every draw in units of its own
  /// estimate; not more than those of `noise`. Collective.
  [[nodiscard]] virtual Eigen::MatrixXd noise_of_squares(const std::vector<double>& /*values*/,
                                                         const Eigen::MatrixXd& noise) {
    return noise;
  }
};

}  // namespace imic3d::loop
