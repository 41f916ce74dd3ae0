#include "imic3d/correlation/global_dic.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "imic3d/core/error.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/pyramid.hpp"

namespace imic3d::correlation {

namespace {

/// Largest strain-like change of length along an element's edge.
double largest_strain(const mesh::Mesh& surface, const Eigen::VectorXd& U) {
  double largest = 0.0;
  for (Eigen::Index e = 0; e < surface.cells.rows(); ++e)
    for (int a = 0; a < 4; ++a) {
      const int i = surface.cells(e, a), j = surface.cells(e, (a + 1) % 4);
      const Eigen::Vector2d edge = (surface.nodes.row(j) - surface.nodes.row(i)).head<2>().transpose();
      largest = std::max(largest, (U.segment<2>(2 * j) - U.segment<2>(2 * i)).norm() / edge.norm());
    }
  return largest;
}

double mean_edge(const mesh::Mesh& surface) {
  double sum = 0.0;
  for (Eigen::Index e = 0; e < surface.cells.rows(); ++e)
    for (int a = 0; a < 4; ++a)
      sum += (surface.nodes.row(surface.cells(e, (a + 1) % 4)) - surface.nodes.row(surface.cells(e, a))).norm();
  return sum / (4.0 * static_cast<double>(surface.cells.rows()));
}

/// Weight of |grad u|^2 at which it equals the optical term for waves of length `cut_off`.
double smoothing_weight(const Correlation& correlation, double cut_off) {
  const double wave = cut_off / (2.0 * M_PI);
  return correlation.optical_density() * wave * wave;
}

}  // namespace

GlobalDic::GlobalDic(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera,
                     const imaging::Image& reference, DicOptions options, const std::string& place)
    : options_(options) {
  int coarser = options_.pyramid_levels;
  if (coarser < 0)
    for (coarser = 0; std::min(reference.width, reference.height) >> (coarser + 1) >= 100;) ++coarser;
  imaging::Image image = reference;
  for (int level = 0; level <= coarser; ++level) {
    if (level > 0) image = imaging::half_size(image);
    imaging::TelecentricCamera scaled = camera;
    scaled.linear *= std::ldexp(1.0, -level);
    scaled.offset *= std::ldexp(1.0, -level);
    Level next;
    next.reference = imaging::BSpline(image);
    next.correlation = std::make_shared<Correlation>(surface, scaled, next.reference, options_.brightness, place);
    next.M = next.correlation->M();
    // Elements hold few pixels at the coarse levels: there the updates are smoothed over several elements and pixels.
    const double scale = std::sqrt(std::abs(scaled.linear.leftCols<2>().determinant()));
    const double cut_off = level == 0 ? options_.regularisation
                                      : std::max(options_.regularisation, std::max(2.0 * mean_edge(surface), 24.0 / scale));
    next.smoothing = smoothing_weight(*next.correlation, cut_off) * next.correlation->gradient_energy();
    next.factor = std::make_shared<Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>>(next.M + next.smoothing);
    if (next.factor->info() != Eigen::Success || !(next.factor->vectorD().minCoeff() > 0.0))
      throw InputError(place, "an element without enough speckle to be correlated (M_DIC is singular)",
                       "elements of several speckles, or dic.regularisation");
    levels_.push_back(std::move(next));
  }
}

void GlobalDic::solve_level(int level, const imaging::BSpline& g, const Communicator& group, DicFrame& frame) const {
  const Level& at = levels_[static_cast<std::size_t>(level)];
  const Correlation& correlation = *at.correlation;
  // Smoothing acts on the displacement itself at the finest level, on the updates at the coarser ones.
  const bool on_total = level == 0 && options_.regularisation > 0.0;
  Correlation::Gradient gradient;
  auto factor = at.factor;
  if (largest_strain(correlation.surface(), frame.displacement) > options_.large_strain) {
    gradient = correlation.deformed_gradient(frame.displacement);
    factor = std::make_shared<Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>>(correlation.M(gradient) + at.smoothing);
  }
  const Eigen::Matrix2d& scale = correlation.pixels_per_length();
  double previous = INFINITY;
  frame.converged = false;
  for (frame.iterations = 1; frame.iterations <= options_.max_iterations; ++frame.iterations) {
    const Evaluation seen = correlation.evaluate(g, frame.displacement, group, gradient);
    frame.rms = std::sqrt(seen.squares / std::max(1.0, seen.pixels));
    frame.pixels = seen.pixels;
    frame.element_rms = seen.element_rms;
    Eigen::VectorXd right = seen.b;
    if (on_total) right -= at.smoothing * frame.displacement;
    Eigen::VectorXd update = factor->solve(right);
    double largest = 0.0;
    for (Eigen::Index i = 0; i < update.size() / 2; ++i) largest = std::max(largest, (scale * update.segment<2>(2 * i)).norm());
    // A step of more than a few pixels is beyond the reach of the linearisation.
    if (largest > 4.0) update *= 4.0 / largest;
    frame.displacement += update;
    const double tolerance = level == 0 ? options_.tolerance : 0.02;
    if (largest < tolerance) {
      frame.converged = true;
      break;
    }
    if (level > 0 && frame.iterations > 8 && largest > 0.9 * previous) break;
    previous = largest;
  }
}

DicFrame GlobalDic::correlate(const imaging::Image& image, const Eigen::VectorXd& start, int coarsest, int finest,
                              const Communicator& group) const {
  DicFrame frame;
  frame.displacement = start;
  std::vector<imaging::Image> pyramid = {image};
  for (int level = 1; level <= coarsest; ++level) pyramid.push_back(imaging::half_size(pyramid.back()));
  for (int level = coarsest; level >= finest; --level)
    solve_level(level, imaging::BSpline(pyramid[static_cast<std::size_t>(level)]), group, frame);
  return frame;
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world, const std::vector<std::filesystem::path>& images,
                                     const std::function<void(int, const DicFrame&)>& frame_done) const {
  const auto count = static_cast<int>(images.size());
  const Eigen::Index unknowns = 2 * correlation().surface().nodes.rows();
  const int top = levels() - 1, split = std::min(2, top + 1);  // levels below `split` are done in parallel over frames
  const auto read = [&](int t) {
    imaging::Image image = imaging::read_image(images[static_cast<std::size_t>(t)]);
    const auto& reference = levels_.front().reference;
    if (image.width != reference.width() || image.height != reference.height())
      throw InputError(images[static_cast<std::size_t>(t)].string(), fmt::format("{} x {} pixels", image.width, image.height),
                       fmt::format("{} x {} pixels as in the reference", reference.width(), reference.height()));
    return image;
  };

  // Coarse levels: in the order of time, every rank alike; each frame starts where the motion so far leads.
  std::vector<Eigen::VectorXd> start(images.size(), Eigen::VectorXd::Zero(unknowns));
  Progress progress(world, "DIC", 2 * count);
  for (int t = 0; t < count; ++t) {
    Eigen::VectorXd guess = Eigen::VectorXd::Zero(unknowns);
    if (t > 0) guess = start[static_cast<std::size_t>(t - 1)];
    if (top >= split) {
      const auto image = read(t);
      DicFrame still = correlate(image, guess, top, split, Communicator{MPI_COMM_SELF});
      if (t > 1) {
        const Eigen::VectorXd carried = 2.0 * guess - start[static_cast<std::size_t>(t - 2)];
        DicFrame moving = correlate(image, carried, top, split, Communicator{MPI_COMM_SELF});
        if (moving.rms < still.rms) still = std::move(moving);
      }
      guess = still.displacement;
    }
    start[static_cast<std::size_t>(t)] = guess;
    progress.update(t + 1, fmt::format("frame {} of {}, coarse levels", t + 1, count));
  }

  // Finer levels: frames over groups of ranks.
  std::vector<DicFrame> frames(images.size());
  const GroupLayout layout(world, count, options_.groups);
  const bool follow = top < split;  // a small image has no coarse levels: its frames start from each other
  collectively(world, [&] {
    for (int t : layout.tasks_of_group(count)) {
      DicFrame& frame = frames[static_cast<std::size_t>(t)];
      const bool before = follow && t >= layout.groups();
      frame = correlate(read(t), before ? frames[static_cast<std::size_t>(t - layout.groups())].displacement : start[static_cast<std::size_t>(t)],
                        std::min(top, split - 1), 0, layout.group());
      progress.update(count + t + 1, fmt::format("frame {} of {}, residual {:.2f} grey levels", t + 1, count, frame.rms));
    }
  });

  const Eigen::Index elements = correlation().surface().cells.rows();
  for (int t = 0; t < count; ++t) {
    DicFrame& frame = frames[static_cast<std::size_t>(t)];
    Eigen::VectorXd all = Eigen::VectorXd::Zero(unknowns + elements + 4);
    if (t % layout.groups() == layout.index() && layout.group().is_root()) {
      all.head(unknowns) = frame.displacement;
      all.segment(unknowns, elements) = frame.element_rms;
      all.tail<4>() << frame.converged, frame.iterations, frame.rms, frame.pixels;
    }
    world.sum(std::span(all.data(), static_cast<std::size_t>(all.size())));
    frame.displacement = all.head(unknowns);
    frame.element_rms = all.segment(unknowns, elements);
    frame.converged = all[unknowns + elements] > 0.5;
    frame.iterations = static_cast<int>(all[unknowns + elements + 1]);
    frame.rms = all[unknowns + elements + 2];
    frame.pixels = all[unknowns + elements + 3];
    if (frame_done) frame_done(t, frame);
  }
  return frames;
}

Eigen::VectorXd GlobalDic::standard_deviation(double sigma, int references) const {
  const auto& factor = *levels_.front().factor;
  const Eigen::Index size = 2 * correlation().surface().nodes.rows();
  Eigen::VectorXd deviation(size), unit = Eigen::VectorXd::Zero(size);
  for (Eigen::Index i = 0; i < size; ++i) {
    unit[i] = 1.0;
    deviation[i] = factor.solve(unit)[i];
    unit[i] = 0.0;
  }
  return sigma * std::sqrt(1.0 + 1.0 / references) * deviation.cwiseMax(0.0).cwiseSqrt();
}

}  // namespace imic3d::correlation
