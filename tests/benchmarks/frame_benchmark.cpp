// One Gauss-Newton iteration of the correlation on images of a given size, part by part, and the memory that it takes;
// and series of frames of which no more than two are held. The images are made (waves.hpp), so that the error of the
// result is known.
//   [mpirun -n R] benchmark_frame iteration UNKNOWNS MEGAPIXELS...
//   benchmark_frame threads MEGAPIXELS REPEATS                       (one thread against two, in turn)
//   [mpirun -n R] benchmark_frame series UNKNOWNS MEGAPIXELS FRAMES FOLDER    (writes four image files there and reads
//   them in turn)
#include <fmt/format.h>
#include <omp.h>
#include <spdlog/spdlog.h>

#include <Eigen/SparseCholesky>
#include <chrono>
#include <ctime>
#include <fstream>
#include <functional>
#include <string>

#include "imic3d/correlation/global_dic.hpp"
#include "waves.hpp"

namespace imic3d::benchmarks {
namespace {

using Factor = Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>;
const Communicator world;

/// Largest memory of this process so far [bytes].
double peak() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with("VmHWM:")) return 1024.0 * std::stod(line.substr(6));
  return NAN;
}

/// Wall time of `work` and the processor's time of a rank's threads together [s], of the rank that takes longest.
struct Time {
  double wall = INFINITY, cpu = INFINITY;
  void least(const Time& other) { wall = std::min(wall, other.wall), cpu = std::min(cpu, other.cpu); }
  Time operator+(const Time& other) const { return {wall + other.wall, cpu + other.cpu}; }
};
template <class Work>
Time seconds(const Work& work) {
  world.barrier();
  const auto start = std::chrono::steady_clock::now();
  const std::clock_t clock = std::clock();
  work();
  const double cpu = static_cast<double>(std::clock() - clock) / CLOCKS_PER_SEC;
  return {world.max(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()), world.max(cpu)};
}

void say(const std::string& line) {
  if (world.is_root()) fmt::print("{}\n", line), std::fflush(stdout);
}

struct Size {
  int width, height, nx, ny;
};
Size size_of(double megapixels, int unknowns) {
  const int width = static_cast<int>(std::round(std::sqrt(megapixels * 1e6 * 1.25))),
            height = static_cast<int>(std::round(megapixels * 1e6 / width));
  const double nodes = 0.5 * unknowns;  // per row, as many pixels a node as per column
  const int nx = static_cast<int>(std::round(std::sqrt(nodes * width / height))) - 1;
  return {width, height, nx, static_cast<int>(std::round(nodes / (nx + 1))) - 1};
}
constexpr double margin = 20.0;

Motion motion_of(const Size& size, double amount) {
  return {.slope = amount * Eigen::Matrix2d{{1e-3, 4e-4}, {-3e-4, -3e-4}},
          .shift = amount * Eigen::Vector2d(2.3, -1.6),
          .centre = {0.5 * size.width, 0.5 * size.height}};
}

void iteration(int unknowns, const std::vector<double>& megapixels) {
  say(fmt::format(
      "{} rank(s), {} thread(s); the least of three times in s: wall, and of the processor for all threads of a rank",
      world.size(), omp_get_max_threads()));
  const auto row = [](const auto&... values) {
    std::string line;
    ((line += fmt::format(" {:>10}", values)), ...);
    say(line);
  };
  row("Mpx", "unknowns", "", "spline", "operators", "M", "factor", "b", "solve", "iteration", "error/px", "peak/GB",
      "bytes/px");
  const double before = peak();
  for (const double mpx : megapixels) {
    const Size size = size_of(mpx, unknowns);
    const Motion motion = motion_of(size, 1.0);
    imaging::BSpline f, g;
    std::unique_ptr<correlation::Correlation> operators_of_f;
    const mesh::Mesh quads = sheet(size.width, size.height, size.nx, size.ny, margin);
    Time spline, operators;
    {
      const imaging::Image reference = waves(size.width, size.height);
      spline.least(seconds([&] { f = imaging::BSpline(reference); }));
      operators.least(
          seconds([&] { operators_of_f = std::make_unique<correlation::Correlation>(quads, one_to_one(), f); }));
    }
    {
      const imaging::Image image = waves(size.width, size.height, motion);
      spline.least(seconds([&] { g = imaging::BSpline(image); }));
    }
    // From 0.2 px beside the truth.
    const Eigen::VectorXd truth = nodal(quads, motion);
    Eigen::VectorXd U = truth + 0.2 * Eigen::VectorXd::Ones(truth.size());
    correlation::Evaluation seen;
    Time of_M, of_factor, of_b, of_solve;
    for (int k = 0; k < 3; ++k) {
      Eigen::SparseMatrix<double> M;
      std::unique_ptr<Factor> factor;
      Eigen::VectorXd update;
      of_M.least(seconds([&] { M = operators_of_f->M(U); }));
      of_factor.least(seconds([&] { factor = std::make_unique<Factor>(M); }));
      of_b.least(seconds([&] { seen = operators_of_f->evaluate(g, U, world, correlation::Gradient::transported); }));
      of_solve.least(seconds([&] { update = factor->solve(seen.b); }));
      U += update;
    }
    const double error = (U - truth).norm() / std::sqrt(static_cast<double>(truth.size()));
    const Time all = of_M + of_factor + of_b + of_solve;
    const auto shown = [](double value) { return fmt::format("{:.3f}", value); };
    row(shown(mpx), operators_of_f->unknowns(), "wall", shown(spline.wall), shown(operators.wall), shown(of_M.wall),
        shown(of_factor.wall), shown(of_b.wall), shown(of_solve.wall), shown(all.wall), fmt::format("{:.5f}", error),
        shown(1e-9 * peak()), shown((peak() - before) / (mpx * 1e6)));
    row("", "", "processor", shown(spline.cpu), shown(operators.cpu), shown(of_M.cpu), shown(of_factor.cpu),
        shown(of_b.cpu), shown(of_solve.cpu), shown(all.cpu), "", "", "");
  }
}

/// Least wall times with one thread and with two, measured in turn: what else runs on the machine disturbs both alike.
void threads(double megapixels, int repeats) {
  const Size size = size_of(megapixels, static_cast<int>(5000 * megapixels));
  const Motion motion = motion_of(size, 1.0);
  const imaging::Image image = waves(size.width, size.height, motion);
  const imaging::BSpline f(waves(size.width, size.height)), g(image);
  const mesh::Mesh quads = sheet(size.width, size.height, size.nx, size.ny, margin);
  const correlation::Correlation dic(quads, one_to_one(), f);
  const Eigen::VectorXd U = nodal(quads, motion), b = dic.evaluate(g, U, world).b;
  const Eigen::SparseMatrix<double> M = dic.M(U);
  const Factor factor(M);
  Eigen::VectorXd x;
  const std::vector<std::pair<const char*, std::function<void()>>> parts{
      {"b", [&] { (void)dic.evaluate(g, U, world, correlation::Gradient::transported); }},
      {"spline", [&] { (void)imaging::BSpline(image).width(); }},
      {"operators", [&] { (void)correlation::Correlation(quads, one_to_one(), f).unknowns(); }},
      {"M", [&] { (void)dic.M(U).nonZeros(); }},
      {"factor", [&] { (void)Factor(M).info(); }},
      {"solve", [&] { x = factor.solve(b); }}};
  say(fmt::format("{:.1f} megapixels, {} unknowns, least of {} times [ms]: 1 thread, 2 threads, ratio", megapixels,
                  M.rows(), repeats));
  for (const auto& [name, work] : parts) {
    double one = INFINITY, two = INFINITY;
    for (int k = 0; k < repeats; ++k) {
      omp_set_num_threads(1), one = std::min(one, seconds(work).wall);
      omp_set_num_threads(2), two = std::min(two, seconds(work).wall);
    }
    say(fmt::format("{:>10} {:9.2f} {:9.2f} {:6.2f}", name, 1e3 * one, 1e3 * two, one / two));
  }
}

void series(int unknowns, double megapixels, int frames, const std::filesystem::path& folder) {
  const Size size = size_of(megapixels, unknowns);
  constexpr int files = 4;
  const auto name = [&](int k) { return folder / fmt::format("wave_{}.bmp", k); };
  if (world.is_root())
    for (int k = 0; k < files; ++k)
      imaging::write_image(waves(size.width, size.height, motion_of(size, 0.4 * k)), name(k));
  world.barrier();
  const mesh::Mesh quads = sheet(size.width, size.height, size.nx, size.ny, margin);
  const auto start = std::chrono::steady_clock::now();
  auto reference = std::make_unique<imaging::Image>(imaging::read_image(name(0)));
  const correlation::GlobalDic dic(quads, *one_to_one(), *reference, {.low_pass = 1.0, .border = 3.0}, "mesh");
  reference.reset();
  const auto built = std::chrono::steady_clock::now();
  const double of_operators = peak();
  double worst = 0.0;
  const auto done = [&](int frame, const correlation::DicFrame& result) {
    const Eigen::VectorXd truth = nodal(quads, motion_of(size, 0.4 * (frame % files)));
    worst = std::max(worst, (result.displacement - truth).norm() / std::sqrt(static_cast<double>(truth.size())));
  };
  (void)dic.run(
      world, frames, [&](int frame) { return imaging::read_image(name(frame % files)); }, done);
  const auto end = std::chrono::steady_clock::now();
  say(fmt::format(
      "{} frames of {:.1f} megapixels, {} unknowns, {} rank(s), {} thread(s): as floats the series takes {:.2f} GB",
      frames, megapixels, dic.cameras().unknowns(), world.size(), omp_get_max_threads(),
      4e-9 * frames * megapixels * 1e6));
  say(fmt::format("operators {:.2f} s, frames {:.2f} s each, largest rms error of a frame {:.5f} px",
                  std::chrono::duration<double>(built - start).count(),
                  std::chrono::duration<double>(end - built).count() / frames, worst));
  say(fmt::format("peak of a rank {:.2f} GB, {:.1f} bytes/px; of that until the operators stand {:.1f} bytes/px",
                  1e-9 * world.max(peak()), world.max(peak()) / (megapixels * 1e6), of_operators / (megapixels * 1e6)));
  world.barrier();
  if (world.is_root())
    for (int k = 0; k < files; ++k) std::filesystem::remove(name(k));
}

int run(const std::vector<std::string>& words) {
  if (words.size() >= 3 && words[0] == "iteration") {
    std::vector<double> megapixels;
    for (std::size_t k = 2; k < words.size(); ++k) megapixels.push_back(std::stod(words[k]));
    iteration(std::stoi(words[1]), megapixels);
  } else if (words.size() == 3 && words[0] == "threads") {
    threads(std::stod(words[1]), std::stoi(words[2]));
  } else if (words.size() == 5 && words[0] == "series") {
    series(std::stoi(words[1]), std::stod(words[2]), std::stoi(words[3]), words[4]);
  } else {
    say("benchmark_frame iteration UNKNOWNS MEGAPIXELS... | threads MEGAPIXELS REPEATS | series UNKNOWNS MEGAPIXELS "
        "FRAMES FOLDER");
    return 2;
  }
  return 0;
}

}  // namespace
}  // namespace imic3d::benchmarks

int main(int argc, char** argv) {
  MPI_Init(&argc, &argv);
  spdlog::set_level(spdlog::level::warn);
  const int status = imic3d::benchmarks::run({argv + 1, argv + argc});
  MPI_Finalize();
  return status;
}
