#include "imic3d/correlation/global_dic.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "imic3d/core/error.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/correlation/covariance.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/imaging/pyramid.hpp"

namespace imic3d::correlation {
namespace {

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
  [[nodiscard]] bool affine() const override { return camera_->affine(); }

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

/// Nodes that white noise moves by more than ten times what it moves the median node. `variance`: of the unknowns
/// [nodes * dofs].
std::vector<int> noisy_nodes(const Eigen::VectorXd& variance, int dofs) {
  constexpr double much = 10.0;
  const Eigen::VectorXd of_node = variance.reshaped(dofs, variance.size() / dofs).colwise().sum();
  const double middle = median(Eigen::VectorXd(of_node));
  std::vector<int> nodes;
  for (Eigen::Index node = 0; node < of_node.size(); ++node)
    if (of_node[node] > much * much * middle) nodes.push_back(static_cast<int>(node));
  return nodes;
}

imaging::Image every_second(const imaging::Image& mask) {
  imaging::Image half((mask.width + 1) / 2, (mask.height + 1) / 2, mask.depth);
  for (int y = 0; y < half.height; ++y)
    for (int x = 0; x < half.width; ++x) half(x, y) = mask(2 * x, 2 * y);
  return half;
}

}  // namespace

GlobalDic::GlobalDic(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera,
                     const imaging::Image& reference, DicOptions options, const std::string& place)
    : GlobalDic(surface, std::make_shared<imaging::TelecentricCamera>(camera), reference, options, place) {}

GlobalDic::GlobalDic(const mesh::Mesh& surface, std::shared_ptr<const imaging::Camera> camera,
                     const imaging::Image& reference, DicOptions options, const std::string& place)
    : options_(std::move(options)), noise_(imaging::noise_response(options_.low_pass)) {
  std::vector<View> views(1);
  views[0].camera = std::move(camera), views[0].reference = reference, views[0].place = place;
  build(surface, std::move(views), in_plane);
}

GlobalDic::GlobalDic(const mesh::Mesh& surface, std::vector<View> views, int dofs_per_node, DicOptions options)
    : options_(std::move(options)), noise_(imaging::noise_response(options_.low_pass)) {
  if (views.empty()) throw InputError("cameras", "none", "at least one");
  if (options_.mask != nullptr && views.size() > 1)
    throw InputError("mask", "a mask with several cameras", "one camera");
  if (views.size() == 1 && dofs_per_node == 3)
    throw InputError("cameras", "one camera for three components of the displacement",
                     "two cameras at least: one does not see motion along its line of sight");
  build(surface, std::move(views), dofs_per_node);
}

void GlobalDic::build(const mesh::Mesh& surface, std::vector<View> views, int dofs_per_node) {
  const bool several = views.size() > 1;
  std::vector<imaging::Image> images(views.size());  // of the level, from the second on
  std::vector<double> noise;
  for (const View& view : views) noise.push_back(view.noise);
  if (std::any_of(noise.begin(), noise.end(), [](double sigma) { return !(sigma > 0.0); })) noise.clear();
  imaging::Image mask = options_.mask != nullptr ? *options_.mask : imaging::Image{};
  const bool masked = options_.mask != nullptr;
  options_.mask = nullptr;  // not needed any longer, and not owned
  int coarser = options_.pyramid_levels;
  const Eigen::SparseMatrix<double> energy = curvature_energy(surface, dofs_per_node);
  for (int level = 0; coarser < 0 || level <= coarser; ++level) {
    const double factor = std::ldexp(1.0, level);
    Level next;
    std::vector<std::shared_ptr<const Correlation>> correlations;
    if (level > 0 && masked) mask = every_second(mask);
    double shortest = INFINITY;  // side of the mesh in any image [px]
    for (std::size_t c = 0; c < views.size(); ++c) {
      if (level > 0) images[c] = imaging::half_size(level == 1 ? views[c].reference : images[c]);
      if (level == 1) views[c].reference = {};
      next.references.push_back(level == 0 ? spline(views[c].reference) : imaging::BSpline(images[c]));
      const imaging::ImageHeader size{next.references.back().width(), next.references.back().height(), 0};
      next.sizes.push_back(size);
      CorrelationOptions operators{.dofs_per_node = dofs_per_node,
                                   .brightness = options_.brightness,
                                   .local_brightness = options_.local_brightness,
                                   .quadrature = {.left_out = options_.left_out, .place = views[c].place}};
      if (level == 0) operators.slope_noise = noise_.slope, operators.low_pass = options_.low_pass;
      if (masked) operators.quadrature.mask = &mask;
      if (level == 0)
        operators.quadrature.border = options_.border, operators.quadrature.cut_nodes = options_.cut_nodes;
      operators.quadrature.clip = several || level > 0;  // half a pixel of a coarse image may stick out
      auto correlation = std::make_shared<Correlation>(
          surface, std::make_shared<ReducedCamera>(views[c].camera, factor), next.references.back(), operators);
      const InImage& positions = correlation->positions();
      const Eigen::Vector2d extent = (positions.colwise().maxCoeff() - positions.colwise().minCoeff()).transpose();
      shortest = std::min(
          {shortest, extent.minCoeff(), several ? static_cast<double>(std::min(size.width, size.height)) : INFINITY});
      correlations.push_back(std::move(correlation));
    }
    next.cameras = std::make_shared<Cameras>(std::move(correlations), noise);
    const Cameras& cameras = *next.cameras;
    if (coarser < 0) coarser = std::clamp(static_cast<int>(std::floor(std::log2(shortest / 50.0))), 0, 6);
    const double scale = std::sqrt(std::abs(cameras[0].pixels_per_length().determinant()));  // [px/length]
    double cut_off = options_.regularisation;
    if (level > 0) cut_off = std::max({cut_off, 2.0 * mean_edge(surface), 24.0 / scale});
    if (level == 0 && several) require_sight(next, views);
    const Eigen::SparseMatrix<double> M = cameras.M();
    next.smoothing = next.chosen = cameras.smoothing_weight(cut_off) * energy;
    if (level == 0 && several) {
      require_sight(next, views);
      const std::vector<int> unseen = cameras.hardly_seen(M);
      continued_ = !unseen.empty();
      if (continued_) {
        next.smoothing += continuation(cameras, unseen);
        spdlog::warn(
            "{} of {} nodes are not, or hardly, seen by two cameras: what cannot be seen of their motion continues "
            "that of their neighbours",
            unseen.size(), cameras.nodes());
      }
    }
    if (level == 0) calm(next, M, energy);
    next.factor = std::make_shared<Factor>(M + next.smoothing);
    require_speckle(next, views.front().place);
    if (level == 0)
      next.cameras->find_epipolar_modes(
          [&](const Eigen::MatrixXd& forces) { return Eigen::MatrixXd(next.factor->solve(forces)); });
    if (level > 0) levels_.back().references.clear();
    levels_.push_back(std::move(next));
    if (level == 0) find_motion_noise(views);
  }
}

void GlobalDic::find_motion_noise(const std::vector<View>& views) {
  motion_noise_.assign(views.size(), 1.0);
  for (std::size_t c = 0; c < views.size() && options_.low_pass > 0.0; ++c) {
    const PixelQuadrature& pixels = correlation(static_cast<int>(c)).quadrature();
    double once = 0.0, twice = 0.0;
    for (const auto* slopes : {&pixels.fx, &pixels.fy}) {
      imaging::Image slope(views[c].reference.width, views[c].reference.height);
      std::size_t p = 0;
      for (const PixelRow& row : pixels.rows)
        for (int i = 0; i < row.count; ++i) slope(row.column + i, row.row) = (*slopes)[p++];
      for (const float value : slope.grey) once += static_cast<double>(value) * value;
      for (const float value : imaging::low_pass(slope, options_.low_pass).grey)
        twice += static_cast<double>(value) * value;
    }
    motion_noise_[c] = std::sqrt(twice / once);
  }
}

Eigen::SparseMatrix<double> GlobalDic::held() const {
  if (!continued_) return {};
  return levels_.front().smoothing - levels_.front().chosen;
}

imaging::BSpline GlobalDic::spline(const imaging::Image& image) const {
  return options_.low_pass > 0.0 ? imaging::BSpline(imaging::low_pass(image, options_.low_pass))
                                 : imaging::BSpline(image);
}

std::vector<imaging::BSpline> GlobalDic::splines(const std::vector<imaging::Image>& images, int level) const {
  std::vector<imaging::BSpline> result;
  for (const imaging::Image& image : images) result.push_back(level == 0 ? spline(image) : imaging::BSpline(image));
  return result;
}

void GlobalDic::require_sight(const Level& level, const std::vector<View>& views) const {
  int unseen = 0, first = -1;
  for (int e = 0; e < level.cameras->elements(); ++e)
    if (level.cameras->pixels_of(e) == 0 &&
        (options_.left_out.empty() || options_.left_out[static_cast<std::size_t>(e)] == 0))
      ++unseen, first = first < 0 ? e : first;
  if (unseen > 0) {
    Eigen::RowVector3d centre = Eigen::RowVector3d::Zero();
    for (int i = 0; i < 4; ++i)
      centre += 0.25 * level.cameras->surface().nodes.row(level.cameras->surface().cells(first, i));
    throw InputError(
        "cameras",
        fmt::format("{} of {} elements are seen by no camera, the first is number {} about ({:.4g}, {:.4g}, {:.4g})",
                    unseen, level.cameras->elements(), first, centre[0], centre[1], centre[2]),
        "a mesh of which each element lies in the field of view of a camera");
  }
  for (std::size_t c = 0; c < views.size(); ++c)
    if ((*level.cameras)[static_cast<int>(c)].quadrature().pixels() == 0)
      throw InputError(views[c].place, "no part of the mesh lies in this camera's image", "cameras that see the mesh");
}

// Where the border leaves nodes of a contour hardly a pixel of their own, a single one may rattle by pixels and the
// frame never converges. A thousandth of the smoothing lets nodes without any pixel be told like the others.
void GlobalDic::calm(Level& level, const Eigen::SparseMatrix<double>& M, const Eigen::SparseMatrix<double>& energy) {
  const Cameras& cameras = *level.cameras;
  // Without the regularisation that was asked for: the ends are smoothed, and their noise is drawn, by what the pixels
  // alone say.
  const Factor judged(M + Eigen::SparseMatrix<double>(level.smoothing - level.chosen) +
                      1e-3 * cameras.smoothing_weight(2.0 * mean_edge(cameras.surface())) * energy);
  if (judged.info() != Eigen::Success) return;
  const std::vector<int> nodes = noisy_nodes(diagonal_of_inverse(judged), cameras.dofs_per_node());
  if (nodes.empty() || 4 * static_cast<int>(nodes.size()) > cameras.nodes())
    return;  // more than a contour: no continuation makes up for speckle
  level.of_noisy = continuation(cameras, nodes);
  level.smoothing += level.of_noisy;
  continued_ = true;
  spdlog::info("{} of {} nodes have hardly a pixel of their own: their motion continues that of their neighbours",
               nodes.size(), cameras.nodes());
}

// Nodes that one camera does not see have no depth of their own: there, and only there, waves shorter than two elements
// are smoothed, which continues what the neighbours do.
Eigen::SparseMatrix<double> GlobalDic::continuation(const Cameras& cameras, const std::vector<int>& nodes) {
  std::vector<char> elements(static_cast<std::size_t>(cameras.elements()), 0);
  for (int e = 0; e < cameras.elements(); ++e)
    for (int i = 0; i < 4; ++i)
      if (std::binary_search(nodes.begin(), nodes.end(), cameras.surface().cells(e, i)))
        elements[static_cast<std::size_t>(e)] = 1;
  return 0.1 * cameras.smoothing_weight(2.0 * mean_edge(cameras.surface())) *
         curvature_energy(cameras.surface(), cameras.dofs_per_node(), elements);
}

void GlobalDic::require_speckle(const Level& level, const std::string& place) const {
  const Eigen::VectorXd pivots = level.factor->vectorD();
  constexpr double least = 1e-10;
  if (level.factor->info() == Eigen::Success && pivots.minCoeff() > least * pivots.maxCoeff()) return;
  int empty = 0;
  for (int e = 0; e < level.cameras->elements(); ++e) empty += level.cameras->pixels_of(e) < 8;
  throw InputError(place,
                   fmt::format("too little speckle to correlate every node (M_DIC is singular; {} of {} elements have "
                               "fewer than 8 pixels)",
                               empty, level.cameras->elements()),
                   "elements that cover several speckles each, or dic.regularisation");
}

// Gauss-Newton on one level: M dU = b (Eq. 7 for alpha = 1).
void GlobalDic::solve_level(int level, std::span<const imaging::BSpline> g, const Communicator& group,
                            DicFrame& frame) const {
  const Level& at = levels_[static_cast<std::size_t>(level)];
  const Cameras& cameras = *at.cameras;
  const bool finest = level == 0;
  const double tolerance = finest ? options_.tolerance : std::max(options_.tolerance, 0.02);
  const int iterations = finest ? options_.max_iterations : 40;
  constexpr double longest_step = 2.0;  // [px]; beyond the reach of the linearisation
  // Coarse levels smooth the change from the start; the finest one the displacement itself, if the user asks.
  const Eigen::VectorXd start = finest ? Eigen::VectorXd::Zero(cameras.unknowns()) : frame.displacement;
  std::vector<Eigen::Matrix2d> F_of_M(static_cast<std::size_t>(cameras.size() * cameras.elements()),
                                      Eigen::Matrix2d::Identity());
  std::shared_ptr<Factor> factor = at.factor;
  Eigen::SparseMatrix<double> smoothing = at.smoothing;
  std::vector<Eigen::VectorXd> shares(static_cast<std::size_t>(cameras.size()),
                                      Eigen::VectorXd::Ones(cameras.elements()));
  double previous = INFINITY, least = 0.0;
  frame.converged = false;
  frame.iterations = 0;
  frame.epipolar = Eigen::VectorXd::Zero(cameras.epipolar_modes());
  while (true) {
    const JointEvaluation seen =
        cameras.evaluate(g, frame.displacement, group, Gradient::transported, cameras.off_epipolar(frame.epipolar));
    least = seen.least;
    frame.rms = seen.rms, frame.coefficient = seen.coefficient;
    frame.pixels = seen.pixels, frame.dropped = seen.dropped;
    frame.gain = seen.cameras.front().gain, frame.offset = seen.cameras.front().offset;
    frame.element_rms = seen.element_rms;
    frame.cameras.clear();
    for (const Evaluation& own : seen.cameras)
      frame.cameras.push_back({.rms = own.rms(),
                               .coefficient = own.coefficient,
                               .pixels = own.pixels,
                               .dropped = own.dropped,
                               .gain = own.gain,
                               .offset = own.offset,
                               .element_rms = own.element_rms});
    if (frame.converged || frame.iterations == iterations || seen.pixels == 0.0) break;
    auto F = cameras.deformation_gradient(frame.displacement);
    // Pixels that have left one of several images tell nothing any more.
    double left = 0.0;
    for (std::size_t c = 0; cameras.size() > 1 && c < shares.size(); ++c)
      for (int e = 0; e < cameras.elements(); ++e)
        if (const auto pixels = static_cast<double>(cameras[static_cast<int>(c)].quadrature().pixels_of(e));
            pixels > 0.0)
          left = std::max(left, std::abs(seen.cameras[c].element_pixels[e] / pixels - shares[c][e]));
    if (largest_change(F, F_of_M) > options_.strain_change || left > 0.1) {
      for (std::size_t c = 0; left > 0.1 && c < shares.size(); ++c)
        for (int e = 0; e < cameras.elements(); ++e)
          shares[c][e] = seen.cameras[c].element_pixels[e] /
                         std::max(1.0, static_cast<double>(cameras[static_cast<int>(c)].quadrature().pixels_of(e)));
      const Eigen::SparseMatrix<double> M = cameras.M(frame.displacement, shares);
      if (finest && left > 0.1) {
        smoothing = at.chosen;
        if (at.of_noisy.size() > 0) smoothing += at.of_noisy;
        const std::vector<int> nodes = cameras.hardly_seen(M);
        frame.hardly_seen = static_cast<int>(nodes.size());
        if (!nodes.empty()) smoothing += continuation(cameras, nodes);
      }
      factor = std::make_shared<Factor>(M + smoothing);
      F_of_M = std::move(F);
      if (factor->info() != Eigen::Success) break;
    }
    Eigen::VectorXd update = factor->solve(seen.b - smoothing * (frame.displacement - start));
    const Eigen::VectorXd steps = cameras.steps(frame.displacement, update);
    double largest = steps.allFinite() ? steps.maxCoeff() : NAN;
    Eigen::VectorXd off = seen.b_epipolar;  // the modes are orthonormal
    if (off.size() > 0) {
      double longest = 0.0;
      for (const InImage& own : cameras.off_epipolar(off)) longest = std::max(longest, own.rowwise().norm().maxCoeff());
      off *= std::min(1.0, longest_step / longest), largest = off.allFinite() ? std::max(largest, longest) : NAN;
    }
    if (group.size() > 1) group.broadcast(std::span(&largest, 1));  // every rank decides alike
    if (!std::isfinite(largest)) break;
    const int dofs = cameras.dofs_per_node();
    for (int node = 0; node < cameras.nodes(); ++node)
      if (steps[node] > longest_step)
        update.segment(static_cast<Eigen::Index>(node) * dofs, dofs) *= longest_step / steps[node];
    frame.displacement += update, frame.epipolar += off;
    ++frame.iterations;
    frame.converged = largest < tolerance;
    // A coarse level that no longer gains has done its work.
    if (!finest && frame.iterations > 8 && largest > 0.9 * previous && largest < 0.5) frame.converged = true;
    previous = largest;
  }
  frame.lost = least < options_.lost || frame.pixels < 0.5 * (frame.pixels + frame.dropped);
}

DicFrame GlobalDic::correlate(const imaging::Image& image, const Eigen::VectorXd& start, int coarsest, int finest,
                              const Communicator& group) const {
  return correlate(std::vector<imaging::Image>{image}, start, coarsest, finest, group);
}

DicFrame GlobalDic::correlate(std::vector<imaging::Image> images, const Eigen::VectorXd& start, int coarsest,
                              int finest, const Communicator& group) const {
  DicFrame frame;
  frame.displacement = start;
  std::vector<std::vector<imaging::Image>> pyramid;
  pyramid.push_back(std::move(images));
  for (int level = 1; level <= coarsest; ++level) pyramid.push_back(imaging::half_sizes(pyramid.back()));
  for (int level = coarsest; level >= finest; --level) {
    const auto g = splines(pyramid.back(), level);
    pyramid.pop_back();
    solve_level(level, g, group, frame);
  }
  return frame;
}

Eigen::VectorXd GlobalDic::standard_deviation(double sigma, int references) const {
  return standard_deviation(std::vector<ImageNoise>(static_cast<std::size_t>(cameras().size()), {sigma, references}));
}

Eigen::VectorXd GlobalDic::standard_deviation(const std::vector<ImageNoise>& noise) const {
  const Level& finest = levels_.front();
  // Of M_c in the covariance B of b, and of the gradient's noise in M.
  std::vector<double> of_b, of_M;
  double pixels = 0.0, factor = 0.0;  // factor: B is about factor * M
  for (int c = 0; c < cameras().size(); ++c) {
    const ImageNoise& own = noise.at(static_cast<std::size_t>(c));
    const double w = cameras().weight(c), seen = static_cast<double>(correlation(c).quadrature().pixels());
    of_b.push_back(w * w * std::pow(own.sigma * motion_noise(c), 2) * (1.0 + 1.0 / own.references));
    of_M.push_back(w * own.sigma * own.sigma / own.references);
    factor += of_b.back() * seen, pixels += w * seen;
  }
  factor /= pixels;
  const Eigen::SparseMatrix<double> M = cameras().M(), B = cameras().sum_of_M(of_b);
  if (options_.regularisation <= 0.0 && !continued_) {
    // B = factor (T + R) with a small R: diag(T^-1 B T^-1)/factor = diag(T^-1) + diag(T^-1 R T^-1), the latter as the
    // derivative of (T - h R)^-1 in h. One camera: R = V.
    const Eigen::SparseMatrix<double> T = M - cameras().sum_of_gradient_noise(of_M), R = B / factor - T;
    constexpr double h = 0.01;
    const Factor tangent(T), less(T - h * R), more(T + h * R);
    if (less.info() == Eigen::Success && less.vectorD().minCoeff() > 0.0 && more.vectorD().minCoeff() > 0.0) {
      const Eigen::VectorXd slope = (diagonal_of_inverse(less) - diagonal_of_inverse(more)) / (2.0 * h);
      return (factor * (diagonal_of_inverse(tangent) + slope)).cwiseMax(0.0).cwiseSqrt();
    }
    spdlog::warn(
        "the noise is as strong as the speckle in parts of the reference: the displacement's standard deviation is "
        "underestimated");
    return (factor * diagonal_of_inverse(*finest.factor)).cwiseMax(0.0).cwiseSqrt();
  }
  Eigen::VectorXd variance(M.cols());
#pragma omp parallel for schedule(static)
  for (Eigen::Index i = 0; i < M.cols(); ++i) {
    const Eigen::VectorXd column = finest.factor->solve(Eigen::VectorXd::Unit(M.cols(), i));
    variance[i] = column.dot(B * column);
  }
  return variance.cwiseMax(0.0).cwiseSqrt();
}

}  // namespace imic3d::correlation
