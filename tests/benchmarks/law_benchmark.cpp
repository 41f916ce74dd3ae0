// Time of one material point in the plastic regime on one thread: DESIGN section 6 asks for about 2 microseconds with
// the tangent. Run: OMP_NUM_THREADS=1 build/release/tests/benchmarks/benchmark_law
#include <benchmark/benchmark.h>

#include <cstdlib>
#include <vector>

#include "imic3d/material/hardening.hpp"
#include "imic3d/material/j2.hpp"
#include "imic3d/material/log_strain_law.hpp"

namespace imic3d::material {
namespace {

/// A point of the paper's steel after one plastic step, about to take a second one.
struct Point {
  std::vector<double> parameters{198e3, 0.25, 284, 1480, 0.042, 7.16e-5}, history, next;
  Matrix3 F = Matrix3::Identity();

  Point(const FiniteStrainLaw& law, bool plastic)
      : history(static_cast<std::size_t>(law.history_size())), next(history) {
    Matrix3 direction;
    direction << 1.0, 0.31, -0.2, 0.12, -0.45, 0.07, -0.11, 0.23, -0.5;
    std::vector<double> virgin(history);
    law.initialise(virgin);
    Response response;
    if (!plastic) {
      history = virgin;
      F += 5e-4 * direction;
      return;
    }
    F += 0.02 * direction;
    if (!law.update(F, 1.0, parameters, virgin, history, response, false)) std::abort();
    F += 0.005 * direction;
  }
};

void update(benchmark::State& state, const FiniteStrainLaw& law, bool plastic, bool with_tangent) {
  Point point(law, plastic);
  Response response;
  for (auto _ : state) {
    benchmark::DoNotOptimize(point.F);
    if (!law.update(point.F, 1.0, point.parameters, point.history, point.next, response, with_tangent)) std::abort();
    benchmark::DoNotOptimize(response);
  }
  if (plastic && !(point.next[9] > point.history[9])) state.SkipWithError("the point does not yield");
}

void stress_elastic(benchmark::State& state) { update(state, *make_law({}), false, false); }
void stress_and_tangent_elastic(benchmark::State& state) { update(state, *make_law({}), false, true); }
void stress_plastic(benchmark::State& state) { update(state, *make_law({}), true, false); }
void stress_and_hand_tangent_plastic(benchmark::State& state) { update(state, *make_law({}), true, true); }
void stress_and_dual_tangent_plastic(benchmark::State& state) {
  update(state, LogStrainLaw<J2<PowerLinear>, false>(J2<PowerLinear>{}), true, true);
}
/// One step from the virgin state with the given effects at their null values.
void with_effects(benchmark::State& state, std::vector<std::string> effects, bool with_tangent,
                  bool plane_stress = false) {
  const auto law = make_law({.plane_stress = plane_stress, .effects = std::move(effects)});
  std::vector<double> parameters{198e3, 0.25, 284, 1480, 0.042, 7.16e-5},
      history(static_cast<std::size_t>(law->history_size())), next(history);
  for (std::size_t i = parameters.size(); i < law->parameters().size(); ++i)
    parameters.push_back(*law->parameters()[i].null_value);
  law->initialise(history);
  Matrix3 F;
  F << 1.02, 0.006, -0.004, 0.002, 0.99, 0.001, -0.002, 0.005, 0.99;
  if (plane_stress) F(0, 2) = F(1, 2) = F(2, 0) = F(2, 1) = 0.0, F(2, 2) = 1.0;
  Response response;
  for (auto _ : state) {
    benchmark::DoNotOptimize(F);
    if (!law->update(F, 1.0, parameters, history, next, response, with_tangent)) std::abort();
    benchmark::DoNotOptimize(response);
  }
}
void kinematic_rate_stress_plastic(benchmark::State& state) { with_effects(state, {"kinematic", "rate"}, false); }
void kinematic_rate_tangent_plastic(benchmark::State& state) { with_effects(state, {"kinematic", "rate"}, true); }
void kinematic_rate_stress_in_the_plane(benchmark::State& state) {
  with_effects(state, {"kinematic", "rate"}, false, true);
}
void kinematic_rate_tangent_in_the_plane(benchmark::State& state) {
  with_effects(state, {"kinematic", "rate"}, true, true);
}
void hill_stress_plastic(benchmark::State& state) { with_effects(state, {"hill"}, false); }
void hill_tangent_plastic(benchmark::State& state) { with_effects(state, {"hill"}, true); }
void hill_stress_in_the_plane(benchmark::State& state) { with_effects(state, {"hill"}, false, true); }
void hill_tangent_in_the_plane(benchmark::State& state) { with_effects(state, {"hill"}, true, true); }
void all_effects_stress_plastic(benchmark::State& state) { with_effects(state, known_effects(), false); }
void all_effects_tangent_plastic(benchmark::State& state) { with_effects(state, known_effects(), true); }
void parameter_derivatives_plastic(benchmark::State& state) {
  const auto law = make_law({});
  const Point point(*law, true);
  Eigen::Matrix<double, 6, Eigen::Dynamic> derivatives(6, 6);
  for (auto _ : state) {
    if (!law->parameter_derivatives(point.F, 1.0, point.parameters, point.history, derivatives)) std::abort();
    benchmark::DoNotOptimize(derivatives.data());
  }
}
void directional_derivative_plastic(benchmark::State& state) {
  const auto law = make_law({});
  const Point point(*law, true);
  const std::vector<double> d_parameters(6, 1.0), d_history(10, 0.1);
  std::vector<double> d_next(10);
  Vector6 d_kirchhoff;
  for (auto _ : state) {
    if (!law->directional_derivative(point.F, point.F, 1.0, point.parameters, d_parameters, point.history, d_history,
                                     d_kirchhoff, d_next))
      std::abort();
    benchmark::DoNotOptimize(d_kirchhoff);
  }
}
void eigenvalues(benchmark::State& state) {
  const SymmetricTensor<double> A{{0.01, -0.004, -0.006, 0.002, 0.003, -0.001}};
  for (auto _ : state) benchmark::DoNotOptimize(spectral_decomposition(A));
}

BENCHMARK(stress_elastic);
BENCHMARK(stress_and_tangent_elastic);
BENCHMARK(stress_plastic);
BENCHMARK(stress_and_hand_tangent_plastic);
BENCHMARK(stress_and_dual_tangent_plastic);
BENCHMARK(kinematic_rate_stress_plastic);
BENCHMARK(kinematic_rate_tangent_plastic);
BENCHMARK(kinematic_rate_stress_in_the_plane);
BENCHMARK(kinematic_rate_tangent_in_the_plane);
BENCHMARK(hill_stress_plastic);
BENCHMARK(hill_tangent_plastic);
BENCHMARK(hill_stress_in_the_plane);
BENCHMARK(hill_tangent_in_the_plane);
BENCHMARK(all_effects_stress_plastic);
BENCHMARK(all_effects_tangent_plastic);
BENCHMARK(parameter_derivatives_plastic);
BENCHMARK(directional_derivative_plastic);
BENCHMARK(eigenvalues);

}  // namespace
}  // namespace imic3d::material

BENCHMARK_MAIN();
