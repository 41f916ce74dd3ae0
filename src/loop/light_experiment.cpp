#include "imic3d/loop/light_experiment.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

#include "declared.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace {

// of a cell's mean square, constant over time: noise goes with brightness
constexpr double level_known_to = 0.1;
// of a cell's mean square, over time: it goes with brightness, and no interpolation is right to better than that
constexpr double noise_known_to = 0.03;
// of the light, over time: neither lamp nor sensor is steady, nor interpolation right, to better than that
constexpr double light_known_to = 1e-4;
constexpr double saturated_allowed = 1e-4;  // share of the pixels: hot ones
constexpr double judged_by_ratio = 10.0;    // standard deviations

Eigen::VectorXd compressed(const Eigen::VectorXd& z) { return judged_by_ratio * (z / judged_by_ratio).array().asinh(); }

/// Whitens S ((1 - shared) 1 + shared 1 1^T) S + level 1 1^T, S of each frame's standard deviation [frames].
Eigen::MatrixXd over_time(const Eigen::VectorXd& deviation, double shared, double level,
                          const std::vector<int>& held_out) {
  const auto frames = deviation.size();
  const Eigen::MatrixXd alike =
      (1.0 - shared) * Eigen::MatrixXd::Identity(frames, frames) + Eigen::MatrixXd::Constant(frames, frames, shared);
  const Eigen::MatrixXd covariance =
      deviation.asDiagonal() * alike * deviation.asDiagonal() + Eigen::MatrixXd::Constant(frames, frames, level);
  return whitening(covariance, held_out);
}

double root_of_count(double count, double pixels) {
  const double allowed = 0.375 + saturated_allowed * pixels;
  return 2.0 * (std::sqrt(std::max(0.0, count) + allowed) - std::sqrt(allowed));
}

}  // namespace

struct LightExperiment::Whitening {
  Eigen::MatrixXd of_linear;               // G^-1/2 / noise, without what is fitted in each frame [L x L]
  Eigen::MatrixXd of_fitted;               // marks of an offset, a gain and its slopes of one frame [L x 4]
  Eigen::MatrixXd kept;                    // projection that takes away what is fitted [L x L]
  Eigen::MatrixXd linear_over_time;        // [frames x frames]
  std::vector<Eigen::MatrixXd> over_time;  // of each cell
  Eigen::MatrixXd expected;                // mean square for the camera's noise [cells x frames]
  Eigen::MatrixXd deviation;               // of the mean square over the expected one [cells x frames]
  Eigen::Index first_row = 0;              // within a frame
};

LightExperiment::LightExperiment(std::vector<LightCamera> cameras, std::vector<int> frames, std::vector<int> held_out,
                                 const std::vector<DeclaredEffect>& declared, Synthetic synthetic,
                                 const std::function<std::string(std::string)>& unit)
    : cameras_(std::move(cameras)),
      frames_(std::move(frames)),
      held_out_(std::move(held_out)),
      synthetic_(std::move(synthetic)) {
  make_whitening();
  for (const auto& camera : cameras_)
    parameters_.push_back({.info = {.name = cameras_.size() == 1 ? "noise" : "noise_" + camera.optics.camera,
                                    .unit = "grey level",
                                    .description = "standard deviation of one image",
                                    .lower = 0.1 * camera.optics.noise,
                                    .upper = 10.0 * camera.optics.noise},
                           .value = camera.optics.noise,
                           .step = 1e-3 * camera.optics.noise,
                           .free = true});
  const Scene& scene = cameras_.front().scene;
  const auto add = [&](const std::shared_ptr<const Effect>& effect, int camera) {
    const auto description = effect->describe(scene);
    const std::string whose = camera < 0 ? "" : cameras_[static_cast<std::size_t>(camera)].optics.camera + " ";
    Candidate candidate{
        whose + description.name,
        description.link,
        {},
        description.sentence +
            (camera < 0 ? "" : ", of the camera " + cameras_[static_cast<std::size_t>(camera)].optics.camera),
        description.confused_with,
        description.separated_by,
        {}};
    first_.push_back(parameters_.size());
    int place = -1;
    for (const auto& q : description.quantities) {
      ++place;
      const int j = static_cast<int>(parameters_.size());
      parameters_.push_back(absent(q, unit ? unit(q.unit) : q.unit));
      // What no camera sees has no mark.
      const bool seen =
          !q.name.starts_with("loose_") || std::any_of(cameras_.begin(), cameras_.end(), [&](const auto& its) {
            return std::find(its.optics.places.begin(), its.optics.places.end(), place) != its.optics.places.end();
          });
      if (!declare(parameters_.back(), candidate.name, declared) && seen) candidate.parameters.push_back(j);
      parameters_.back().info.name = key_of(whose) + q.name;
    }
    const auto fitted = [&](bool LightOptics::*what) {
      return camera < 0
                 ? std::all_of(cameras_.begin(), cameras_.end(), [&](const auto& its) { return its.optics.*what; })
                 : cameras_[static_cast<std::size_t>(camera)].optics.*what;
    };
    const auto& name = description.name;
    if ((name == "light gain" || name == "light offset") && fitted(&LightOptics::gain_and_offset_fitted))
      candidate.parameters.clear();
    if ((name == "noise level" || name == "aliasing") && images_compressed()) candidate.parameters.clear();
    if (name == "light gradient" && fitted(&LightOptics::local)) candidate.parameters.clear();
    if (name == "aliasing" && fitted(&LightOptics::local))
      std::erase_if(candidate.parameters, [&](int j) { return parameters_[static_cast<std::size_t>(j)].info.shape; });
    if (std::any_of(candidate.parameters.begin(), candidate.parameters.end(),
                    [&](int j) { return !parameters_[static_cast<std::size_t>(j)].info.shape; }))
      candidates_.push_back(std::move(candidate));
    effects_.push_back(effect), camera_of_.push_back(camera);
  };
  for (const auto& effect : light_effects()) {
    add(effect, -1);
    for (int k = 0; cameras_.size() > 1 && effect->of_one_of_several() && k < static_cast<int>(cameras_.size()); ++k)
      add(effect, k);
  }
  const auto count = static_cast<Eigen::Index>(frames_.size());
  for (Eigen::Index t = 0; t < count; ++t)
    for (std::size_t k = 0; k < cameras_.size(); ++k)
      for (Eigen::Index i = 0; i < numbers(k); ++i) data_.push_back({static_cast<int>(t), static_cast<int>(k)});
  z_.resize(static_cast<Eigen::Index>(data_.size()));
  for (std::size_t k = 0; k < cameras_.size(); ++k) {
    const auto& w = *whitening_[k];
    const auto& its = cameras_[k].frames;
    Eigen::MatrixXd sums(2 * cameras_[k].optics.cells() + 2, count), squares(cameras_[k].optics.cells(), count);
    Eigen::VectorXd saturated(count);
    for (Eigen::Index t = 0; t < count; ++t) {
      const auto& frame = its[static_cast<std::size_t>(t)];
      sums.col(t) = frame.linear, squares.col(t) = frame.squares.cwiseQuotient(w.expected.col(t)).array() - 1.0;
      saturated[t] = root_of_count(frame.saturated, frame.pixels);
    }
    put(k, sums, squares, saturated, z_);
  }
  bias_ = Eigen::VectorXd::Zero(z_.size());
  if (const double onset = plain_onset(); onset > 0.0)
    for (auto& candidate : candidates_)
      std::erase_if(candidate.parameters, [&](int j) {
        Parameter& p = parameters_[static_cast<std::size_t>(j)];
        if (p.info.name != "onset") return false;
        p.value = onset, p.info.null_value = onset;
        candidate.sentence += fmt::format(", from {:.0f} % of the test's time on", 100.0 * onset);
        return true;
      });
}

bool LightExperiment::images_compressed() const {
  return std::any_of(cameras_.begin(), cameras_.end(), [](const auto& camera) { return camera.optics.compressed; });
}

/// Clock time of the largest jump of a cell's mean square over time, if it is far beyond noise: then the data's own
/// choice is no chance. 0: none.
double LightExperiment::plain_onset() const {
  double largest = 20.0, onset = 0.0;
  for (std::size_t k = 0; k < cameras_.size(); ++k) {
    const auto& w = *whitening_[k];
    const auto& scene = cameras_[k].scene;
    for (Eigen::Index c = 0; c < w.expected.rows(); ++c) {
      double before = 0.0, all = 0.0;
      Eigen::VectorXd q(w.expected.cols());
      for (Eigen::Index t = 0; t < q.size(); ++t)
        q[t] =
            (cameras_[k].frames[static_cast<std::size_t>(t)].squares[c] / w.expected(c, t) - 1.0) / w.deviation(c, t);
      q = compressed(q), all = q.sum();
      for (Eigen::Index t = 1; t < q.size(); ++t) {
        before += q[t - 1];
        const auto n = static_cast<double>(t), m = static_cast<double>(q.size() - t);
        const double jump = ((all - before) / m - before / n) * std::sqrt(n * m / (n + m));
        if (jump > largest) largest = jump, onset = 0.5 * (scene.clock(t - 1) + scene.clock(t));
      }
    }
  }
  return std::min(onset, 0.85);
}

void LightExperiment::make_whitening() {
  const auto count = static_cast<Eigen::Index>(frames_.size());
  Eigen::Index first_row = 0;
  for (std::size_t k = 0; k < cameras_.size(); ++k) {
    const auto& optics = cameras_[k].optics;
    const auto& frames = cameras_[k].frames;
    const auto cells = optics.cells();
    Whitening w;
    w.first_row = first_row, first_row += numbers(k);
    w.expected.resize(cells, count), w.deviation.resize(cells, count);
    std::vector<double> kurtosis;
    for (const auto& frame : frames) kurtosis.insert(kurtosis.end(), frame.kurtosis.begin(), frame.kurtosis.end());
    const double tails = std::max(1.0, 0.5 * (median(kurtosis) - 1.0));  // over a Gaussian's
    for (Eigen::Index t = 0; t < count; ++t) {
      const auto& frame = frames[static_cast<std::size_t>(t)];
      const Eigen::ArrayXd unit = frame.frame_noise.array() + optics.level / optics.references;
      w.expected.col(t) = std::pow(optics.noise, 2) * (1.0 - optics.absorbed) * unit;
      w.deviation.col(t) = (tails * frame.spread.array()).sqrt() / unit;
    }
    // Symmetric roots: each number stays that of its cell.
    const SymmetricEigen eigen =
        symmetric_eigen(optics.G.diagonal().cwiseSqrt().cwiseInverse().asDiagonal() * optics.G *
                        optics.G.diagonal().cwiseSqrt().cwiseInverse().asDiagonal());
    const double floor = 1e-8 * eigen.values.maxCoeff();
    const Eigen::VectorXd root = (eigen.values.array() > floor).select(eigen.values.array().max(floor).rsqrt(), 0.0);
    w.of_linear = eigen.vectors * root.asDiagonal() * eigen.vectors.transpose() *
                  optics.G.diagonal().cwiseSqrt().cwiseInverse().asDiagonal() / optics.noise;
    // offset and gain of a frame, the gain's slopes
    Eigen::MatrixXd fitted = Eigen::MatrixXd::Zero(optics.R.cols(), 4);
    fitted.block(optics.own, 0, 6 * cells, 2) = optics.offset_and_gain();
    for (Eigen::Index c = 0; c < cells; ++c) {
      const Eigen::Vector2d at = optics.middle[static_cast<std::size_t>(c)] - cameras_[k].scene.middle();
      const Eigen::Index first = optics.own + 6 * c;
      for (int a = 0; a < 2; ++a)
        fitted(first, 2 + a) = optics.mean[c] * at[a], fitted(first + 1, 2 + a) = at[a],
                          fitted(first + 2 + a, 2 + a) = optics.mean[c], fitted(first + 4 + a, 2 + a) = 1.0;
    }
    w.of_fitted = w.of_linear * (optics.R * fitted);
    const Eigen::MatrixXd Q = orthonormal(w.of_fitted.leftCols(2));
    w.kept = Eigen::MatrixXd::Identity(w.of_fitted.rows(), w.of_fitted.rows()) - Q * Q.transpose();
    if (optics.gain_and_offset_fitted) w.of_linear = (w.kept * w.of_linear).eval();
    // A frame of more noise scatters more in all its numbers: by its places' median mean square over the expected one,
    // where that is off by more than the level is known to.
    const double of_reference = 1.0 / optics.references;
    Eigen::VectorXd mean_square(count);
    for (Eigen::Index t = 0; t < count; ++t) {
      const Eigen::VectorXd ratios = frames[static_cast<std::size_t>(t)].squares.cwiseQuotient(w.expected.col(t));
      const double middle = median(std::vector<double>(ratios.begin(), ratios.end()));
      mean_square[t] = std::abs(middle - 1.0) > level_known_to ? middle : 1.0;
    }
    const Eigen::VectorXd scatter = (mean_square.array() * (1.0 + of_reference) - of_reference).max(0.1).sqrt();
    w.linear_over_time = over_time(scatter, 0.0, of_reference, held_out_);
    for (Eigen::Index c = 0; c < cells; ++c) {
      double mean_deviation = 0.0, shared = 0.0;
      for (Eigen::Index t = 0; t < count; ++t) {
        mean_deviation += w.deviation(c, t) / static_cast<double>(count);
        shared += optics.shared / optics.pixels[c] / frames[static_cast<std::size_t>(t)].spread[c] /
                  static_cast<double>(count);
      }
      w.over_time.push_back(
          over_time(mean_square, std::min(0.9, shared), std::pow(level_known_to / mean_deviation, 2), held_out_));
    }
    whitening_.push_back(std::make_shared<const Whitening>(std::move(w)));
  }
}

void LightExperiment::put(std::size_t camera, const Eigen::MatrixXd& sums, const Eigen::MatrixXd& squares,
                          const Eigen::VectorXd& saturated, Eigen::VectorXd& z) const {
  const auto& w = *whitening_[camera];
  const auto rows = linear(camera), cells = squares.rows(), count = squares.cols();
  Eigen::MatrixXd all(numbers(camera), count);
  if (rows > 0) all.topRows(rows) = w.of_linear * sums * w.linear_over_time.transpose();
  for (Eigen::Index c = 0; c < cells; ++c)
    all.row(rows + c) =
        (w.over_time[static_cast<std::size_t>(c)] * squares.row(c).cwiseQuotient(w.deviation.row(c)).transpose())
            .transpose();
  all.bottomRows(1) = saturated.transpose();
  const Eigen::Index per_frame = z.size() / count;
  for (Eigen::Index t = 0; t < count; ++t) z.segment(t * per_frame + w.first_row, all.rows()) = all.col(t);
}

std::vector<Eigen::Index> LightExperiment::rows_of(std::size_t camera, Eigen::Index cell, int frame) const {
  const Eigen::Index first =
      frame * z_.size() / static_cast<Eigen::Index>(frames_.size()) + whitening_[camera]->first_row;
  if (linear(camera) == 0) return {first + cell};
  return {first + 2 * cell, first + 2 * cell + 1, first + linear(camera) + cell};
}

Eigen::VectorXd LightExperiment::predicted(const std::vector<double>& values) const {
  std::vector<Changes> changes;
  for (std::size_t k = 0; k < cameras_.size(); ++k) changes.push_back(changes_of(k, values));
  Eigen::VectorXd z = Eigen::VectorXd::Zero(z_.size());
  for (std::size_t k = 0; k < cameras_.size(); ++k) {
    const LightOptics& optics = cameras_[k].optics;
    auto& [grows, sums, squares, saturated] = changes[k];
    Eigen::MatrixXd light(optics.R.cols(), grows.cols());  // of all cameras that are correlated together
    Eigen::Index first = 0;
    for (std::size_t other = 0; other < cameras_.size(); ++other)
      if (const auto& grows_there = changes[other].grows; cameras_[other].face == cameras_[k].face)
        light.middleRows(first, grows_there.rows()) = cameras_[other].optics.beside_fitted * grows_there,
                                first += grows_there.rows();
    for (Eigen::Index t = 0; t < light.cols(); ++t) {
      if (light.col(t).isZero(0.0)) continue;
      sums.col(t) -= optics.R * light.col(t);
      for (Eigen::Index c = 0; c < optics.cells(); ++c)
        squares(c, t) +=
            light.col(t).dot(optics.E[static_cast<std::size_t>(c)] * light.col(t)) / whitening_[k]->expected(c, t);
    }
    put(k, sums, squares, saturated, z);
  }
  return z;
}

LightExperiment::Changes LightExperiment::changes_of(std::size_t camera, const std::vector<double>& values) const {
  const auto& [optics, scene, frames, face] = cameras_[camera];
  const auto& w = *whitening_[camera];
  const auto cells = optics.cells(), count = static_cast<Eigen::Index>(frames_.size());
  constexpr double third = 1.0 / 3.0;
  const double now = values[camera] * values[camera];  // of the noise
  Changes changes{Eigen::MatrixXd(6 * cells, count), Eigen::MatrixXd::Zero(2 * cells + 2, count),
                  Eigen::MatrixXd(cells, count), Eigen::VectorXd(count)};
  for (Eigen::Index t = 0; t < count; ++t) {
    const auto& frame = frames[static_cast<std::size_t>(t)];
    for (Eigen::Index c = 0; c < cells; ++c) {
      // Gain and offset of the cell and their slopes from 3 x 3 points of it.
      Eigen::Matrix<double, 3, 2> fitted = Eigen::Matrix<double, 3, 2>::Zero();
      Light mean{.gain = 0.0, .contrast = 0.0, .noise = 0.0};
      for (int i = 0; i < 9; ++i) {
        const Eigen::Vector2d from(third * (i % 3 - 1) * optics.size[0], third * (i / 3 - 1) * optics.size[1]);
        const Eigen::Vector2d point = optics.middle[static_cast<std::size_t>(c)] + from;
        Light light;
        for (std::size_t e = 0; e < effects_.size(); ++e) {
          if (camera_of_[e] >= 0 && camera_of_[e] != static_cast<int>(camera)) continue;
          const std::size_t next = e + 1 < first_.size() ? first_[e + 1] : parameters_.size();
          effects_[e]->light(std::span(values).subspan(first_[e], next - first_[e]), scene, static_cast<int>(t), point,
                             point + frame.motion[static_cast<std::size_t>(c)], light);
        }
        const Eigen::RowVector2d both(
            (1.0 - light.foreign) * light.gain - 1.0,
            (1.0 - light.foreign) * light.offset + light.foreign * (optics.mean[c] + light.beneath));
        fitted.row(0) += both / 9.0;
        for (int a = 0; a < 2; ++a) fitted.row(1 + a) += both * (from[a] / (6.0 * std::pow(third * optics.size[a], 2)));
        mean.foreign += light.foreign / 9.0, mean.beneath += light.beneath / 9.0, mean.contrast += light.contrast / 9.0,
            mean.noise += light.noise / 9.0, mean.aliased += light.aliased / 9.0, mean.smeared += light.smeared / 9.0,
            mean.saturated += light.saturated / 9.0;
      }
      // of f' and of 1
      const Eigen::Vector3d gain = fitted.col(0), offset = fitted.col(1) + optics.mean[c] * gain;
      changes.grows.col(t).segment<6>(6 * c) << offset[0], gain[0] - 0.5 * mean.smeared * frame.aliasing[c], offset[1],
          offset[2], gain[1], gain[2];
      const double f2 = optics.variance[c], b2 = mean.beneath * mean.beneath;
      const double excess =
          mean.foreign * (f2 * (1.0 + mean.contrast * mean.contrast) + b2) - mean.foreign * mean.foreign * (f2 + b2);
      const double of_noise = now * (1.0 - optics.absorbed) *
                              (optics.level / optics.references + mean.noise * mean.noise * frame.frame_noise[c]);
      changes.squares(c, t) = (of_noise + mean.aliased * f2 * frame.aliasing[c] + excess) / w.expected(c, t) - 1.0;
      changes.sums(2 * c + 1, t) = now * optics.pixels[c] * optics.level / optics.references *
                                   (1.0 - optics.absorbed);  // f holds noise that r holds, too
      if (c == 0) changes.saturated[t] = root_of_count(mean.saturated * frame.pixels, frame.pixels);
    }
  }
  return changes;
}

std::vector<Eigen::VectorXd> LightExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  std::vector<Eigen::VectorXd> all;
  for (const auto& values : sets) all.emplace_back(compressed(z_) - compressed(predicted(values) + bias_));
  return all;
}

void LightExperiment::learn_bias(const std::vector<double>&) {
  if (!synthetic_) return;
  const auto made = synthetic_();
  synthetic_ = {};  // the motion's, whatever the light is
  const auto count = static_cast<Eigen::Index>(frames_.size());
  for (std::size_t k = 0; k < made.size(); ++k) {
    const auto& optics = cameras_[k].optics;
    const auto& w = *whitening_[k];
    const double noise = optics.noise * optics.noise / optics.references;  // of f, which these images hold too
    Eigen::MatrixXd sums(2 * optics.cells() + 2, count), squares(optics.cells(), count);
    for (Eigen::Index t = 0; t < count; ++t) {
      const auto& frame = made[k][static_cast<std::size_t>(t)];
      sums.col(t) = frame.linear;
      for (Eigen::Index c = 0; c < optics.cells(); ++c) sums(2 * c + 1, t) -= noise * frame.echo_linear[c];
      squares.col(t) = (frame.squares - noise * frame.echo).cwiseQuotient(w.expected.col(t));
    }
    put(k, sums, squares, Eigen::VectorXd::Zero(count), bias_);
    learned_squares_.push_back(std::move(squares));
  }
}

Eigen::MatrixXd LightExperiment::frame_noise() const {
  Eigen::MatrixXd noise(static_cast<Eigen::Index>(cameras_.size()), static_cast<Eigen::Index>(frames_.size()));
  for (std::size_t k = 0; k < cameras_.size(); ++k) {
    const auto& optics = cameras_[k].optics;
    const double of_reference = optics.level / optics.references;
    for (Eigen::Index t = 0; t < noise.cols(); ++t) {
      const auto& frame = cameras_[k].frames[static_cast<std::size_t>(t)];
      Eigen::ArrayXd ratio = frame.squares.cwiseQuotient(whitening_[k]->expected.col(t));
      if (!learned_squares_.empty()) ratio -= learned_squares_[k].col(t).array();
      const Eigen::ArrayXd squares =
          (ratio * (frame.frame_noise.array() + of_reference) - of_reference) / frame.frame_noise.array();
      noise(static_cast<Eigen::Index>(k), t) =
          std::sqrt(std::max(0.01, median(std::vector<double>(squares.begin(), squares.end()))));
    }
  }
  return noise;
}

Experiment::Doubt LightExperiment::doubt() const {
  const Eigen::VectorXd half = 0.5 * bias_.array() / (1.0 + (bias_ / judged_by_ratio).array().square()).sqrt();
  return {half, half};
}

Eigen::MatrixXd LightExperiment::noise(const std::vector<double>&, int draws) {
  std::uint64_t seed = 17;  // other draws for another test, the same ones for the same whatever the rounding
  for (double z : z_.head(std::min<Eigen::Index>(64, z_.size())))
    seed = 6364136223846793005U * seed + static_cast<std::uint64_t>(std::llround(1e3 * z));
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd result(z_.size(), draws);
  for (double& x : result.reshaped()) x = normal(random);
  // Random functions of time, of second degree: of the light of each camera; of the mean square of each cell and of
  // all.
  const auto count = static_cast<Eigen::Index>(frames_.size());
  Eigen::MatrixXd in_time(count, 3);
  for (Eigen::Index t = 0; t < count; ++t) {
    const double s = count > 1 ? 2.0 * static_cast<double>(t) / static_cast<double>(count - 1) - 1.0 : 0.0;
    in_time.row(t) << 1.0, s, 0.5 * (3.0 * s * s - 1.0);
  }
  in_time /= std::sqrt(1.0 + 1.0 / 3.0 + 0.2);
  for (int b = 0; b < draws; ++b)
    for (std::size_t k = 0; k < cameras_.size(); ++k) {
      const auto& w = *whitening_[k];
      const auto drawn = [&] { return Eigen::Vector3d(normal(random), normal(random), normal(random)); };
      if (linear(k) > 0) {
        const auto& [optics, scene, its, face] = cameras_[k];
        Eigen::Vector2d reach = Eigen::Vector2d::Zero();
        for (const auto& middle : optics.middle)
          reach = reach.cwiseMax((middle - scene.middle()).cwiseAbs() + 0.5 * optics.size);
        const Eigen::Vector4d unit(optics.mean.mean(), 1.0, 1.0 / reach[0],
                                   1.0 / reach[1]);  // of offset, gain and its slopes
        Eigen::MatrixXd changes(count, 4);
        for (int j = 0; j < 4; ++j) changes.col(j) = light_known_to * unit[j] * in_time * drawn();
        const Eigen::MatrixXd z = w.of_fitted * (w.linear_over_time * changes).transpose();
        for (Eigen::Index t = 0; t < count; ++t)
          result.col(b).segment(t * z_.size() / count + w.first_row, z.rows()) += z.col(t);
      }
      const Eigen::Vector3d whole = drawn();
      for (Eigen::Index c = 0; c < w.deviation.rows(); ++c) {
        const Eigen::VectorXd changes = noise_known_to / std::sqrt(2.0) * (in_time * (whole + drawn()));
        const Eigen::VectorXd z =
            w.over_time[static_cast<std::size_t>(c)] * changes.cwiseQuotient(w.deviation.row(c).transpose());
        for (Eigen::Index t = 0; t < count; ++t) result(rows_of(k, c, static_cast<int>(t)).back(), b) += z[t];
      }
    }
  for (std::size_t k = 0; k < cameras_.size(); ++k)
    for (Eigen::Index t = 0;
         t < static_cast<Eigen::Index>(frames_.size()) && cameras_[k].optics.gain_and_offset_fitted && linear(k) > 0;
         ++t) {
      auto rows = result.middleRows(
          t * z_.size() / static_cast<Eigen::Index>(frames_.size()) + whitening_[k]->first_row, linear(k));
      rows = (whitening_[k]->kept * rows).eval();
    }
  return result;
}

double LightExperiment::share_of_gain_and_offset(bool gradient) const {
  std::vector<double> null;
  for (const auto& p : parameters_) null.push_back(p.value);
  const Eigen::VectorXd r = z_ - predicted(null) - bias_;
  double all = 0.0, taken = 0.0, count = 0.0;
  for (std::size_t k = 0; k < cameras_.size(); ++k) {
    const Eigen::Index rows = linear(k), marks = gradient ? 4 : 2;
    if (rows == 0 || (cameras_[k].optics.gain_and_offset_fitted && !gradient)) continue;
    const Eigen::MatrixXd Q = orthonormal(whitening_[k]->of_fitted.leftCols(marks));
    for (Eigen::Index t = 0; t < static_cast<Eigen::Index>(frames_.size()); ++t) {
      const Eigen::VectorXd of_frame =
          r.segment(t * z_.size() / static_cast<Eigen::Index>(frames_.size()) + whitening_[k]->first_row, rows);
      all += of_frame.squaredNorm(), taken += (Q.transpose() * of_frame).squaredNorm() - static_cast<double>(Q.cols()),
          count += static_cast<double>(rows);
    }
  }
  const double excess = all - count;
  return excess > 5.0 * std::sqrt(2.0 * std::max(1.0, count)) ? std::clamp(taken / excess, 0.0, 1.0) : 0.0;
}

}  // namespace imic3d::loop
