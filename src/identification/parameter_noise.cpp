#include "parameter_noise.hpp"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <cmath>
#include <random>
#include <span>
#include <utility>
#include <vector>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"

namespace imic3d::identification {

namespace {

/// Of the response to noise, of which few draws tell the size.
constexpr mechanics::Accuracy accuracy_of_responses{.forces = 1e-7, .derivatives = 1e-4};

/// That tell a standard deviation well enough to weigh by it (to 30 %).
constexpr std::size_t telling_draws = 6;

/// Noise of b_DIC: columns of standard deviation one, b b^T = M on average [unknowns x columns].
class OpticalNoise {
 public:
  // P M P^T = L D L^T
  OpticalNoise(const ImageData& images, unsigned seed)
      : factor_(images.held.size() > 0 ? Eigen::SparseMatrix<double>(images.M + images.held) : images.M),
        random_(seed) {}
  Eigen::MatrixXd b(Eigen::Index columns) {
    Eigen::MatrixXd white(factor_.rows(), columns);
    for (double& value : white.reshaped()) value = normal_(random_);
    white = factor_.vectorD().cwiseMax(0.0).cwiseSqrt().asDiagonal() * white;
    return factor_.permutationPinv() * Eigen::MatrixXd(factor_.matrixL() * white);
  }
  [[nodiscard]] Eigen::MatrixXd displacement(const Eigen::MatrixXd& b) const { return factor_.solve(b); }
  double scalar() { return normal_(random_); }

 private:
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
};

/// `ends`: errors of the measured displacement that drives the ends [unknowns x frames, length]; `loads`: of the
/// measured force [frames, force].
Response respond(ForwardModel& model, const std::vector<double>& parameters, int frames,
                 const GaussNewtonOptions& options, std::span<const Eigen::MatrixXd> ends,
                 std::span<const Eigen::VectorXd> loads) {
  const Control control = control_of_images(options);
  const auto& record = model.record();
  const Specimen& specimen = model.specimen();
  const bool forces = control != Control::displacement, direct = options.sensitivities == Sensitivities::direct;
  const std::size_t both = ends.size() + (forces ? loads.size() : 0);
  std::vector<Eigen::MatrixXd> driving;
  for (const auto& error : ends)
    driving.push_back(options.noise_model.driving ? options.noise_model.driving(error) : error);
  const auto require_all = [&](const std::vector<Path>& paths) {
    for (const Path& path : paths)
      if (path.frames < frames) throw ConvergenceError(path.message);
  };

  std::vector<Path> driven, paths;
  if (direct) {
    Run run{.parameters = parameters, .accuracy = accuracy_of_responses};
    for (const auto& error : driving)
      run.directions.push_back({.prescribed = specimen.from_surface(Control::displacement) * error});
    if (!forces) {
      driven = paths = model.simulate(Control::displacement, {run}, frames);
    } else {
      const auto distribution = model.distribute_forces({run}, frames, driven).front();
      Run loaded{.parameters = parameters, .forces = &distribution, .accuracy = accuracy_of_responses};
      const auto on_the_ends = [&](const auto& of_frame) {
        std::vector<Eigen::Triplet<double>> entries;
        for (int t = 0; t < frames; ++t) {
          const Eigen::VectorXd column = of_frame(t);
          for (std::size_t i = 0; i < distribution.dofs.size(); ++i)
            entries.emplace_back(distribution.dofs[i], t, column[static_cast<Eigen::Index>(i)]);
        }
        Eigen::SparseMatrix<double> force(3 * specimen.volume.nodes.rows(), frames);
        force.setFromTriplets(entries.begin(), entries.end());
        return force;
      };
      for (std::size_t k = 0; k < ends.size(); ++k)
        loaded.directions.push_back(
            {.prescribed = specimen.from_surface(control) * driving[k],
             .force = on_the_ends([&](int t) { return record.force[t] * distribution.d_pattern[k].col(t); })});
      const Eigen::MatrixXd held =
          Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(specimen.dofs(control).size()), frames);
      for (const auto& error : loads)
        loaded.directions.push_back(
            {.prescribed = held, .force = on_the_ends([&](int t) { return error[t] * distribution.pattern.col(t); })});
      paths = model.simulate(control, {loaded}, frames);
    }
    require_all(driven), require_all(paths);
    Response response{.surface = paths.front().d_surface, .reaction = driven.front().d_reaction};
    response.reaction.resize(both, Eigen::VectorXd::Zero(frames));
    return response;
  }

  // Differences. Run 0 is the undisturbed one of each series, so that all take the same increments.
  std::vector<Run> runs(1 + ends.size(), Run{.parameters = parameters});
  for (auto& error : driving) error += record.driving.leftCols(frames);
  for (std::size_t k = 0; k < ends.size(); ++k) runs[1 + k].driving = &driving[k];
  std::vector<Eigen::VectorXd> resultants;
  std::vector<ForceDistribution> distributions;
  if (!forces) {
    paths = driven = model.simulate(control, runs, frames);
  } else {
    distributions = model.distribute_forces(runs, frames, driven);
    for (std::size_t k = 0; k < runs.size(); ++k) runs[k].forces = &distributions[k];
    for (const auto& error : loads) resultants.push_back(record.force.head(frames) + error);
    for (const auto& resultant : resultants)
      runs.push_back({.parameters = parameters, .forces = &distributions.front(), .resultant = &resultant});
    paths = model.simulate(control, runs, frames);
  }
  require_all(driven), require_all(paths);
  Response response;
  for (std::size_t k = 1; k < paths.size(); ++k) {
    response.surface.emplace_back(paths[k].surface - paths[0].surface);
    response.reaction.emplace_back(k <= ends.size() ? Eigen::VectorXd(driven[k].reaction - driven[0].reaction)
                                                    : Eigen::VectorXd(Eigen::VectorXd::Zero(frames)));
  }
  return response;
}

/// Infinite variances of what is not determined.
Covariance with_infinite(Covariance covariance, const std::vector<Eigen::Index>& undetermined) {
  for (Eigen::MatrixXd* part :
       {&covariance.image, &covariance.force, &covariance.boundary, &covariance.calibration, &covariance.total})
    for (const Eigen::Index j : undetermined) {
      part->row(j).setZero(), part->col(j).setZero();
      (*part)(j, j) = INFINITY;
    }
  return covariance;
}

}  // namespace

Control control_of_images(const GaussNewtonOptions& options) {
  if (options.functional == Functional::displacement_driven) return Control::displacement;
  return options.alpha > 0.0 ? Control::images : Control::force;
}

NoiseDraws draw_noise(ForwardModel& model, const ImageData& images, int frames, const GaussNewtonOptions& options,
                      const std::vector<double>& parameters) {
  const NoiseModel& noise = options.noise_model;
  NoiseDraws result;
  if (noise.draws == 0) return result;
  OpticalNoise draw(images, noise.seed);
  std::vector<Eigen::MatrixXd> moved;
  for (int d = 0; d < noise.draws; ++d) {
    const Eigen::MatrixXd of_reference = draw.b(1) / std::sqrt(noise.references);
    result.b.emplace_back(draw.b(frames));
    for (int t = 0; t < frames; ++t)
      result.b.back().col(t) = noise.image * (images.noise_of(t) * result.b.back().col(t) + of_reference.col(0));
    moved.push_back(draw.displacement(result.b.back()));
    result.force.emplace_back(frames);
    for (double& value : result.force.back()) value = noise.force * draw.scalar();
  }
  result.response = respond(model, parameters, frames, options, moved, result.force);
  // An error of the cameras' numbers is the same in all frames: it moves the measured displacement that judges and that
  // drives.
  std::vector<Eigen::MatrixXd> errors;
  for (const auto& error : noise.calibration) errors.push_back(error.leftCols(frames));
  if (!errors.empty()) result.of_cameras = respond(model, parameters, frames, options, errors, {});
  return result;
}

Eigen::VectorXd difference_noise(const NoiseDraws& draws, const GaussNewtonOptions& options) {
  const std::size_t number = draws.b.size();
  if (number < telling_draws) return {};
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(draws.force.front().size());
  for (std::size_t d = 0; d < number; ++d) squares += draws.response.reaction[d].cwiseAbs2();
  return (squares.array() / static_cast<double>(number) + options.noise_model.force * options.noise_model.force).sqrt();
}

double difference_noise(const Eigen::VectorXd& known, const GaussNewtonOptions& options, Eigen::Index t) {
  return t < known.size() ? known[t] : options.force_noise;
}

Covariance parameter_covariance(const ImageData& images, const Linearisation& at, const NormalEquations& normal,
                                const Stage& stage, const GaussNewtonOptions& options,
                                const Eigen::VectorXd& difference, const NoiseDraws& draws) {
  const auto unknowns = normal.right.size();
  const NoiseModel& noise = options.noise_model;
  const auto [inverse, undetermined] = inverse_of_seen(normal.matrix);
  const bool with_force = has_force(options.functional);
  const auto w = [&](int t) { return images.weight_of(t); };
  const auto v = [&](int t) { return with_force ? std::pow(difference_noise(difference, options, t), -2) : 0.0; };
  std::vector<int> frames;
  for (int t : stage.frames)
    if (t < at.frames) frames.push_back(t);
  const auto S = [&](int t) {
    Eigen::MatrixXd columns(at.surface.rows(), unknowns);
    for (Eigen::Index j = 0; j < unknowns; ++j) columns.col(j) = at.sensitivity[static_cast<std::size_t>(j)].col(t);
    return columns;
  };
  const auto s = [&](int t) {
    Eigen::VectorXd column = Eigen::VectorXd::Zero(unknowns);
    if (with_force)
      for (Eigen::Index j = 0; j < unknowns; ++j) column[j] = at.force_sensitivity[static_cast<std::size_t>(j)][t];
    return column;
  };
  const Eigen::MatrixXd none = Eigen::MatrixXd::Zero(unknowns, unknowns);
  Covariance result{.image = none, .force = none, .boundary = none, .calibration = none, .total = none};

  Eigen::MatrixXd of_frames = none, common = Eigen::MatrixXd::Zero(at.surface.rows(), unknowns);
  std::vector<Eigen::MatrixXd> MS(static_cast<std::size_t>(at.frames));
  for (int t : frames) {
    MS[static_cast<std::size_t>(t)] = images.M * S(t);
    of_frames += std::pow(w(t) * images.noise_of(t), 2) * S(t).transpose() * MS[static_cast<std::size_t>(t)];
    common += w(t) * S(t);
  }
  result.image = noise.image * noise.image * inverse *
                 (of_frames + common.transpose() * (images.M * common) / noise.references) * inverse;
  result.total = result.image;
  Eigen::MatrixXd of_force = none;  // where F itself is in the functional
  for (int t : frames) of_force += v(t) * v(t) * noise.force * noise.force * s(t) * s(t).transpose();
  result.force = inverse * of_force * inverse;
  if (draws.b.empty()) {
    result.total += result.force;
    return with_infinite(std::move(result), undetermined);
  }

  /// -(w S^T M dU + v s dR) of one response.
  const auto through = [&](const Eigen::MatrixXd& surface, const Eigen::VectorXd& reaction) {
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(unknowns);
    for (int t : frames)
      sum -= w(t) * MS[static_cast<std::size_t>(t)].transpose() * surface.col(t) + v(t) * s(t) * reaction[t];
    return sum;
  };

  const std::size_t number = draws.b.size();
  const Response& response = draws.response;
  Eigen::MatrixXd by_image(unknowns, static_cast<Eigen::Index>(number)), by_force = by_image, by_ends = by_image;
  for (std::size_t d = 0; d < number; ++d) {
    Eigen::VectorXd image = Eigen::VectorXd::Zero(unknowns), load = image;
    for (int t : frames) {
      image += w(t) * S(t).transpose() * draws.b[d].col(t);
      load += v(t) * s(t) * draws.force[d][t];
    }
    if (number + d < response.surface.size())
      load += through(response.surface[number + d], response.reaction[number + d]);
    const auto column = static_cast<Eigen::Index>(d);
    by_image.col(column) = inverse * image, by_force.col(column) = inverse * load,
    by_ends.col(column) = inverse * through(response.surface[d], response.reaction[d]);
  }
  const auto mean_square = [&](const Eigen::MatrixXd& x, const Eigen::MatrixXd& y) -> Eigen::MatrixXd {
    return x * y.transpose() / static_cast<double>(x.cols());
  };
  result.force = mean_square(by_force, by_force);
  result.boundary = mean_square(by_ends, by_ends);
  result.total =
      result.image + result.force + result.boundary + mean_square(by_image, by_ends) + mean_square(by_ends, by_image);

  if (noise.calibration.empty()) return with_infinite(std::move(result), undetermined);
  Eigen::MatrixXd by_cameras(unknowns, static_cast<Eigen::Index>(noise.calibration.size()));
  for (std::size_t d = 0; d < noise.calibration.size(); ++d) {
    Eigen::VectorXd sum = through(draws.of_cameras.surface[d], draws.of_cameras.reaction[d]);
    for (int t : frames) sum += w(t) * MS[static_cast<std::size_t>(t)].transpose() * noise.calibration[d].col(t);
    by_cameras.col(static_cast<Eigen::Index>(d)) = inverse * sum;
  }
  result.calibration = mean_square(by_cameras, by_cameras);
  result.total += result.calibration;
  return with_infinite(std::move(result), undetermined);
}

}  // namespace imic3d::identification
