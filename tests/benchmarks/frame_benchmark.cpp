// One Gauss-Newton iteration of the correlation on images of a given size, part by part, and the memory that it takes; and series
// of frames of which no more than two are held. The images are made (waves.hpp), so that the error of the result is known.
//   [mpirun -n R] benchmark_frame iteration UNKNOWNS MEGAPIXELS...
//   [mpirun -n R] benchmark_frame series MEGAPIXELS FRAMES FOLDER    (writes four image files there and reads them in turn)
#include <fmt/format.h>
#include <omp.h>
#include <spdlog/spdlog.h>

#include <Eigen/SparseCholesky>
#include <chrono>
#include <fstream>
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

/// Wall time of `work` [s], the least of `times`.
template <class Work>
double seconds(int times, const Work& work) {
  double least = INFINITY;
  for (int k = 0; k < times; ++k) {
    world.barrier();
    const auto start = std::chrono::steady_clock::now();
    work();
    least = std::min(least, world.max(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()));
  }
  return least;
}

void say(const std::string& line) {
  if (world.is_root()) fmt::print("{}\n", line), std::fflush(stdout);
}

struct Size {
  int width, height, nx, ny;
};
Size size_of(double megapixels, int unknowns) {
  const int width = static_cast<int>(std::round(std::sqrt(megapixels * 1e6 * 1.25))), height = static_cast<int>(std::round(megapixels * 1e6 / width));
  const double nodes = 0.5 * unknowns;  // per row, as many pixels a node as per column
  const int nx = static_cast<int>(std::round(std::sqrt(nodes * width / height))) - 1;
  return {width, height, nx, static_cast<int>(std::round(nodes / (nx + 1))) - 1};
}
constexpr double margin = 20.0;

Motion motion_of(const Size& size, double amount) {
  return {.slope = amount * Eigen::Matrix2d{{1e-3, 4e-4}, {-3e-4, -3e-4}}, .shift = amount * Eigen::Vector2d(2.3, -1.6),
          .centre = {0.5 * size.width, 0.5 * size.height}};
}

void iteration(int unknowns, const std::vector<double>& megapixels) {
  say(fmt::format("{} rank(s), {} thread(s); times in s, the least of three", world.size(), omp_get_max_threads()));
  say(fmt::format("{:>6} {:>9} {:>9} {:>9} | {:>9} {:>9} {:>9} {:>9} {:>9} | {:>9} {:>9} {:>9} {:>10}", "Mpx", "unknowns", "spline", "operators", "M",
                  "factor", "b", "solve", "iteration", "Mpx/s of b", "error/px", "peak/GB", "bytes/px"));
  const double before = peak();
  for (const double mpx : megapixels) {
    const Size size = size_of(mpx, unknowns);
    const Motion motion = motion_of(size, 1.0);
    imaging::BSpline f, g;
    std::unique_ptr<correlation::Correlation> correlation;
    const mesh::Mesh quads = sheet(size.width, size.height, size.nx, size.ny, margin);
    double spline = 0.0, operators = 0.0;
    {
      const imaging::Image reference = waves(size.width, size.height);
      spline = seconds(1, [&] { f = imaging::BSpline(reference); });
      operators = seconds(1, [&] { correlation = std::make_unique<correlation::Correlation>(quads, one_to_one(), f); });
    }
    {
      const imaging::Image image = waves(size.width, size.height, motion);
      spline = std::min(spline, seconds(1, [&] { g = imaging::BSpline(image); }));
    }
    // From 0.2 px beside the truth.
    const Eigen::VectorXd truth = nodal(quads, motion);
    Eigen::VectorXd U = truth + 0.2 * Eigen::VectorXd::Ones(truth.size());
    correlation::Evaluation seen;
    double M_time = INFINITY, factor_time = INFINITY, b_time = INFINITY, solve_time = INFINITY;
    for (int k = 0; k < 3; ++k) {
      Eigen::SparseMatrix<double> M;
      std::unique_ptr<Factor> factor;
      Eigen::VectorXd update;
      M_time = std::min(M_time, seconds(1, [&] { M = correlation->M(U); }));
      factor_time = std::min(factor_time, seconds(1, [&] { factor = std::make_unique<Factor>(M); }));
      b_time = std::min(b_time, seconds(1, [&] { seen = correlation->evaluate(g, U, world, correlation::Gradient::transported); }));
      solve_time = std::min(solve_time, seconds(1, [&] { update = factor->solve(seen.b); }));
      U += update;
    }
    const double error = (U - truth).norm() / std::sqrt(static_cast<double>(truth.size()));
    const auto pixels = static_cast<double>(correlation->quadrature().pixels());
    say(fmt::format("{:6.1f} {:9d} {:9.3f} {:9.3f} | {:9.3f} {:9.3f} {:9.3f} {:9.3f} {:9.3f} | {:9.1f} {:9.5f} {:9.2f} {:10.1f}", mpx,
                    correlation->unknowns(), spline, operators, M_time, factor_time, b_time, solve_time, M_time + factor_time + b_time + solve_time,
                    1e-6 * pixels / b_time, error, 1e-9 * peak(), (peak() - before) / (mpx * 1e6)));
  }
}

void series(double megapixels, int frames, const std::filesystem::path& folder) {
  const Size size = size_of(megapixels, 20000);
  constexpr int files = 4;
  const auto name = [&](int k) { return folder / fmt::format("wave_{}.bmp", k); };
  if (world.is_root())
    for (int k = 0; k < files; ++k) imaging::write_image(waves(size.width, size.height, motion_of(size, 0.4 * k)), name(k));
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
  (void)dic.run(world, frames, [&](int frame) { return imaging::read_image(name(frame % files)); }, done);
  const auto end = std::chrono::steady_clock::now();
  say(fmt::format("{} frames of {:.1f} megapixels, {} unknowns, {} rank(s), {} thread(s): as floats the series takes {:.2f} GB", frames, megapixels,
                  dic.cameras().unknowns(), world.size(), omp_get_max_threads(), 4e-9 * frames * megapixels * 1e6));
  say(fmt::format("operators {:.2f} s, frames {:.2f} s each, largest rms error of a frame {:.5f} px",
                  std::chrono::duration<double>(built - start).count(), std::chrono::duration<double>(end - built).count() / frames, worst));
  say(fmt::format("peak of a rank {:.2f} GB, {:.1f} bytes/px; of that until the operators stand {:.1f} bytes/px", 1e-9 * world.max(peak()),
                  world.max(peak()) / (megapixels * 1e6), of_operators / (megapixels * 1e6)));
  world.barrier();
  if (world.is_root())
    for (int k = 0; k < files; ++k) std::filesystem::remove(name(k));
}

int run(const std::vector<std::string>& words) {
  if (words.size() >= 3 && words[0] == "iteration") {
    std::vector<double> megapixels;
    for (std::size_t k = 2; k < words.size(); ++k) megapixels.push_back(std::stod(words[k]));
    iteration(std::stoi(words[1]), megapixels);
  } else if (words.size() == 4 && words[0] == "series") {
    series(std::stod(words[1]), std::stoi(words[2]), words[3]);
  } else {
    say("benchmark_frame iteration UNKNOWNS MEGAPIXELS... | series MEGAPIXELS FRAMES FOLDER");
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
