#pragma once
// A small experiment whose truth is known: five numbers a frame and a force, two parameters, seven candidates.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// Curves with a kink: u_k(t) = p0 phi_k(t) + p1^2 psi_k(t), F(t) = 30 p0 tanh(4 t) + 20 p1 t. All noise is white, but
/// for what an input noise common to a frame adds to its numbers.
class Curves final : public Experiment {
 public:
  static constexpr int frames = 40, numbers = 5;
  enum Effect { drift, kink, twin, twin_again, gain, curved, offset };

  explicit Curves(unsigned seed, std::vector<std::pair<int, double>> truth = {}, double unknown = 0.0,
                  unsigned of_null = 5000U, double rest_of_gain = 0.0, double like_drift = 0.0)
      : of_null_(of_null), rest_of_gain_(rest_of_gain), like_drift_(like_drift) {
    const auto add = [&](const char* name, double value, double lower, double upper, std::optional<double> null) {
      parameters_.push_back(
          {.info = {.name = name, .unit = "-", .description = "", .lower = lower, .upper = upper, .null_value = null},
           .value = value,
           .step = 1e-4,
           .prior = 0.0,
           .free = !null});
    };
    add("p0", 10.0, 1e-3, 1e3, {});
    add("p1", 3.0, 1e-3, 1e3, {});
    const char* names[] = {"drift", "kink", "twin", "twin again", "gain", "curved", "offset"};
    const Link links[] = {Link::camera, Link::material, Link::geometry, Link::material,
                          Link::record, Link::camera,   Link::record};
    for (int k = 0; k < 7; ++k) {
      add(names[k], 0.0, -100.0, 100.0, 0.0);
      candidates_.push_back({.name = names[k],
                             .link = links[k],
                             .parameters = {2 + k},
                             .sentence = names[k],
                             .confused_with = "",
                             .separated_by = k == twin ? "a ruler; another test" : "another test",
                             .after = {}});
    }
    for (int t = 0; t < frames; ++t) {
      for (int k = 0; k < numbers; ++k) data_.push_back({t, 0});
      data_.push_back({t, force_channel});
    }
    std::vector<double> values;
    for (const auto& p : parameters_) values.push_back(p.value);
    values[0] = 10.6, values[1] = 2.9;
    for (const auto& [k, size] : truth) values[static_cast<std::size_t>(2 + k)] = size;
    size_of_drift_ = values[2 + drift];
    measured_ = predict(values) + draw(seed);
    for (int t = 0; t < frames; ++t) measured_[t * (numbers + 1) + t % numbers] += unknown * std::sin(0.7 * t);
  }

  Curves& bound(int effect, double largest) {
    auto& info = parameters_[static_cast<std::size_t>(2 + effect)].info;
    info.lower = -largest, info.upper = largest;
    return *this;
  }

  Curves& limit(std::size_t parameter, double lower, double upper) {
    parameters_[parameter].info.lower = lower, parameters_[parameter].info.upper = upper;
    return *this;
  }

  /// One more candidate, which acts about a moment that is unknown; it is there with this size at this moment.
  Curves& somewhere(double size, double moment, bool told_where = true) {
    const auto add = [&](const char* name, double value, double lower, double upper, double step, bool shape) {
      parameters_.push_back({.info = {.name = name,
                                      .unit = "-",
                                      .description = "",
                                      .lower = lower,
                                      .upper = upper,
                                      .null_value = value,
                                      .shape = shape,
                                      .scale = value},
                             .value = value,
                             .step = step,
                             .prior = 0.0,
                             .free = false});
    };
    add("pulse", 0.0, -100.0, 100.0, 1e-4, false), add("moment", 0.5, 0.0, 1.0, 1e-3, true);
    candidates_.push_back({.name = "pulse",
                           .link = Link::material,
                           .parameters = {9, 10},
                           .sentence = "pulse",
                           .confused_with = "",
                           .separated_by = "another test",
                           .after = {}});
    if (told_where) candidates_.back().elsewhere = {{0.05}, {0.2}, {0.35}, {0.65}, {0.8}, {0.95}};
    pulse_ = 9;
    std::vector<double> with, without;
    for (const auto& p : parameters_) without.push_back(p.value);
    with = without, with[9] = size, with[10] = moment;
    measured_ += predict(with) - predict(without);
    return *this;
  }

  /// That candidate is a step: the moment is any between two frames, and what else goes with it, weakly, is in frames
  /// that are fitted as if it were `misled`.
  Curves& step(double size, double moment, double misled) {
    step_ = true;
    somewhere(size, moment);
    auto& elsewhere = candidates_.back().elsewhere;
    elsewhere.clear();
    for (int t = 0; t + 1 < frames; ++t) elsewhere.push_back({(t + 1.5) / frames});
    for (int i = 0; i < measured_.size(); ++i) measured_[i] += size * goes_with_moment(i, misled - moment);
    return *this;
  }

  /// An effect is declared as one more unknown.
  Curves& with_free(int effect) {
    parameters_[static_cast<std::size_t>(2 + effect)].free = true;
    return *this;
  }

  /// An effect is one of the record.
  Curves& with_recorded(int effect) {
    candidates_[static_cast<std::size_t>(effect)].link = Link::record;
    return *this;
  }

  /// An effect has a second size, which frames that are fitted hardly show.
  Curves& with_untold(int effect) {
    candidates_[static_cast<std::size_t>(effect)].parameters.push_back(static_cast<int>(parameters_.size()));
    parameters_.push_back(
        {.info = {.name = "untold", .unit = "-", .description = "", .lower = -1e6, .upper = 1e6, .null_value = 0.0},
         .value = 0.0,
         .step = 1e-1,
         .prior = 0.0,
         .free = false});
    untold_ = static_cast<int>(parameters_.size()) - 1;
    return *this;
  }

  /// One more candidate, whose mark is what the noise of this seed makes of it in some of the frames.
  Curves& with_mark_of_noise(unsigned seed) {
    candidates_.push_back({.name = "answer",
                           .link = Link::material,
                           .parameters = {static_cast<int>(parameters_.size())},
                           .sentence = "answer",
                           .confused_with = "",
                           .separated_by = "another test",
                           .after = {}});
    answer_ = parameters_.size();
    parameters_.push_back(
        {.info = {.name = "answer", .unit = "-", .description = "", .lower = -100.0, .upper = 100.0, .null_value = 0.0},
         .value = 0.0,
         .step = 1e-4,
         .prior = 0.0,
         .free = false});
    mark_of_noise_ = draw(seed), disturbance_ = draw(seed + 77U);
    mark_of_noise_.tail(mark_of_noise_.size() - 50).setZero(), disturbance_.tail(mark_of_noise_.size() - 50).setZero();
    return *this;
  }

  /// The force of one frame is off.
  Curves& with_force_off(int frame, double by) {
    measured_[frame * (numbers + 1) + numbers] += by;
    return *this;
  }

  /// One more candidate, of size 1 in frame 25 as it is measured, and with a mark of the share `elsewhere` in all
  /// others that are fitted, where it is measured if `everywhere`; there it has all numbers `alike`, or any sign.
  Curves& with_burst(double elsewhere, bool everywhere, bool alike = false) {
    with_mark_of_noise(1);
    candidates_.back().name = candidates_.back().sentence = "burst";
    const std::vector<int> held = held_out_blocks(frames);
    for (int i = 0; i < mark_of_noise_.size(); ++i) {
      const int t = i / (numbers + 1);
      mark_of_noise_[i] = 10.0 * (alike && t != 25 ? 1.0 : std::sin(7.0 * i + 0.3 * i * i)) *
                          (t == 25                                       ? 1.0
                           : std::count(held.begin(), held.end(), t) > 0 ? 0.0
                                                                         : elsewhere);
      if (everywhere || t == 25) measured_[i] += mark_of_noise_[i];
    }
    disturbance_.setZero();
    return *this;
  }

  /// The same mark is that of a second size of an effect.
  Curves& with_size_of_noise(int effect, unsigned seed, double largest) {
    with_mark_of_noise(seed);
    candidates_.pop_back();
    candidates_[static_cast<std::size_t>(effect)].parameters.push_back(static_cast<int>(answer_));
    return limit(answer_, -largest, largest);
  }

  /// One more candidate, which is what is curved by another name.
  Curves& with_curved_again() {
    candidates_.push_back({.name = "curved again",
                           .link = Link::record,
                           .parameters = {static_cast<int>(parameters_.size())},
                           .sentence = "curved again",
                           .confused_with = "",
                           .separated_by = "another test",
                           .after = {}});
    curved_again_ = parameters_.size();
    parameters_.push_back(parameters_[2 + curved]);
    parameters_.back().info.name = "curved again";
    return *this;
  }

  /// The last two numbers of a frame are those of another rig, which measures no drift.
  Curves& with_rig_without_drift() {
    std::vector<double> none;
    for (const auto& p : parameters_) none.push_back(p.value);
    std::vector<double> one = none;
    one[2 + drift] = 1.0;
    const Eigen::VectorXd mark = predict(one) - predict(none);
    for (int t = 0; t < frames; ++t)
      for (int k = numbers - 2; k < numbers; ++k) {
        const int row = t * (numbers + 1) + k;
        data_[static_cast<std::size_t>(row)].channel = 1;
        measured_[row] -= size_of_drift_ * mark[row];
      }
    return *this;
  }

  /// The drift that is measured in the held-out frames, too, is none of the model's there.
  Curves& without_drift_when_held_out() {
    drift_when_held_out_ = false;
    return *this;
  }

  /// A parameter is known beforehand.
  Curves& know(std::size_t parameter, double value, double deviation) {
    parameters_[parameter].value = value, parameters_[parameter].prior = deviation;
    return *this;
  }

  /// The effect is a formula for this function.
  Curves& formula(Effect effect, const std::string& function) {
    candidates_[static_cast<std::size_t>(effect)].formula_for = function;
    return *this;
  }

  /// The size of an effect was read beside the data.
  Curves& read(Effect effect, double reading, double deviation) {
    auto& p = parameters_[static_cast<std::size_t>(2 + effect)];
    p.reading = reading, p.prior = deviation;
    return *this;
  }

  const std::vector<Parameter>& parameters() const override { return parameters_; }
  const std::vector<Candidate>& candidates() const override { return candidates_; }
  const std::vector<Datum>& data() const override { return data_; }
  std::vector<int> frame_numbers() const override {
    std::vector<int> all;
    for (int t = 0; t < frames; ++t) all.push_back(100 + t);
    return all;
  }
  bool takes_simulations(int parameter) const override { return costly && parameter >= 2; }
  void learn_bias(const std::vector<double>& values) override {
    if (!learns) throw ConvergenceError("the model on a finer mesh cannot follow");
    learned_at = values;
    put_back(std::make_shared<Size>(values));
  }
  std::shared_ptr<const Learned> learned() const override { return bias_of_kink > 0.0 ? learned_ : nullptr; }
  void put_back(const std::shared_ptr<const Learned>& learned) override {
    learned_ = std::dynamic_pointer_cast<const Size>(learned);
  }
  Doubt doubt() const override {
    const Eigen::VectorXd quarter =
        Eigen::VectorXd::Constant(measured_.size(), 0.25 * bias_of_kink * (learned_ ? std::abs(learned_->kink) : 0.0));
    return {(quarter.array() + doubted_each).matrix(), Eigen::VectorXd((quarter.array() + doubted_whole).matrix())};
  }
  double doubted_each = 0.0, doubted_whole = 0.0;  // more of it, whatever there is
  bool costly = false;                             // derivatives by the effects take series of their own
  std::vector<double> learned_at;                  // of which model the bias was learned last
  double bias_of_kink = 0.0;                       // what the mesh errs by where there is one
  double unlike_twins = 0.2;                       // the rest of gain
  bool follows = true;                             // what its model is asked for
  bool learns = true;                              // what its synthetic test is
  bool records_offset = true;
  bool knows_disturbance = true;  // the noise of what drives it
  // sets that its model can follow
  std::function<bool(const std::vector<double>&)> within = [](const auto&) { return true; };
  int series = 0;

  std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override {
    if (!follows) throw ConvergenceError("the model cannot follow");
    series += static_cast<int>(sets.size());
    std::vector<Eigen::VectorXd> all;
    for (const auto& set : sets)
      all.emplace_back(within(set) ? Eigen::VectorXd(measured_ - predict(set)) : Eigen::VectorXd());
    return all;
  }
  std::vector<Eigen::VectorXd> residuals_disturbed(const std::vector<double>& values,
                                                   std::vector<std::vector<double>> sets, double times) override {
    if (!knows_disturbance) return {};
    const Eigen::VectorXd undisturbed = mark_of_noise_;
    mark_of_noise_ += times * disturbance_;
    auto all = residuals_near(values, std::move(sets));
    mark_of_noise_ = undisturbed;
    return all;
  }
  Eigen::MatrixXd noise(const std::vector<double>&, int draws) override {
    Eigen::MatrixXd all(measured_.size(), draws);
    for (int b = 0; b < draws; ++b) all.col(b) = draw(of_null_ + static_cast<unsigned>(b));
    return all;
  }

 private:
  struct Size final : Learned {
    explicit Size(const std::vector<double>& values) : kink(values[2 + Curves::kink]) { at = values; }
    double kink;
  };
  std::shared_ptr<const Size> learned_;
  Eigen::VectorXd predict(const std::vector<double>& v) const {
    Eigen::VectorXd y(frames * (numbers + 1));
    const std::vector<int> held = held_out_blocks(frames);
    const double bend = v[7] + (curved_again_ > 0 ? v[curved_again_] : 0.0);
    for (int t = 0; t < frames; ++t) {
      const double s = (t + 1.0) / frames;
      const bool held_out = std::count(held.begin(), held.end(), t) > 0;
      for (int k = 0; k < numbers; ++k) {
        const double phi = std::cos(k * s), psi = s * s * std::sin(k + 2.0 * s);
        double u = v[0] * phi + v[1] * v[1] * psi;
        if (drift_when_held_out_ || !held_out) u += v[2] * s * (k - 2.0);  // drift
        u += v[3] * std::max(0.0, s - 0.6) * (k == 1 ? 3.0 : -1.0);        // kink
        const double mark = s * (1.0 - s) * std::cos(2.0 * k);
        u += (v[4] + v[5]) * mark + 1e-9 * v[5];  // two that leave the same mark
        u += v[6] * phi;                          // gain: like p0, but for
        // a rest that is nearly that of the twins
        u += rest_of_gain_ * v[6] * (mark + unlike_twins * s * std::sin(5.0 * k));
        u += (1.0 - std::exp(-0.5 * bend * s)) * (k % 2 == 0 ? 2.0 : -2.0) * s;  // not linear in its size
        u += like_drift_ * bend * bend * s * (k - 2.0);                          // where it is large
        if (untold_ >= 0) u += v[static_cast<std::size_t>(untold_)] * (held_out ? 1.0 : 1e-3) * std::cos(3.0 * k);
        if (pulse_ > 0) {
          const double since = s - v[pulse_ + 1];
          const double there =
              step_ ? 1.0 / (1.0 + std::exp(-15.0 * frames * since)) : std::exp(-std::pow(since / 0.06, 2));
          u += v[pulse_] * there * (k == 2 ? 1.0 : -0.5);
          if (step_) u += v[pulse_] * goes_with_moment(t * (numbers + 1) + k, v[pulse_ + 1]);
        }
        y[t * (numbers + 1) + k] = u;
      }
      y[t * (numbers + 1) + numbers] = 30.0 * v[0] * std::tanh(4.0 * s) + 20.0 * v[1] * s +
                                       30.0 * v[6] * std::tanh(4.0 * s) + (records_offset ? v[8] : 0.0);
    }
    if (answer_ > 0) y += v[answer_] * mark_of_noise_;
    return y;
  }
  /// In frames that are fitted.
  static double goes_with_moment(int i, double moment) {
    const std::vector<int> held = held_out_blocks(frames);
    const int t = i / (numbers + 1), k = i % (numbers + 1);
    if (k == numbers || std::count(held.begin(), held.end(), t) > 0) return 0.0;
    return 0.25 * moment * std::sin(7.0 * i + 0.3 * i * i);
  }
  static Eigen::VectorXd draw(unsigned seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    Eigen::VectorXd noise(frames * (numbers + 1));
    for (double& x : noise) x = normal(random);
    for (int t = 0; t < frames; ++t) {
      const double common = 1.5 * normal(random);
      for (int k = 0; k <= numbers; ++k) noise[t * (numbers + 1) + k] += common * (k == numbers ? 2.0 : 0.3 * k);
    }
    return noise;
  }

  std::vector<Parameter> parameters_;
  std::vector<Candidate> candidates_;
  std::vector<Datum> data_;
  std::size_t answer_ = 0, curved_again_ = 0, pulse_ = 0;
  bool step_ = false;
  Eigen::VectorXd mark_of_noise_, disturbance_;
  int untold_ = -1;  // a parameter that shows in held-out frames
  bool drift_when_held_out_ = true;
  double size_of_drift_ = 0.0;
  Eigen::VectorXd measured_;
  unsigned of_null_;
  double rest_of_gain_;
  double like_drift_;  // what is curved looks so from afar
};

inline const LoopOptions usual{.draws = 200, .additions = 3, .rivals = 4, .starts = {1.0, 0.8}, .held_out = {}};

inline Report loop_on(Curves experiment) { return close_loop(experiment, usual); }

}  // namespace imic3d::loop
