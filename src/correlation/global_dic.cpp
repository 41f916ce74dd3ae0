#include "imic3d/correlation/global_dic.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "imic3d/core/error.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/correlation/covariance.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/imaging/pyramid.hpp"
#include "patch_search.hpp"

namespace imic3d::correlation {
namespace {

constexpr int parallel_levels = 2;  // the finest levels, which run over the frames side by side

/// A camera as seen in an image of which every pixel (x, y) lies at (factor x, factor y) of its own.
class ReducedCamera final : public imaging::Camera {
 public:
  ReducedCamera(std::shared_ptr<const imaging::Camera> camera, double factor)
      : camera_(std::move(camera)), factor_(factor) {}
  [[nodiscard]] Eigen::Vector2d project(const Eigen::Vector3d& point) const override {
    return camera_->project(point) / factor_;
  }
  [[nodiscard]] Eigen::Matrix<double, 2, 3> jacobian(const Eigen::Vector3d& point) const override {
    return camera_->jacobian(point) / factor_;
  }

 private:
  std::shared_ptr<const imaging::Camera> camera_;
  double factor_;
};

double mean_edge(const mesh::Mesh& surface) {
  double sum = 0.0;
  for (Eigen::Index e = 0; e < surface.cells.rows(); ++e)
    for (int a = 0; a < 4; ++a)
      sum += (surface.nodes.row(surface.cells(e, (a + 1) % 4)) - surface.nodes.row(surface.cells(e, a))).norm();
  return sum / (4.0 * static_cast<double>(surface.cells.rows()));
}

double largest_change(const std::vector<Eigen::Matrix2d>& a, const std::vector<Eigen::Matrix2d>& b) {
  double largest = 0.0;
  for (std::size_t e = 0; e < a.size(); ++e) largest = std::max(largest, (a[e] - b[e]).cwiseAbs().maxCoeff());
  return largest;
}

imaging::Image every_second(const imaging::Image& mask) {
  imaging::Image half((mask.width + 1) / 2, (mask.height + 1) / 2, mask.depth);
  for (int y = 0; y < half.height; ++y)
    for (int x = 0; x < half.width; ++x) half(x, y) = mask(2 * x, 2 * y);
  return half;
}

imaging::Image reduced(imaging::Image image, int times) {
  for (int k = 0; k < times; ++k) image = imaging::half_size(image);
  return image;
}

}  // namespace

GlobalDic::GlobalDic(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera,
                     const imaging::Image& reference, DicOptions options, const std::string& place)
    : GlobalDic(surface, std::make_shared<imaging::TelecentricCamera>(camera), reference, options, place) {}

GlobalDic::GlobalDic(const mesh::Mesh& surface, std::shared_ptr<const imaging::Camera> camera,
                     const imaging::Image& reference, DicOptions options, const std::string& place)
    : options_(options), noise_(imaging::noise_response(options.low_pass)) {
  imaging::Image image = reference;
  imaging::Image mask = options_.mask != nullptr ? *options_.mask : imaging::Image{};
  const bool masked = options_.mask != nullptr;
  options_.mask = nullptr;  // not needed any longer, and not owned
  int coarser = options_.pyramid_levels;
  const Eigen::SparseMatrix<double> energy = curvature_energy(surface, in_plane);
  for (int level = 0; coarser < 0 || level <= coarser; ++level) {
    if (level > 0) image = imaging::half_size(image);
    const double factor = std::ldexp(1.0, level);
    Level next;
    next.reference = level == 0 ? spline(image) : imaging::BSpline(image);
    CorrelationOptions operators{
        .brightness = options_.brightness, .local_brightness = options_.local_brightness, .quadrature = {.place = place}};
    if (level == 0) operators.slope_noise = noise_.slope;
    if (level > 0 && masked) mask = every_second(mask);
    if (masked) operators.quadrature.mask = &mask;
    if (level == 0) operators.quadrature.border = options_.border, operators.quadrature.cut_nodes = options_.cut_nodes;
    operators.quadrature.clip = level > 0;  // half a pixel of a coarse image may stick out
    next.correlation = std::make_shared<Correlation>(surface, std::make_shared<ReducedCamera>(camera, factor),
                                                     next.reference, operators);
    const Correlation& correlation = *next.correlation;
    if (coarser < 0) {
      const Eigen::Vector2d extent =
          (correlation.positions().colwise().maxCoeff() - correlation.positions().colwise().minCoeff()).transpose();
      coarser = std::clamp(static_cast<int>(std::floor(std::log2(extent.minCoeff() / 50.0))), 0, 6);
    }
    const double scale = std::sqrt(std::abs(correlation.pixels_per_length().determinant()));  // [px/length]
    double cut_off = options_.regularisation;
    if (level > 0) cut_off = std::max({cut_off, 2.0 * mean_edge(surface), 24.0 / scale});
    next.smoothing = smoothing_weight(correlation, cut_off) * energy;
    next.factor = std::make_shared<Factor>(correlation.M() + next.smoothing);
    require_speckle(next, place);
    levels_.push_back(std::move(next));
  }
  if (options_.low_pass > 0.0) {
    const PixelQuadrature& pixels = correlation().quadrature();
    double once = 0.0, twice = 0.0;
    for (const auto* slopes : {&pixels.fx, &pixels.fy}) {
      imaging::Image slope(reference.width, reference.height);
      std::size_t p = 0;
      for (const PixelRow& row : pixels.rows)
        for (int i = 0; i < row.count; ++i) slope(row.column + i, row.row) = (*slopes)[p++];
      for (const float value : slope.grey) once += static_cast<double>(value) * value;
      for (const float value : imaging::low_pass(slope, options_.low_pass).grey) twice += static_cast<double>(value) * value;
    }
    motion_noise_ = std::sqrt(twice / once);
  }
}

imaging::BSpline GlobalDic::spline(const imaging::Image& image) const {
  return imaging::BSpline(imaging::low_pass(image, options_.low_pass));
}

void GlobalDic::require_speckle(const Level& level, const std::string& place) const {
  const Eigen::VectorXd pivots = level.factor->vectorD();
  if (level.factor->info() == Eigen::Success && pivots.minCoeff() > 1e-10 * pivots.maxCoeff()) return;
  int empty = 0;
  for (int e = 0; e < level.correlation->elements(); ++e) empty += level.correlation->quadrature().pixels_of(e) < 8;
  throw InputError(place,
                   fmt::format("too little speckle to correlate every node (M_DIC is singular; {} of {} elements have "
                               "fewer than 8 pixels)",
                               empty, level.correlation->elements()),
                   "elements that cover several speckles each, or dic.regularisation");
}

// Gauss-Newton on one level: M dU = b (Eq. 7 for alpha = 1).
void GlobalDic::solve_level(int level, const imaging::BSpline& g, const Communicator& group, DicFrame& frame) const {
  const Level& at = levels_[static_cast<std::size_t>(level)];
  const Correlation& correlation = *at.correlation;
  const bool finest = level == 0;
  const double tolerance = finest ? options_.tolerance : std::max(options_.tolerance, 0.02);
  const int iterations = finest ? options_.max_iterations : 40;
  constexpr double longest_step = 2.0;  // [px]; beyond the reach of the linearisation
  // Coarse levels smooth the change from the start; the finest one the displacement itself, if the user asks.
  const Eigen::VectorXd start = finest ? Eigen::VectorXd::Zero(correlation.unknowns()) : frame.displacement;
  std::vector<Eigen::Matrix2d> F_of_M(static_cast<std::size_t>(correlation.elements()), Eigen::Matrix2d::Identity());
  std::shared_ptr<Factor> factor = at.factor;
  double previous = INFINITY;
  frame.converged = false;
  frame.iterations = 0;
  while (true) {
    const Evaluation seen = correlation.evaluate(g, frame.displacement, group, Gradient::transported);
    frame.rms = seen.rms(), frame.coefficient = seen.coefficient;
    frame.pixels = seen.pixels, frame.dropped = seen.dropped;
    frame.gain = seen.gain, frame.offset = seen.offset;
    frame.element_rms = seen.element_rms;
    if (frame.converged || frame.iterations == iterations || seen.pixels == 0.0) break;
    auto F = correlation.deformation_gradient(frame.displacement);
    if (largest_change(F, F_of_M) > options_.strain_change) {
      factor = std::make_shared<Factor>(correlation.M(frame.displacement) + at.smoothing);
      F_of_M = std::move(F);
      if (factor->info() != Eigen::Success) break;
    }
    Eigen::VectorXd update = factor->solve(seen.b - at.smoothing * (frame.displacement - start));
    const InImage step = correlation.pixel_displacement(frame.displacement + update) -
                         correlation.pixel_displacement(frame.displacement);
    double largest = step.rowwise().norm().maxCoeff();
    if (group.size() > 1) group.broadcast(std::span(&largest, 1));  // every rank decides alike
    if (!std::isfinite(largest)) break;
    const int dofs = correlation.dofs_per_node();
    for (int node = 0; node < correlation.nodes(); ++node)
      if (const double length = step.row(node).norm(); length > longest_step)
        update.segment(static_cast<Eigen::Index>(node) * dofs, dofs) *= longest_step / length;
    frame.displacement += update;
    ++frame.iterations;
    frame.converged = largest < tolerance;
    // A coarse level that no longer gains has done its work.
    if (!finest && frame.iterations > 8 && largest > 0.9 * previous && largest < 0.5) frame.converged = true;
    previous = largest;
  }
  frame.lost = frame.coefficient < options_.lost || frame.pixels < 0.5 * (frame.pixels + frame.dropped);
}

DicFrame GlobalDic::correlate(const imaging::Image& image, const Eigen::VectorXd& start, int coarsest, int finest,
                              const Communicator& group) const {
  DicFrame frame;
  frame.displacement = start;
  std::vector<imaging::Image> pyramid = {image};
  for (int level = 1; level <= coarsest; ++level) pyramid.push_back(imaging::half_size(pyramid.back()));
  for (int level = coarsest; level >= finest; --level)
    solve_level(level,
                level == 0 ? spline(pyramid.front()) : imaging::BSpline(pyramid[static_cast<std::size_t>(level)]), group,
                frame);
  return frame;
}

// The next frame of a series on the coarse levels, down to `finest`, of which `coarse` is the image; `before` are the
// displacements of the frames before it.
DicFrame GlobalDic::follow(const imaging::Image& coarse, const std::vector<Eigen::VectorXd>& before, int finest) const {
  const Communicator alone{MPI_COMM_SELF};
  const int top = levels() - 1;
  const Level& coarsest = levels_.back();
  std::vector<imaging::Image> pyramid = {coarse};
  for (int level = finest + 1; level <= top; ++level) pyramid.push_back(imaging::half_size(pyramid.back()));
  std::vector<imaging::BSpline> splines;
  for (int level = finest; level <= top; ++level) {
    const imaging::Image& image = pyramid[static_cast<std::size_t>(level - finest)];
    splines.push_back(level == 0 ? spline(image) : imaging::BSpline(image));
  }

  // Start where the motion so far leads, or where the last frame was, whichever matches better.
  std::vector<Eigen::VectorXd> starts;
  if (before.empty()) starts.push_back(Eigen::VectorXd::Zero(coarsest.correlation->unknowns()));
  if (!before.empty()) starts.push_back(before.back());
  if (before.size() > 1) starts.push_back(2.0 * before.back() - before[before.size() - 2]);
  const auto match = [&](const Eigen::VectorXd& U) {
    const Evaluation seen = coarsest.correlation->evaluate(splines.back(), U, alone);
    return seen.coefficient * seen.pixels / std::max(1.0, seen.pixels + seen.dropped);
  };
  const Eigen::VectorXd start = *std::max_element(starts.begin(), starts.end(),
                                                  [&](const auto& a, const auto& b) { return match(a) < match(b); });
  DicFrame frame;
  frame.displacement = start;
  solve_level(top, splines.back(), alone, frame);
  // Not a clear match: look for patches everywhere, first those deformed like the last frame.
  constexpr double clear = 0.8;
  if (frame.coefficient < clear || frame.lost) {
    for (const Eigen::VectorXd& from : {start, Eigen::VectorXd(Eigen::VectorXd::Zero(start.size()))}) {
      const double reach = 0.5 * std::max(coarse.width, coarse.height) / std::ldexp(1.0, top - finest);
      const auto found = search_patches(*coarsest.correlation, coarsest.reference, pyramid.back(), from, reach);
      if (!found) continue;
      DicFrame other;
      other.displacement = *found;
      solve_level(top, splines.back(), alone, other);
      if (other.coefficient > frame.coefficient + 0.02) frame = std::move(other);
      if (frame.coefficient > clear) break;
    }
  }
  for (int level = top - 1; level >= finest; --level)
    solve_level(level, splines[static_cast<std::size_t>(level - finest)], alone, frame);
  return frame;
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world, const std::vector<std::filesystem::path>& images,
                                     const Done& done) const {
  const auto read = [&](int frame) { return imaging::read_image(images[static_cast<std::size_t>(frame)]); };
  return run(world, static_cast<int>(images.size()), read, done);
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world, int frames, const Source& source,
                                     const Done& done) const {
  const int split = std::min(parallel_levels, levels() - 1);  // the finest of the coarse levels
  const Eigen::Index unknowns = correlation().unknowns(), elements = correlation().elements();
  const auto read = [&](int frame) {
    imaging::Image image = source(frame);
    const imaging::BSpline& reference = levels_.front().reference;
    if (image.width != reference.width() || image.height != reference.height())
      throw InputError(image.path.empty() ? fmt::format("frame {}", frame) : image.path.string(),
                       fmt::format("{} x {} pixels", image.width, image.height),
                       fmt::format("{} x {} pixels like the reference image", reference.width(), reference.height()));
    return image;
  };
  Progress progress(world, "DIC", 2 * frames);

  // Coarse levels in the order of time. Each rank reads and reduces one frame of a batch; all then follow the motion
  // alike, which is cheap and needs no message.
  std::vector<Eigen::VectorXd> starts, trusted;
  const imaging::BSpline& reduced_reference = levels_[static_cast<std::size_t>(split)].reference;
  for (int first = 0; first < frames; first += world.size()) {
    imaging::Image mine(reduced_reference.width(), reduced_reference.height());
    collectively(world, [&] {
      if (first + world.rank() < frames) mine = reduced(read(first + world.rank()), split);
    });
    for (int frame = first; frame < std::min(frames, first + world.size()); ++frame) {
      imaging::Image coarse = frame - first == world.rank() ? mine : imaging::Image(mine.width, mine.height);
      MPI_Bcast(coarse.grey.data(), static_cast<int>(coarse.grey.size()), MPI_FLOAT, frame - first, world.handle);
      const DicFrame followed = follow(coarse, trusted, split);
      starts.push_back(followed.displacement);
      if (!followed.lost) trusted.push_back(followed.displacement);
      progress.update(frame + 1, fmt::format("coarse levels, frame {} of {}", frame + 1, frames));
    }
  }

  // Finer levels: frames over groups of ranks.
  std::vector<DicFrame> results(static_cast<std::size_t>(frames));
  const GroupLayout layout(world, frames, options_.groups);
  collectively(world, [&] {
    for (const int frame : layout.tasks_of_group(frames)) {
      imaging::Image image;
      collectively(layout.group(), [&] { image = read(frame); });
      DicFrame& result = results[static_cast<std::size_t>(frame)];
      result = correlate(image, starts[static_cast<std::size_t>(frame)], std::max(0, split - 1), 0, layout.group());
      progress.update(frames + frame + 1,
                      fmt::format("frame {} of {}, residual {:.2f} grey levels", frame + 1, frames, result.rms));
    }
  });

  for (int frame = 0; frame < frames; ++frame) {
    DicFrame& result = results[static_cast<std::size_t>(frame)];
    std::vector<double> message(static_cast<std::size_t>(unknowns + elements + 9), 0.0);
    Eigen::Map<Eigen::VectorXd> all(message.data(), unknowns + elements + 9);
    if (frame % layout.groups() == layout.index() && layout.group().is_root()) {
      all.head(unknowns) = result.displacement;
      all.segment(unknowns, elements) = result.element_rms;
      all.tail<9>() << result.converged, result.lost, result.iterations, result.rms, result.coefficient, result.pixels,
          result.dropped, result.gain, result.offset;
    }
    world.sum(message);
    result.displacement = all.head(unknowns);
    result.element_rms = all.segment(unknowns, elements);
    const double* const values = message.data() + unknowns + elements;
    result.converged = values[0] > 0.5;
    result.lost = values[1] > 0.5;
    result.iterations = static_cast<int>(values[2]);
    result.rms = values[3], result.coefficient = values[4];
    result.pixels = values[5], result.dropped = values[6];
    result.gain = values[7], result.offset = values[8];
    if (done) done(frame, result);
  }
  return results;
}

Eigen::VectorXd GlobalDic::standard_deviation(double sigma, int references) const {
  const Level& finest = levels_.front();
  const double factor = std::pow(sigma * motion_noise_, 2) * (1.0 + 1.0 / references);
  if (options_.regularisation <= 0.0) {
    // diag(T^-1 M T^-1) = diag(T^-1) + diag(T^-1 V T^-1), the latter as the derivative of (T - h V)^-1 in h.
    const Eigen::SparseMatrix<double> V = sigma * sigma / references * finest.correlation->gradient_noise();
    const Eigen::SparseMatrix<double> T = finest.correlation->M() - V;
    constexpr double h = 0.01;
    const Factor tangent(T), less(T - h * V), more(T + h * V);
    if (less.info() == Eigen::Success && less.vectorD().minCoeff() > 0.0) {
      const Eigen::VectorXd slope = (diagonal_of_inverse(less) - diagonal_of_inverse(more)) / (2.0 * h);
      return (factor * (diagonal_of_inverse(tangent) + slope)).cwiseMax(0.0).cwiseSqrt();
    }
    spdlog::warn(
        "the noise is as strong as the speckle in parts of the reference: the displacement's standard deviation is "
        "underestimated");
    return (factor * diagonal_of_inverse(*finest.factor)).cwiseMax(0.0).cwiseSqrt();
  }
  const Eigen::SparseMatrix<double> M = finest.correlation->M();
  Eigen::VectorXd variance(M.cols());
#pragma omp parallel for schedule(static)
  for (Eigen::Index i = 0; i < M.cols(); ++i) {
    const Eigen::VectorXd column = finest.factor->solve(Eigen::VectorXd::Unit(M.cols(), i));
    variance[i] = column.dot(M * column);
  }
  return (factor * variance).cwiseMax(0.0).cwiseSqrt();
}

}  // namespace imic3d::correlation
