// What a pixel costs, beside what the machine can do: memory bandwidth and arithmetic in the same program. Rates are by
// the processor's time of one thread. Run: OMP_NUM_THREADS=1 build/release/tests/benchmarks/benchmark_image;
// docs/performance.md has the arithmetic.
#include <benchmark/benchmark.h>

#include <Eigen/Geometry>
#include <Eigen/SparseCholesky>
#include <random>

#include "imic3d/correlation/correlation.hpp"
#include "imic3d/imaging/low_pass.hpp"
#include "imic3d/imaging/pinhole.hpp"
#include "imic3d/imaging/pyramid.hpp"
#include "waves.hpp"

namespace imic3d::benchmarks {
namespace {

using correlation::Correlation;
using correlation::CorrelationOptions;
using correlation::Gradient;
using correlation::Precision;

// ---- the machine ----

/// a = b + s c on arrays far larger than the caches; bytes: two read, one read for ownership and written.
void memory_triad(benchmark::State& state) {
  constexpr std::size_t n = 24'000'000;
  std::vector<float> a(n, 1.0F), b(n, 2.0F), c(n, 3.0F);
  for (auto _ : state) {
    for (std::size_t i = 0; i < n; ++i) a[i] = b[i] + 0.5F * c[i];
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations() * 16 * n));
}
BENCHMARK(memory_triad)->Unit(benchmark::kMillisecond);

/// Sum of an array far larger than the caches: read only, as the pixel pass is.
void memory_read(benchmark::State& state) {
  constexpr Eigen::Index n = 48'000'000;
  const Eigen::ArrayXf a = Eigen::ArrayXf::Ones(n);
  for (auto _ : state) benchmark::DoNotOptimize(a.sum());
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations() * 4 * n));
}
BENCHMARK(memory_read)->Unit(benchmark::kMillisecond);

/// Single-precision multiply-adds that depend on nothing but registers [flop/s].
void arithmetic(benchmark::State& state) {
  constexpr int vectors = 12, lanes = 16;
  using Vector = Eigen::Array<float, lanes, 1>;
  Vector x[vectors];
  for (int v = 0; v < vectors; ++v) x[v].setConstant(0.1F * static_cast<float>(v));
  Vector a, b;
  a.setConstant(0.999F), b.setConstant(1e-3F);
  constexpr int turns = 1000;
  for (auto _ : state) {
    benchmark::DoNotOptimize(a);
    for (int turn = 0; turn < turns; ++turn)
      for (int v = 0; v < vectors; ++v) x[v] = x[v] * a + b;
    for (int v = 0; v < vectors; ++v) benchmark::DoNotOptimize(x[v]);
  }
  state.counters["flop/s"] =
      benchmark::Counter(2.0 * vectors * lanes * turns, benchmark::Counter::kIsIterationInvariantRate);
}
BENCHMARK(arithmetic);

// ---- images ----

constexpr int width = 2048, height = 2048;

const imaging::Image& picture() {
  static const imaging::Image made = waves(width, height);
  return made;
}
const imaging::BSpline& spline() {
  static const imaging::BSpline made(picture());
  return made;
}
void pixels(benchmark::State& state, std::size_t count) {
  state.counters["px/s"] =
      benchmark::Counter(static_cast<double>(count), benchmark::Counter::kIsIterationInvariantRate);
}

void spline_coefficients(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(imaging::BSpline(picture()).width());
  pixels(state, picture().grey.size());
}
BENCHMARK(spline_coefficients)->Unit(benchmark::kMillisecond);

void half_size(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(imaging::half_size(picture()).grey.data());
  pixels(state, picture().grey.size());
}
BENCHMARK(half_size)->Unit(benchmark::kMillisecond);

void low_pass(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(imaging::low_pass(picture(), 1.0).grey.data());
  pixels(state, picture().grey.size());
}
BENCHMARK(low_pass)->Unit(benchmark::kMillisecond);

/// Values at 1000 places anywhere in a small image: interpolation alone.
void interpolation(benchmark::State& state, bool with_slope) {
  std::mt19937 generator(1);
  std::uniform_real_distribution<double> somewhere(10.0, 200.0);
  std::vector<Eigen::Vector2d> places(1000);
  for (auto& place : places) place << somewhere(generator), somewhere(generator);
  spline();
  for (auto _ : state) {
    float sum = 0.0F;
    for (const auto& place : places)
      if (with_slope) {
        const auto sample = spline().sample(place.x(), place.y());
        sum += sample.value + sample.slope.x() + sample.slope.y();
      } else {
        sum += spline().value(place.x(), place.y());
      }
    benchmark::DoNotOptimize(sum);
  }
  pixels(state, places.size());
}
BENCHMARK_CAPTURE(interpolation, value, false);
BENCHMARK_CAPTURE(interpolation, value_and_slope, true);

// ---- the pixel pass ----

const Motion stretch{
    .slope = Eigen::Matrix2d{{0.01, 0.004}, {-0.003, -0.003}}, .shift = {2.3, -1.6}, .centre = {1024, 1024}};

Correlation sheet_of(double element, const CorrelationOptions& options = {}) {
  const int n = static_cast<int>((width - 80) / element);
  return {sheet(width, height, n, n, 40.0), one_to_one(), spline(), options};
}

/// Residual, b and element sums of one deformed image: a right-hand side. Elements of `range` pixels.
void right_hand_side(benchmark::State& state, const CorrelationOptions& options, Gradient gradient,
                     Precision precision = Precision::single) {
  const Correlation correlation = sheet_of(static_cast<double>(state.range(0)), options);
  const imaging::BSpline g(waves(width, height, stretch));
  const Eigen::VectorXd U = nodal(correlation.surface(), stretch);
  const Communicator alone{MPI_COMM_SELF};
  double rms = 0.0;
  for (auto _ : state) rms = correlation.evaluate(g, U, alone, gradient, precision).rms();
  if (!(rms < 2.0)) state.SkipWithError("the motion is not the one of the images");
  pixels(state, correlation.quadrature().pixels());
}
BENCHMARK_CAPTURE(right_hand_side, plain, {}, Gradient::reference)
    ->Arg(10)
    ->Arg(20)
    ->Arg(40)
    ->Arg(100)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(right_hand_side, full_precision, {}, Gradient::reference, Precision::full)
    ->Arg(20)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(right_hand_side, transported, {}, Gradient::transported)->Arg(20)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(right_hand_side, smoothed, {.low_pass = 1.0}, Gradient::transported)
    ->Arg(20)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(right_hand_side, brightness, {.brightness = true}, Gradient::transported)
    ->Arg(20)
    ->Unit(benchmark::kMillisecond);

/// The same through a perspective camera with distortion.
void right_hand_side_pinhole(benchmark::State& state) {
  imaging::Pose pose;
  pose.rotation = Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitY()).toRotationMatrix();
  pose.translation = {0.0, 0.0, 4000.0};
  const auto eye = std::make_shared<imaging::PinholeCamera>(
      imaging::Intrinsics{.fx = 3900.0, .fy = 3900.0, .cx = 1024.0, .cy = 1024.0, .distortion = {0.05, -0.1}}, pose);
  mesh::Mesh quads = sheet(width, height, 90, 90, 140.0);
  quads.nodes.leftCols<2>().array() -= 1024.0;
  const Correlation correlation(quads, eye, spline(), {.dofs_per_node = 3});
  const Eigen::VectorXd U = Eigen::VectorXd::LinSpaced(correlation.unknowns(), 0.5, 2.5);
  const Communicator alone{MPI_COMM_SELF};
  for (auto _ : state)
    benchmark::DoNotOptimize(correlation.evaluate(spline(), U, alone, Gradient::transported).squares);
  pixels(state, correlation.quadrature().pixels());
}
BENCHMARK(right_hand_side_pinhole)->Unit(benchmark::kMillisecond);

// ---- the operators ----

/// What is made once of a reference: local coordinates, grey levels, gradients and the sums of M.
void operators(benchmark::State& state) {
  std::size_t count = 0;
  for (auto _ : state) count = sheet_of(static_cast<double>(state.range(0))).quadrature().pixels();
  pixels(state, count);
}
BENCHMARK(operators)->Arg(20)->Unit(benchmark::kMillisecond);

void matrix(benchmark::State& state) {
  const Correlation correlation = sheet_of(static_cast<double>(state.range(0)));
  const Eigen::VectorXd U = nodal(correlation.surface(), stretch);
  for (auto _ : state) benchmark::DoNotOptimize(correlation.M(U).valuePtr());
  state.counters["unknowns"] = correlation.unknowns();
}
BENCHMARK(matrix)->Arg(12)->Arg(20)->Arg(40)->Unit(benchmark::kMillisecond);

void factorisation(benchmark::State& state) {
  const Eigen::SparseMatrix<double> M = sheet_of(static_cast<double>(state.range(0))).M();
  for (auto _ : state) benchmark::DoNotOptimize(Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>(M).info());
  state.counters["unknowns"] = static_cast<double>(M.rows());
}
BENCHMARK(factorisation)->Arg(12)->Arg(20)->Arg(40)->Unit(benchmark::kMillisecond);

void solution(benchmark::State& state) {
  const Eigen::SparseMatrix<double> M = sheet_of(static_cast<double>(state.range(0))).M();
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(M);
  const Eigen::VectorXd b = Eigen::VectorXd::Ones(M.rows());
  for (auto _ : state) {
    const Eigen::VectorXd x = factor.solve(b);
    benchmark::DoNotOptimize(x.data());
  }
  state.counters["unknowns"] = static_cast<double>(M.rows());
}
BENCHMARK(solution)->Arg(12)->Arg(20)->Arg(40)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace imic3d::benchmarks

int main(int argc, char** argv) {
  MPI_Init(&argc, &argv);
  benchmark::Initialize(&argc, argv);
  benchmark::RunSpecifiedBenchmarks();
  MPI_Finalize();
}
