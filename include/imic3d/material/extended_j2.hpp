#pragma once
// J2 plasticity with the effects that metals and polymers show beside isotropic hardening, each with a null value at
// which it is absent.

#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "imic3d/material/effects/list.hpp"
#include "imic3d/material/scalar_root.hpp"
#include "imic3d/material/small_strain_law.hpp"

namespace imic3d::material {

/// With s the deviator of the effective stress, xi = s - sum alpha_i, sigma_m the mean stress and p the accumulated
/// plastic strain, at the end of the step:
///
///   q(xi) + friction sigma_m = J [(sigma_y(<p - eps_L>) + Q_v (1 - exp(-b_v p))) (1 + C_rate ln(1 + p'/rate_0)) (1 -
///   heating w) + eta p'^m] Delta Ep = dp (n + dilatancy/3 I),  n = dq/dxi,  p' = dp/dt,  stress = (1 - D) (s + sigma_m
///   I)
///
/// q is von Mises' or Hill's equivalent stress, J = 1 or, with `cauchy_yield`, the volume ratio. Everything is a
/// function of dp alone: one scalar equation, solved in plain numbers; one Newton step in dual numbers at its root
/// gives all derivatives. A step without duration has no rates. Parameters: E, nu, the hardening's, then those of the
/// effects that are switched on. State: p, stored heat w, three back-stresses. At the null values it is J2 (j2.hpp).
template <class Hardening>
struct ExtendedJ2 {
  static constexpr int back_stresses = 3;
  static constexpr int state_size = 2 + 6 * back_stresses;
  static constexpr int plastic_strain_index = 0;
  using Effect = effects::Effect;

  Hardening yield_stress;
  std::string label;
  bool cauchy_yield;
  effects::Selection selection;

  ExtendedJ2(Hardening hardening, std::string name, bool cauchy, effects::Selection chosen)
      : yield_stress(std::move(hardening)), label(std::move(name)), cauchy_yield(cauchy), selection(chosen) {
    selection.place(2 + static_cast<int>(yield_stress.parameters().size()));
  }

  [[nodiscard]] std::string name() const { return label; }

  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    std::vector<ParameterInfo> all = isotropic_elasticity_parameters();
    const auto append = [&](std::vector<ParameterInfo> more) {
      for (auto& parameter : more) all.push_back(std::move(parameter));
    };
    append(yield_stress.parameters());
    for (std::size_t i = 0; i < effects::list.size(); ++i)
      if (selection.has(static_cast<Effect>(i))) append(effects::list[i].parameters());
    return all;
  }

  void initialise(std::span<double> state) const { std::fill(state.begin(), state.end(), 0.0); }

  /// Back-stresses that fade, pressure and damage are not derivatives of one potential. Nor is a yield stress in Cauchy
  /// stress, but what that adds is of the size of sigma_y/K: the tangent is made symmetric (LogStrainLaw), and Newton's
  /// method needs an iteration or two more.
  [[nodiscard]] bool symmetric_tangent() const {
    using enum effects::Effect;
    for (const Effect effect : {kinematic, kinematic_2, kinematic_3, pressure, damage})
      if (selection.has(effect)) return false;
    return true;
  }

  template <Scalar T>
  [[nodiscard]] bool update(const StrainStep<T>& step, StressUpdate<T, state_size>& result) const noexcept {
    // (i) elastic predictor
    const At<T> at(*this, step);
    const T elastic(0.0);
    const double excess = value(at.residual(elastic));
    if (!std::isfinite(excess)) return false;

    // (ii) admissibility
    if (excess <= 0.0) {
      at.finish(elastic, result);
      return true;
    }

    // (iii) return mapping: the root in plain numbers, then its derivatives
    const ParameterValues parameters(step.parameters);
    std::array<double, state_size> state;
    for (std::size_t i = 0; i < state.size(); ++i) state[i] = value(step.state[i]);
    const ConstantStep<Dual<1>, state_size> constants(
        {values(step.trial_strain), step.time_increment, parameters, state});
    const StrainStep<Dual<1>> constant_step = constants.step();
    const At<Dual<1>> plain(*this, constant_step);
    const auto residual = [&](const Dual<1>& dp) { return plain.residual(dp); };
    double upper = excess / (3.0 * value(at.G));
    for (int doubling = 0; !(value(residual(Dual<1>(upper))) < 0.0); ++doubling, upper *= 2.0)
      if (doubling == 60) return false;
    const auto root = bracketed_newton(residual, 0.0, upper, value(at.trial_stress()));
    if (!root) return false;
    if (*root < negligible) {  // a viscous overstress of small exponent holds all of the excess
      at.finish(elastic, result);
      return true;
    }
    if (const auto there = plain.flow(Dual<1>(*root)); !there || !(value(there->q) > 0.0))
      return false;  // no strength left
    // A rate that takes the whole yield stress away: what would remain is the viscous stress of a fluid, and several
    // rates for one stress.
    if (const auto rate = plain.of(Effect::rate);
        !rate.empty() && step.time_increment > 0.0 &&
        !(value(effects::JohnsonCookRate::factor(rate, Dual<1>(*root / step.time_increment))) > 0.0))
      return false;
    const T dp = implicit_root(*root, at.residual(T(*root)), residual(Dual<1>::variable(*root, 0)).derivative[0]);
    at.finish(dp, result);
    return true;
  }

  /// eps_33 that makes the stress through the thickness vanish. In the plane, back-stresses being counted from their
  /// normal component, eta = stress - back-stress returns by
  ///
  ///   (1 + dp/q (C + 2/3 sum C_i/(1 + gamma_i dp) P) M) eta = C E_trial - sum alpha_i,old/(1 + gamma_i dp)
  ///
  /// with C of plane stress, P = [2 1; 1 2] and M of the criterion; on the yield surface q is the strength, so that all
  /// follows from dp (de Souza Neto et al. 2008, ch. 9; Hill's axes). None where volume or heat take part.
  [[nodiscard]] std::optional<double> thickness_strain(const StrainStep<double>& step) const noexcept {
    using D = Dual<1>;
    if (cauchy_yield || selection.has(Effect::pressure) || selection.has(Effect::heating)) return std::nullopt;
    const ConstantStep<D, state_size> constants(step);
    const StrainStep<D> constant_step = constants.step();
    const At<D> at(*this, constant_step);
    const double E = step.parameters[0], nu = step.parameters[1], shear = E / (1.0 + nu), along = E / (1.0 - nu * nu);
    double F = 0.5, G = 0.5, H = 0.5, N = 1.5;
    std::optional<Tensor<D>> axes;
    if (const auto p = at.of(Effect::hill); !p.empty()) {
      const effects::Hill48::Coefficients<D> M(p);
      F = value(M.F), G = value(M.G), H = value(M.H), N = value(M.N), axes = effects::Hill48::axes(p);
    }
    const auto in_axes = [&](const SymmetricTensor<D>& A) { return axes ? pull_back(*axes, A) : A; };
    const SymmetricTensor<D> e = in_axes(constant_step.trial_strain);
    struct Returned {
      D f, strength, first, second, q, mean;  // f = dp/q; eta along both axes; twice the mean stress
    };
    const auto returned = [&](const D& dp) {
      using std::sqrt;
      const D strength = at.strength(dp, SymmetricTensor<D>::zero()), f = dp / strength;
      D follows(0.0), back_first(0.0), back_second(0.0), back_shear(0.0);
      at.each_back_stress([&](std::size_t i, auto kinematic, std::span<const D> p) {
        const SymmetricTensor<D> old = kinematic.fading(p, dp) * in_axes(at.old_back_stress(i));
        back_first += old[0] - old[2], back_second += old[1] - old[2], back_shear += old[3];
        follows += (2.0 / 3.0) * kinematic.modulus(p, dp);
      });
      const D b_first = along * (e[0] + nu * e[1]) - back_first, b_second = along * (e[1] + nu * e[0]) - back_second;
      const D a = f * (along + 2.0 * follows), b = f * (nu * along + follows);
      const D k11 = 1.0 + a * (G + H) - b * H, k12 = b * (F + H) - a * H, k21 = b * (G + H) - a * H,
              k22 = 1.0 + a * (F + H) - b * H;
      const D scale = 1.0 / (k11 * k22 - k12 * k21);
      const D first = scale * (k22 * b_first - k12 * b_second), second = scale * (k11 * b_second - k21 * b_first);
      const D across = (shear * e[3] - back_shear) / (1.0 + (shear + follows) * N * f);
      // times q
      const D n_first = G * first + H * (first - second), n_second = F * second + H * (second - first);
      return Returned{f,
                      strength,
                      first,
                      second,
                      sqrt(first * n_first + second * n_second + 2.0 * N * across * across),
                      first + second + back_first + back_second + 3.0 * follows * f * (n_first + n_second)};
    };
    const auto residual = [&](const D& dp) {
      const Returned there = returned(dp);
      return value(there.strength) > 0.0 ? there.q - there.strength : D(std::nan(""));
    };
    double dp = 0.0;
    const double excess = value(residual(D(0.0)));
    if (std::isnan(excess)) return std::nullopt;
    if (excess > 0.0) {
      double upper = excess / (1.5 * shear);
      for (int doubling = 0; !(value(residual(D(upper))) < 0.0); ++doubling, upper *= 2.0)
        if (doubling == 60) return std::nullopt;
      const auto root =
          bracketed_newton(residual, 0.0, upper, excess + value(at.strength(D(0.0), SymmetricTensor<D>::zero())));
      if (!root) return std::nullopt;
      dp = *root;
    }
    const Returned there = returned(D(dp));
    return -value(there.mean) * nu / E - value(there.f) * (G * value(there.first) + F * value(there.second)) -
           step.trial_strain[2];
  }

 private:
  /// Everything that a step knows, and what follows from it for a plastic strain dp.
  template <Scalar T>
  struct At {
    const ExtendedJ2& law;
    const StrainStep<T>& step;
    T G, K, volume;
    SymmetricTensor<T> s_trial;
    struct Flow {
      T q;
      SymmetricTensor<T> n;
    };
    // at dp = 0, where the flow's direction is that of the trial stress whatever dp is: neither back-stresses nor
    // Hill's criterion
    std::optional<Flow> radial;

    At(const ExtendedJ2& law_, const StrainStep<T>& step_) : law(law_), step(step_), volume(trace(step.trial_strain)) {
      const IsotropicElasticity<T> elasticity(step.parameters[0], step.parameters[1]);
      G = elasticity.G, K = elasticity.K;
      s_trial = 2.0 * G * deviator(step.trial_strain);
      bool turned = !of(Effect::hill).empty();
      each_back_stress([&](std::size_t, auto, std::span<const T>) { turned = true; });
      if (!turned) radial = von_mises(s_trial);
    }

    [[nodiscard]] std::span<const T> of(Effect effect) const { return law.selection.of(effect, step.parameters); }
    [[nodiscard]] const T& old_strain() const { return step.state[0]; }
    [[nodiscard]] const T& old_heat() const { return step.state[1]; }
    [[nodiscard]] SymmetricTensor<T> old_back_stress(std::size_t i) const {
      SymmetricTensor<T> alpha;
      for (std::size_t k = 0; k < 6; ++k) alpha.components[k] = step.state[2 + 6 * i + k];
      return alpha;
    }
    [[nodiscard]] T trial_stress() const { return von_mises(s_trial).q; }

    [[nodiscard]] static Flow von_mises(const SymmetricTensor<T>& eta) {
      using std::sqrt;
      const T norm_squared = double_dot(eta, eta);
      if (!(value(norm_squared) > 0.0)) return {T(0.0), SymmetricTensor<T>::zero()};
      const T norm = sqrt(1.5 * norm_squared);
      return {norm, T(1.5 / norm) * eta};
    }
    /// eta and beta of xi = eta - 2/3 beta dp n: s_trial - sum alpha_i,old / (1 + gamma_i dp), 3 G + sum C_i / (1 +
    /// gamma_i dp).
    [[nodiscard]] std::pair<SymmetricTensor<T>, T> relative(const T& dp) const {
      std::pair<SymmetricTensor<T>, T> both(s_trial, 3.0 * G);
      each_back_stress([&](std::size_t i, auto kinematic, std::span<const T> p) {
        both.first = both.first - kinematic.fading(p, dp) * old_back_stress(i);
        both.second += kinematic.modulus(p, dp);
      });
      return both;
    }
    /// q and n where the plastic strain is dp.
    [[nodiscard]] std::optional<Flow> flow(const T& dp) const {
      if (radial) return Flow{radial->q - 3.0 * G * dp, radial->n};
      const auto [eta, beta] = relative(dp);
      if (const auto p = of(Effect::hill); !p.empty()) {
        const Tensor<T> axes = effects::Hill48::axes(p);
        const auto found = effects::Hill48::flow(effects::Hill48::Coefficients<T>(p), pull_back(axes, eta),
                                                 T((2.0 / 3.0) * beta * dp));
        if (!found) return std::nullopt;
        return Flow{found->q, push_forward(axes, found->n)};
      }
      Flow found = von_mises(eta);
      found.q -= beta * dp;
      return found;
    }

    [[nodiscard]] T mean_stress(const T& dp) const {
      const auto p = of(Effect::pressure);
      return K * (p.empty() ? volume : volume - p[1] * dp);
    }

    /// The heat at the end of the step.
    [[nodiscard]] T heat(const T& dp, const SymmetricTensor<T>& n) const {
      const auto p = of(Effect::heating);
      if (p.empty()) return T(0.0);
      T work = dp * double_dot(s_trial - 2.0 * G * (dp * n), n);
      if (const auto dilating = of(Effect::pressure); !dilating.empty()) work += dp * dilating[1] * mean_stress(dp);
      return effects::Heating::stored(p, old_heat(), work, step.time_increment);
    }

    /// What q is compared with.
    [[nodiscard]] T strength(const T& dp, const SymmetricTensor<T>& n) const {
      const T strain = old_strain() + dp;
      const auto plateau = of(Effect::plateau), voce = of(Effect::voce_term), voce_2 = of(Effect::voce_term_2),
                 power = of(Effect::power_term), rate = of(Effect::rate), viscosity = of(Effect::viscosity),
                 heating = of(Effect::heating);
      const T hardening_strain = plateau.empty() ? strain : effects::Plateau::hardening_strain(plateau, strain);
      T stress = law.yield_stress(hardening_strain, step.parameters.subspan(2), step.parameters[0]);
      if (!voce.empty()) stress += effects::VoceTerm<1>::stress(voce, strain);
      if (!voce_2.empty()) stress += effects::VoceTerm<2>::stress(voce_2, strain);
      if (!power.empty())
        stress += law.yield_stress(T(0.0), step.parameters.subspan(2), step.parameters[0]) *
                  effects::PowerTerm::factor(power, hardening_strain);
      const T speed = step.time_increment > 0.0 ? dp / step.time_increment : T(0.0);
      if (!rate.empty()) stress *= effects::JohnsonCookRate::factor(rate, speed);
      if (!heating.empty()) stress *= effects::Heating::factor(heating, heat(dp, n));
      if (!viscosity.empty()) stress += effects::Viscosity::overstress(viscosity, speed);
      if (law.cauchy_yield) stress *= volume_ratio();
      if (const auto pressure = of(Effect::pressure); !pressure.empty())
        stress *= effects::Pressure::factor(pressure, mean_stress(dp), stress);
      return stress;
    }

    /// J: elastic, and the plastic one that dilatancy left so far.
    [[nodiscard]] T volume_ratio() const {
      using std::exp;
      const auto p = of(Effect::pressure);
      return exp(p.empty() ? volume : volume + p[1] * old_strain());
    }

    /// Of the yield condition [stress]: positive where the elastic predictor is beyond it, falling with dp.
    [[nodiscard]] T residual(const T& dp) const {
      if (radial)
        return radial->q - 3.0 * G * dp - strength(dp, radial->n);  // as below, without a copy of n: all that is gained
      if (const auto p = of(Effect::hill); !p.empty() && of(Effect::heating).empty()) {
        // Where the condition is met q is the strength, and the stress follows from it without a search.
        using std::sqrt;
        const T q = strength(dp, SymmetricTensor<T>::zero());
        if (!(value(q) > 0.0)) return T(std::nan(""));
        const auto [eta, beta] = relative(dp);
        const effects::Hill48::Coefficients<T> M(p);
        const SymmetricTensor<T> xi =
            q * effects::Hill48::scaled(M, pull_back(effects::Hill48::axes(p), eta), T((2.0 / 3.0) * beta * dp), q);
        return sqrt(double_dot(xi, M * xi)) - q;
      }
      const auto flowing = flow(dp);
      if (!flowing) return T(std::nan(""));
      return flowing->q - strength(dp, flowing->n);
    }

    void finish(const T& dp, StressUpdate<T, state_size>& result) const {
      const bool flows = value(dp) > 0.0;
      const auto flowing = flows ? flow(dp) : std::nullopt;
      const SymmetricTensor<T> n = flowing ? flowing->n : SymmetricTensor<T>::zero();
      const auto pressure = of(Effect::pressure), damage = of(Effect::damage);
      result.plastic_increment = dp * n;
      result.stress = add_spherical(s_trial - 2.0 * G * result.plastic_increment, mean_stress(dp));
      const T strain = old_strain() + dp;
      result.state[0] = strain;
      result.state[1] = heat(dp, n);
      each_back_stress([&](std::size_t i, auto kinematic, std::span<const T> p) {
        const SymmetricTensor<T> alpha = kinematic.fading(p, dp) * old_back_stress(i) +
                                         T((2.0 / 3.0) * kinematic.modulus(p, dp)) * result.plastic_increment;
        for (std::size_t k = 0; k < 6; ++k) result.state[2 + 6 * i + k] = alpha.components[k];
      });
      if (!pressure.empty())
        result.plastic_increment = add_spherical(result.plastic_increment, T((1.0 / 3.0) * pressure[1] * dp));
      if (!damage.empty()) result.stress = effects::Damage::integrity(damage, strain) * result.stress;
      for (std::size_t i = 0; i < back_stresses; ++i)
        if (!law.selection.has(static_cast<Effect>(i)))
          for (std::size_t k = 0; k < 6; ++k) result.state[2 + 6 * i + k] = T(0.0);
    }

    /// do_it(i, KinematicHardening<i + 1>, its parameters) for those that are switched on.
    template <class Do>
    void each_back_stress(const Do& do_it) const {
      const auto one = [&](std::size_t i, auto kinematic) {
        if (const auto p = of(static_cast<Effect>(i)); !p.empty()) do_it(i, kinematic, p);
      };
      one(0, effects::KinematicHardening<1>{}), one(1, effects::KinematicHardening<2>{}),
          one(2, effects::KinematicHardening<3>{});
    }
  };
};

}  // namespace imic3d::material
