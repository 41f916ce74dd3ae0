#include "imic3d/material/bar.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <vector>

namespace imic3d::material {

namespace {

using State = Eigen::Vector4d;  // a, b, g, axial logarithmic strain

Matrix3 tensor(const Vector6& v) {
  Matrix3 t;
  t << v[0], v[3], v[5], v[3], v[1], v[4], v[5], v[4], v[2];
  return t;
}

/// Whether one of these effects is away from its null value.
bool has(const FiniteStrainLaw& law, std::span<const double> parameters,
         std::initializer_list<std::string_view> effects) {
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const ParameterInfo& info = law.parameters()[i];
    if (std::find(effects.begin(), effects.end(), info.effect) != effects.end() && !info.shape && info.null_value &&
        parameters[i] != *info.null_value)
      return true;
  }
  return false;
}

/// A stress that falls as the rate grows has no rate in short steps: the bar jumps.
bool hardens_with_rate(const FiniteStrainLaw& law, std::span<const double> parameters) {
  if (!has(law, parameters, {"rate", "viscosity"})) return false;
  for (std::size_t i = 0; i < parameters.size(); ++i)
    if (law.parameters()[i].name == "C_rate" && parameters[i] < 0.0) return false;
  return true;
}

class Bar {
 public:
  Bar(const FiniteStrainLaw& law, std::span<const double> parameters, const BarHistory& history,
      std::span<const int> free)
      : law_(law),
        parameters_(parameters),
        free_(free),
        compliance_(history.compliance),
        unknowns_(compliance_ == 0.0 ? 3 : 4),
        plastic_strain_(hardens_with_rate(law, parameters) ? law.plastic_strain_index() : -1),
        old_(static_cast<std::size_t>(law.history_size())),
        new_(old_),
        dF_(free.size() + static_cast<std::size_t>(unknowns_), Matrix3::Zero()),
        d_tau_(dF_.size()),
        directions_(dF_.size() * parameters.size(), 0.0),
        d_old_(dF_.size() * old_.size(), 0.0),
        d_new_(d_old_.size()),
        d_stress_(Eigen::VectorXd::Zero(static_cast<Eigen::Index>(free.size()))) {
    law.initialise(old_);
    for (std::size_t j = 0; j < free.size(); ++j)
      directions_[j * parameters.size() + static_cast<std::size_t>(free[j])] = 1.0;
    const double angle = history.direction * std::numbers::pi / 180.0;
    Q_ = Matrix3::Identity();
    if (history.direction != 0.0) Q_ = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  }

  /// From the state reached so far to the `shown` strain; false leaves the state as it is. Where it can be `shorter` it
  /// is false, too, if the plastic strain rate, which the law takes for one in a step, has changed.
  bool step(double shown, double time_increment, bool shorter) {
    State x = x_ + course_ * (shown - shown_);
    if (compliance_ == 0.0) x[3] = shown;
    Response response;
    Eigen::Matrix4d slope = Eigen::Matrix4d::Zero();
    double last = INFINITY;
    for (int iteration = 0;; ++iteration) {
      if (!law_.update(turned(gradient(x)), time_increment, parameters_, old_, new_, response, true)) return false;
      const Matrix3 tau = back(tensor(response.kirchhoff));
      // The last equation, exp(shown) = exp(strain) + compliance * engineering stress, in the size of the others.
      const double stiffness = response.tangent.norm(), shrink = std::exp(-x[3]);
      State r = unbalanced(tau, compliance_ * stiffness * shrink);
      r[3] += stiffness * (std::exp(x[3]) - std::exp(shown));
      for (int k = 0; k < unknowns_; ++k)
        slope.col(k) = unbalanced(rate(response, tau, x, k), compliance_ * stiffness * shrink);
      slope(3, 3) += stiffness * (std::exp(x[3]) - compliance_ * shrink * tau(0, 0));
      State change = State::Zero();
      change.head(unknowns_) = slope.topLeftCorner(unknowns_, unknowns_).partialPivLu().solve(r.head(unknowns_));
      const double size = r.head(unknowns_).norm(), round_off = 1e-15 * stiffness + 1e-13 * tau.norm();
      // Done at the level of round-off; the last correction costs nothing.
      if (size <= round_off || (size < 1e-8 * tau.norm() && size > 0.25 * last)) {
        if (plastic_strain_ >= 0 && time_increment > 0.0) {
          const auto p = static_cast<std::size_t>(plastic_strain_);
          constexpr double alike = 0.05, least = 1e-6;
          const double flow = new_[p] - old_[p], as_before = speed_ * time_increment;
          if (shorter && std::abs(flow - as_before) > std::max(least, alike * std::max(flow, as_before))) return false;
          speed_ = flow / time_increment;
        }
        finish(shown, x, time_increment, tau(0, 0), slope, compliance_ * stiffness * shrink);
        return true;
      }
      if (iteration == 50 || !change.allFinite()) return false;
      last = size;
      const double largest = std::max(0.02, 2.0 * std::abs(shown - shown_));
      x -= change.norm() > largest ? State(largest / change.norm() * change) : change;
    }
  }

  [[nodiscard]] double shown() const { return shown_; }
  [[nodiscard]] double stress() const { return stress_; }
  [[nodiscard]] auto lateral() const { return x_.head<2>(); }
  [[nodiscard]] const Eigen::VectorXd& derivatives() const { return d_stress_; }
  [[nodiscard]] double plastic_strain() const {
    return law_.plastic_strain_index() < 0 ? 0.0 : old_[static_cast<std::size_t>(law_.plastic_strain_index())];
  }

 private:
  static Matrix3 gradient(const State& x) {
    Matrix3 F = Eigen::Vector3d(std::exp(x[3]), std::exp(x[0]), std::exp(x[1])).asDiagonal();
    F(0, 1) = x[2];
    return F;
  }
  /// dF/dx_k
  static Matrix3 gradient_rate(const State& x, int k) {
    Matrix3 dF = Matrix3::Zero();
    if (k < 2)
      dF(k + 1, k + 1) = std::exp(x[k]);
    else if (k == 2)
      dF(0, 1) = 1.0;
    else
      dF(0, 0) = std::exp(x[3]);
    return dF;
  }
  /// What has to vanish of a stress: across the bar, and its share of the shown strain's equation.
  static State unbalanced(const Matrix3& tau, double share) {
    return {tau(1, 1), tau(2, 2), tau(0, 1), share * tau(0, 0)};
  }
  [[nodiscard]] Matrix3 turned(const Matrix3& in_bar) const { return Q_ * in_bar * Q_.transpose(); }
  [[nodiscard]] Matrix3 back(const Matrix3& in_law) const { return Q_.transpose() * in_law * Q_; }

  /// d tau / dx_k in the bar's axes.
  [[nodiscard]] Matrix3 rate(const Response& response, const Matrix3& tau, const State& x, int k) const {
    const Matrix3 L = gradient_rate(x, k) * gradient(x).inverse(), D = turned(0.5 * (L + L.transpose()));
    const Vector6 d(D(0, 0), D(1, 1), D(2, 2), 2 * D(0, 1), 2 * D(1, 2), 2 * D(0, 2));
    return back(tensor(response.tangent * d)) + L * tau + tau * L.transpose();
  }

  /// Direct differentiation of the step, then the state moves on. Directions of the law: each parameter at fixed
  /// strains, then each unknown strain alone, of which the parameters' share follows from what stays zero.
  void finish(double shown, const State& x, double time_increment, double stress, const Eigen::Matrix4d& slope,
              double share) {
    const std::size_t count = free_.size(), history = old_.size(), unknowns = static_cast<std::size_t>(unknowns_);
    const double longer = std::exp(shown - x[3]);
    if (count > 0) {
      for (std::size_t k = 0; k < unknowns; ++k) dF_[count + k] = turned(gradient_rate(x, static_cast<int>(k)));
      Vector6 tau;
      if (!law_.directional_derivatives(turned(gradient(x)), dF_, time_increment, parameters_, directions_, old_,
                                        d_old_, tau, d_tau_, d_new_))
        throw std::runtime_error("the derivative of a step that was possible");
      const auto lu = slope.topLeftCorner(unknowns_, unknowns_).partialPivLu();
      for (std::size_t j = 0; j < count; ++j) {
        const Eigen::VectorXd dx = -lu.solve(unbalanced(back(tensor(d_tau_[j])), share).head(unknowns_));
        for (std::size_t k = 0; k < unknowns; ++k) {
          d_tau_[j] += dx[static_cast<Eigen::Index>(k)] * d_tau_[count + k];
          for (std::size_t i = 0; i < history; ++i)
            d_new_[j * history + i] += dx[static_cast<Eigen::Index>(k)] * d_new_[(count + k) * history + i];
        }
        d_stress_[static_cast<Eigen::Index>(j)] =
            longer * (back(tensor(d_tau_[j]))(0, 0) - (unknowns_ == 4 ? stress * dx[3] : 0.0));
      }
      std::copy_n(d_new_.begin(), count * history, d_old_.begin());
    }
    old_.swap(new_);
    if (shown != shown_) course_ = (x - x_) / (shown - shown_);
    shown_ = shown, x_ = x, stress_ = longer * stress;
  }

  const FiniteStrainLaw& law_;
  std::span<const double> parameters_;
  std::span<const int> free_;
  double compliance_;
  int unknowns_;        // of the state: the axial strain is one where the load train gives way
  int plastic_strain_;  // its place in the history, of a law that depends on its rate; -1: not
  std::vector<double> old_, new_;
  std::vector<Matrix3> dF_;
  std::vector<Vector6> d_tau_;
  std::vector<double> directions_, d_old_, d_new_;  // direction after direction
  Eigen::VectorXd d_stress_;
  Matrix3 Q_;
  double shown_ = 0.0, stress_ = 0.0, speed_ = 0.0;         // speed: of the plastic strain
  State x_ = State::Zero(), course_{-0.5, -0.5, 0.0, 1.0};  // the next step goes on as the last one did
};

/// How fast the fastest back-stress fades, per plastic strain; 0: there is none.
double fading(const FiniteStrainLaw& law, std::span<const double> parameters) {
  double fastest = 0.0;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const ParameterInfo& info = law.parameters()[i];
    if (info.name.starts_with("gamma_") && has(law, parameters, {info.effect}))
      fastest = std::max(fastest, parameters[i]);
  }
  return fastest;
}

/// Every step that `options` leave of a row in `parts`.
BarResponse in_steps(const FiniteStrainLaw& law, std::span<const double> parameters, const BarHistory& history,
                     std::span<const int> free, const BarOptions& options, int parts) {
  const Eigen::Index n = history.strain.size();
  BarResponse response{
      .rows = 0,
      .kirchhoff = Eigen::VectorXd::Constant(n, std::nan("")),
      .engineering = Eigen::VectorXd::Constant(n, std::nan("")),
      .lateral = Eigen::MatrixXd::Constant(n, 2, std::nan("")),
      .plastic_strain = Eigen::VectorXd::Constant(n, std::nan("")),
      .derivatives = Eigen::MatrixXd::Constant(n, static_cast<Eigen::Index>(free.size()), std::nan(""))};
  Bar bar(law, parameters, history, free);
  // A tenth of a back-stress at most fades in a step.
  constexpr double part = 0.1, least = 1.0 / 8.0;
  const double fades = options.given_steps ? 0.0 : fading(law, parameters);
  const double longest =
      std::clamp(fades > 0.0 ? part / fades : options.largest_step, least * options.largest_step, options.largest_step);
  const auto reach = [&](double strain, double duration) {
    const double from = bar.shown(), way = strain - from;
    int count = std::max(1, static_cast<int>(std::ceil(std::abs(way) / longest - 1e-9))) * parts, halvings = 0;
    for (int k = 1; k <= count;) {
      if (bar.step(k == count ? strain : from + way * k / count, duration / count,
                   !options.given_steps && halvings < options.most_halvings)) {
        // Short steps where they are needed only: one corner of the curve would else cost thousands of them to the end
        // of its row.
        if (halvings > 0 && k % 2 == 0) --halvings, k /= 2, count /= 2;
        ++k;
        continue;
      }
      if (++halvings > options.most_halvings) return false;
      k = 2 * k - 1, count *= 2;
    }
    return true;
  };
  auto turn = history.turns.begin();
  for (Eigen::Index row = 0; row < n; ++row) {
    double since = row > 0 ? history.time[row - 1] : history.time[0];
    for (; turn != history.turns.end() && turn->row == row; ++turn) {
      if (!turn->between) continue;
      if (!reach(turn->strain, turn->time - since)) return response;
      since = turn->time;
    }
    if (!reach(history.strain[row], history.time[row] - since)) return response;
    response.kirchhoff[row] = bar.stress();
    response.engineering[row] = bar.stress() * std::exp(-bar.shown());
    response.lateral.row(row) = bar.lateral().transpose();
    response.plastic_strain[row] = bar.plastic_strain();
    response.derivatives.row(row) = bar.derivatives().transpose();
    response.rows = row + 1;
  }
  return response;
}

}  // namespace

BarResponse pull_bar(const FiniteStrainLaw& law, std::span<const double> parameters, const BarHistory& history,
                     std::span<const int> free, const BarOptions& options) {
  if (law.thickness_strain_index() >= 0) throw std::invalid_argument("pull_bar: a law of plane stress");
  BarResponse whole = in_steps(law, parameters, history, free, options, 1);
  // Isotropic hardening is a function of the plastic strain, which goes one way: steps of any length are exact.
  // Back-stresses and heat are integrated.
  if (!has(law, parameters, {"kinematic", "kinematic_2", "kinematic_3", "heating"}) ||
      whole.rows < history.strain.size())
    return whole;
  BarResponse response = in_steps(law, parameters, history, free, options, 2);
  if (response.rows < history.strain.size()) return whole;
  const auto extrapolate = [](auto& halved, const auto& once) { halved += halved - once; };
  extrapolate(response.kirchhoff, whole.kirchhoff), extrapolate(response.engineering, whole.engineering),
      extrapolate(response.lateral, whole.lateral);
  extrapolate(response.plastic_strain, whole.plastic_strain), extrapolate(response.derivatives, whole.derivatives);
  return response;
}

}  // namespace imic3d::material
