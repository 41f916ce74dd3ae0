#include "imic3d/identification/gauss_newton.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "imic3d/core/bounded_step.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"

namespace imic3d::identification {

namespace {

bool has_force(Functional functional) { return functional != Functional::force_driven; }

/// What changes of a parameter are measured by: its value, or a usual one where it is about to leave 0.
double scale_of(const std::vector<double>& parameters, int j, const GaussNewtonOptions& options) {
  const auto k = static_cast<std::size_t>(j);
  const double usual = k < options.scale.size() ? options.scale[k] : 0.0;
  return std::max(std::abs(parameters[k]), usual);
}

double step_of(const std::vector<double>& parameters, int j, const GaussNewtonOptions& options) {
  const double scale = scale_of(parameters, j, options);
  return options.perturbation * (scale > 0.0 ? scale : 1.0);
}

/// What a parameter may be off by unseen, of the standard deviation `deviation`.
double sure_enough(const std::vector<double>& parameters, int j, double deviation, const GaussNewtonOptions& options) {
  return std::max(options.eta * scale_of(parameters, j, options), 0.3 * deviation);
}

/// How the simulation is driven that the images judge.
Control control_of_images(const GaussNewtonOptions& options) {
  if (options.functional == Functional::displacement_driven) return Control::displacement;
  return options.alpha > 0.0 ? Control::images : Control::force;
}

/// What the simulation leaves open of its rigid motion: the images are asked afterwards.
void settle(Path& path, const ForwardModel& model, const ImageData& images, const Eigen::MatrixXd& dic, const GaussNewtonOptions& options) {
  fit_rigid_motion(model.specimen(), control_of_images(options), images.M, dic, path);
}

/// The derivatives of the path with those of the rigid motion that the images fix: a fit of the surface alone, by central differences.
void settle_derivatives(Path& path, const ForwardModel& model, const ImageData& images, const GaussNewtonOptions& options) {
  const double size = path.surface.norm();
  for (auto& derivative : path.d_surface) {
    const double h = 1e-4 * size / std::max(derivative.norm(), 1e-300);
    const auto moved = [&](double side) {
      Path other;
      other.frames = path.frames, other.surface = path.surface + side * h * derivative;
      settle(other, model, images, model.record().surface_displacement, options);
      return other.surface;
    };
    derivative = (moved(1.0) - moved(-1.0)) / (2.0 * h);
  }
}

/// Of simulations that only lead to where the iterations begin: with steps of 10 % it moves by 1e-4. They are made anew, alike, where a run is taken up within them.
constexpr mechanics::Accuracy accuracy_of_start{.forces = 1e-6, .derivatives = 1e-3};
/// Of a first linearisation whose step is long: what it leads to moves by 1e-3.
constexpr mechanics::Accuracy accuracy_of_a_long_step{.forces = 1e-4, .derivatives = 2e-2};

/// Of the response to noise, of which few draws tell the size.
constexpr mechanics::Accuracy accuracy_of_responses{.forces = 1e-7, .derivatives = 1e-4};

/// A step (Eq. 13) behind which another one follows that does not ask for the last digits.
constexpr double far_step = 3e-2;
/// Steps of so many eta_c, after which derivatives are taken for those before them: they change by as much, and move what is found by that part of its standard deviation.
constexpr double near_steps = 4.0;

/// Of the simulations that steps follow from. What is left depends on the factors at hand, and must not show where a run is taken up again without them (1e-8 of
/// the parameters): a residual moves them by a tenth of it on the plate of docs/performance.md, by 13 times as much where two parameters are
/// hard to tell apart. Differences of perturbed simulations need all digits: a Newton iteration may end just below a tolerance.
constexpr mechanics::Accuracy accuracy_of_differences{.forces = 1e-13};
/// `eta`: of the step that led there (Eq. 13).
mechanics::Accuracy accuracy_of_steps(const GaussNewtonOptions& options, double eta) {
  if (options.sensitivities == Sensitivities::perturbed) return accuracy_of_differences;
  return {.forces = eta > far_step ? 1e-9 : 1e-10, .derivatives = std::clamp(1e-3 * options.eta, 1e-9, 1e-6)};
}

/// `near`: a linearisation so near that its derivatives hold here, too; null: there is none. `increments`: 0: the model's.
Linearisation linearise(ForwardModel& model, const ImageData& images, const std::vector<double>& parameters, const Stage& stage,
                        const GaussNewtonOptions& options, const mechanics::Accuracy& accuracy, const Linearisation* near = nullptr, int increments = 0) {
  const int frames = stage.frames.back() + 1;
  const bool direct = options.sensitivities == Sensitivities::direct, differentiate = direct && near == nullptr, perturb = !direct && near == nullptr;
  const Run nominal{.parameters = parameters, .increments = increments, .accuracy = accuracy};
  std::vector<Run> sets(perturb ? 1 + stage.free.size() : 1, nominal);
  if (differentiate) sets.front().free = stage.free;
  if (perturb)
    for (std::size_t j = 0; j < stage.free.size(); ++j)
      sets[1 + j].parameters[static_cast<std::size_t>(stage.free[j])] += step_of(parameters, stage.free[j], options);

  Linearisation result;
  std::vector<Path> driven, paths;
  if (options.functional == Functional::displacement_driven) {
    driven = paths = model.simulate(Control::displacement, sets, frames);
  } else {
    // The forces are those of the parameters at hand (Sec. 3.4); they stay as they are when a parameter moves.
    const bool reaction = differentiate && has_force(options.functional);
    const auto distribution = model.distribute_forces({reaction ? sets.front() : nominal}, frames, driven);
    for (auto& set : sets) set.forces = &distribution.front();
    paths = model.simulate(control_of_images(options), sets, driven.front().frames);
    if (options.functional == Functional::combined && perturb) driven = model.simulate(Control::displacement, sets, driven.front().frames);
  }
  if (differentiate) settle_derivatives(paths.front(), model, images, options);
  for (auto& path : paths) settle(path, model, images, model.record().surface_displacement, options);
  int common = near != nullptr ? std::min(frames, near->frames) : frames;
  for (const auto& path : paths) common = std::min(common, path.frames);
  for (const auto& path : driven) common = std::min(common, path.frames);
  for (const auto& path : paths)
    if (!path.message.empty()) result.message = path.message;
  for (const auto& path : driven)
    if (!path.message.empty()) result.message = path.message;

  result.frames = common;
  result.surface = paths.front().surface;
  result.reaction = driven.front().reaction.head(common);
  if (near != nullptr) {
    result.sensitivity = near->sensitivity, result.force_sensitivity = near->force_sensitivity;
    for (auto& s : result.sensitivity) s.conservativeResize(Eigen::NoChange, common);
    for (auto& s : result.force_sensitivity) s.conservativeResize(common);
    return result;
  }
  for (std::size_t j = 0; j < stage.free.size(); ++j) {
    if (direct) {
      result.sensitivity.emplace_back(paths.front().d_surface[j].leftCols(common));
      if (has_force(options.functional)) result.force_sensitivity.emplace_back(driven.front().d_reaction[j].head(common));
      continue;
    }
    const double step = step_of(parameters, stage.free[j], options);
    result.sensitivity.emplace_back((paths[1 + j].surface.leftCols(common) - paths.front().surface.leftCols(common)) / step);
    if (has_force(options.functional))
      result.force_sensitivity.emplace_back((driven[1 + j].reaction.head(common) - driven.front().reaction.head(common)) / step);
  }
  return result;
}

/// Whether what a step leads to is that of the linearisation, up to a thousandth of eta_c in the parameters. The step before left what its second-order
/// terms moved, `eta` of `before`^2; those of this step move by as much of eta^2. The forces that Sec. 3.4 takes from the parameters at hand are not part of a linearisation.
bool is_straight(double eta, double before, const Linearisation& at, const Stage& stage, const GaussNewtonOptions& options) {
  return options.functional == Functional::displacement_driven && options.sensitivities == Sensitivities::direct && at.frames > stage.frames.back() &&
         eta < near_steps * options.eta && eta * eta * eta < 1e-3 * options.eta * before * before;
}

/// What is observed after a step so small that second-order terms do not count: no simulation is needed, nor are other derivatives.
void extrapolate(Linearisation& at, const Eigen::VectorXd& step) {
  for (std::size_t j = 0; j < at.sensitivity.size(); ++j) {
    at.surface.leftCols(at.frames) += step[static_cast<Eigen::Index>(j)] * at.sensitivity[j];
    if (!at.force_sensitivity.empty()) at.reaction += step[static_cast<Eigen::Index>(j)] * at.force_sensitivity[j];
  }
}

NormalEquations assemble(Communicator world, ForwardModel& model, const ImageData& images, const Linearisation& at,
                         const Stage& stage, const GaussNewtonOptions& options) {
  const auto unknowns = static_cast<Eigen::Index>(stage.free.size());
  NormalEquations sums;
  sums.matrix.setZero(unknowns, unknowns);
  sums.right.setZero(unknowns);
  Eigen::VectorXd local = Eigen::VectorXd::Zero(unknowns * unknowns + unknowns + 6);
  Eigen::Map<Eigen::MatrixXd> matrix(local.data(), unknowns, unknowns);
  Eigen::Map<Eigen::VectorXd> right(local.data() + unknowns * unknowns, unknowns);
  auto scalars = local.tail<6>();
  const double weight = 1.0 / (2.0 * images.noise * images.noise);

  const auto add = [&](std::size_t i) {
    const int t = stage.frames[i];
    if (t >= at.frames || static_cast<int>(i) % world.size() != world.rank()) return;
    const Eigen::VectorXd u = at.surface.col(t);
    const Eigen::VectorXd gap = model.record().surface_displacement.col(t) - u;
    const Eigen::VectorXd Mgap = images.M * gap;
    const double distance = images.distance(gap, Mgap);
    const ImageEvaluation seen = images.evaluate(t, u, Communicator{MPI_COMM_SELF});
    // Grey levels say where the model is wrong only within about a speckle; from afar the DIC displacement does.
    const Eigen::VectorXd b = std::sqrt(distance) < images.reach ? seen.b : Mgap;
    Eigen::MatrixXd S(u.size(), unknowns);
    for (Eigen::Index j = 0; j < unknowns; ++j) S.col(j) = at.sensitivity[static_cast<std::size_t>(j)].col(t);
    matrix += weight * (S.transpose() * (images.M * S));  // Eq. (11)
    right += weight * (S.transpose() * b);                // Eq. (12)
    scalars[0] += weight * gap.dot(Mgap);
    scalars[1] += seen.squares;
    scalars[2] += seen.pixels;
    scalars[3] += distance;
    scalars[5] += 1.0;
    if (!has_force(options.functional)) return;
    Eigen::VectorXd s(unknowns);
    for (Eigen::Index j = 0; j < unknowns; ++j) s[j] = at.force_sensitivity[static_cast<std::size_t>(j)][t];
    const double missing = model.record().force[t] - at.reaction[t];
    const double force_weight = 1.0 / (options.force_noise * options.force_noise);
    matrix += force_weight * s * s.transpose();
    right += force_weight * s * missing;
    scalars[0] += force_weight * missing * missing;
    scalars[4] += missing * missing;
  };
  collectively(world, [&] {  // an image may have become unreadable
    for (std::size_t i = 0; i < stage.frames.size(); ++i) add(i);
  });
  world.sum(std::span(local.data(), static_cast<std::size_t>(local.size())));
  sums.matrix = matrix;
  sums.right = right;
  sums.cost = scalars[0];
  sums.squares = scalars[1];
  sums.pixels = scalars[2];
  sums.distance = scalars[3];
  sums.force = scalars[4];
  sums.frames = static_cast<int>(std::lround(scalars[5]));
  return sums;
}

/// Solves Eq. (10) within the bounds and the largest step.
Eigen::VectorXd step_within_bounds(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right, const std::vector<double>& parameters,
                                   const std::vector<ParameterInfo>& information, const Stage& stage,
                                   const GaussNewtonOptions& options) {
  const auto unknowns = right.size();
  Eigen::VectorXd low(unknowns), high(unknowns);
  for (Eigen::Index j = 0; j < unknowns; ++j) {
    const auto k = static_cast<std::size_t>(stage.free[static_cast<std::size_t>(j)]);
    const double reach = options.largest_step * std::max(scale_of(parameters, static_cast<int>(k), options), 1e-12);
    // Bounds that exclude their own end (E > 0) are approached by halves.
    low[j] = std::max(-reach, 0.5 * (information[k].lower - parameters[k]) * (1.0 + 1e-12));
    high[j] = std::min(reach, 0.5 * (information[k].upper - parameters[k]) * (1.0 + 1e-12));
  }
  return bounded_step(matrix, right, low, high);
}

std::vector<double> moved(std::vector<double> parameters, const Eigen::VectorXd& step, const Stage& stage) {
  for (std::size_t j = 0; j < stage.free.size(); ++j) parameters[static_cast<std::size_t>(stage.free[j])] += step[static_cast<Eigen::Index>(j)];
  return parameters;
}

/// Eq. (13) of a step that leads to `parameters`.
double relative_size(const Eigen::VectorXd& step, const std::vector<double>& parameters, const Stage& stage, const GaussNewtonOptions& options) {
  double eta = 0.0;
  for (std::size_t j = 0; j < stage.free.size(); ++j)
    eta = std::max(eta, std::abs(step[static_cast<Eigen::Index>(j)]) / std::max(scale_of(parameters, stage.free[j], options), 1e-300));
  return eta;
}

/// The parameters at which the reaction R of the DIC-driven simulation is nearest to the measured force (the ratio of Sec. 2.2), up to a step
/// that Eqs 10-12 do better: R is nearly linear in the parameters, where the displacement under the whole force may be far off, or
/// more than the specimen carries. A missing force counts as the displacement that the force's own change brought at that frame.
std::vector<double> nearest_reaction(ForwardModel& model, std::vector<double> parameters, const std::vector<ParameterInfo>& information,
                                     const Stage& stage, const GaussNewtonOptions& options) {
  const Record& record = model.record();
  const int frames = stage.frames.back() + 1;
  const double small = 0.01 * record.force.head(frames).cwiseAbs().maxCoeff();
  const auto compliance = [&](int t) {
    Eigen::VectorXd change = record.surface_displacement.col(t);
    if (t > 0) change -= record.surface_displacement.col(t - 1);
    return change.norm() / std::hypot(record.force[t] - (t > 0 ? record.force[t - 1] : 0.0), small);
  };
  std::vector<double> best = parameters;
  double least = INFINITY;
  for (int iteration = 0; iteration < 5; ++iteration) {
    Path path;
    try {
      path = model.simulate(Control::displacement, {Run{.parameters = parameters, .free = stage.free, .accuracy = accuracy_of_start}}, frames).front();
    } catch (const ConvergenceError&) {  // no derivatives here
      break;
    }
    const auto unknowns = static_cast<Eigen::Index>(stage.free.size());
    Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(unknowns, unknowns);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(unknowns);
    double cost = path.frames < frames ? INFINITY : 0.0;
    for (int t : stage.frames) {
      if (t >= path.frames) continue;
      const double missing = compliance(t) * (record.force[t] - path.reaction[t]);
      Eigen::VectorXd s(unknowns);
      for (Eigen::Index j = 0; j < unknowns; ++j) s[j] = compliance(t) * path.d_reaction[static_cast<std::size_t>(j)][t];
      matrix += s * s.transpose();
      right += s * missing;
      cost += missing * missing;
    }
    if (!(cost < least)) break;
    least = cost, best = parameters;
    const Eigen::VectorXd step = step_within_bounds(matrix, right, parameters, information, stage, options);
    parameters = moved(parameters, step, stage);
    if (!(relative_size(step, parameters, stage, options) > std::max(1e-2, 10.0 * options.eta))) break;
  }
  return best;
}

void add(Linearisation& at, double times, const FinerIncrements& finer) {
  for (Eigen::Index t = 0; t < at.frames && finer.number > 0; ++t) {
    const Eigen::Index known = std::min(t, finer.surface.cols() - 1);  // they may not have carried the last frames
    at.surface.col(t) += times * finer.surface.col(known);
    at.reaction[t] += times * finer.reaction[known];
  }
}

/// At the parameters of `at`, with its derivatives.
FinerIncrements find_finer_increments(Communicator world, ForwardModel& model, const ImageData& images, const StagePoint& at, const Stage& stage, const GaussNewtonOptions& options) {
  FinerIncrements finer{.parameters = at.iterates.back().parameters};
  const auto unknowns = at.normal.right.size();
  const Eigen::MatrixXd inverse = solve_symmetric(at.normal.matrix, Eigen::MatrixXd::Identity(unknowns, unknowns));
  Linearisation coarse = at.linear;
  add(coarse, -1.0, at.finer);
  Linearisation last = coarse;
  int of_last = model.increments();
  Eigen::VectorXd before = inverse * at.normal.right;
  for (int number = std::max(2 * of_last, at.finer.number / 2); number <= options.most_increments; number *= 2) {
    Linearisation fine = linearise(model, images, finer.parameters, stage, options, accuracy_of_steps(options, 0.0), &coarse, number);
    const int frames = fine.frames = std::min(fine.frames, last.frames);
    if (frames == 0) break;
    const double beyond = 1.0 / (static_cast<double>(number) / of_last - 1.0);  // the error goes with their length
    Linearisation endless = fine;
    endless.surface.leftCols(frames) += beyond * (fine.surface - last.surface).leftCols(frames);
    endless.reaction.head(frames) += beyond * (fine.reaction.head(frames) - last.reaction.head(frames));
    finer.number = number;
    finer.surface = (endless.surface - coarse.surface).leftCols(frames), finer.reaction = endless.reaction.head(frames) - coarse.reaction.head(frames);
    const Eigen::VectorXd step = inverse * assemble(world, model, images, endless, stage, options).right;
    finer.unsure = (step - before).cwiseAbs();
    bool sure = true;
    for (Eigen::Index j = 0; j < unknowns; ++j)
      sure = sure && finer.unsure[j] < sure_enough(finer.parameters, stage.free[static_cast<std::size_t>(j)], std::sqrt(inverse(j, j)), options);
    if (sure) {
      finer.unsure.resize(0);
      break;
    }
    last = std::move(fine), of_last = number, before = step;
  }
  return finer;
}

/// Whether what is known of finer increments holds here, too.
bool is_known(const FinerIncrements& finer, const std::vector<double>& parameters, const Stage& stage, const GaussNewtonOptions& options) {
  double moved = 0.0;
  for (const int j : stage.free)
    moved = std::max(moved, std::abs(parameters[static_cast<std::size_t>(j)] - finer.parameters[static_cast<std::size_t>(j)]) / std::max(scale_of(parameters, j, options), 1e-300));
  return moved * moved < options.eta;
}

Iterate describe(const NormalEquations& normal, const std::vector<double>& parameters, double eta) {
  const double frames = std::max(1, normal.frames);
  return {.parameters = parameters,
          .eta = eta,
          .displacement_rms = std::sqrt(normal.distance / frames),
          .image_rms = std::sqrt(normal.squares / std::max(1.0, normal.pixels)),
          .force_rms = std::sqrt(normal.force / frames),
          .cost = normal.cost / frames,
          .frames = normal.frames,
          .message = {}};
}

/// Noise of b_DIC: columns of standard deviation one, b b^T = M on average [unknowns x columns].
class OpticalNoise {
 public:
  // P M P^T = L D L^T
  OpticalNoise(const ImageData& images, unsigned seed) : factor_(images.held.size() > 0 ? Eigen::SparseMatrix<double>(images.M + images.held) : images.M), random_(seed) {}
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

/// What small errors of that which drives a simulation do to what is observed, in the first order: by each error, those of the ends first. Up to rigid motions that
/// the images fix: to these the derivatives by the parameters are orthogonal, in the norm of M.
struct Response {
  std::vector<Eigen::MatrixXd> surface;   ///< [unknowns x frames, length]
  std::vector<Eigen::VectorXd> reaction;  ///< of the DIC-driven simulation [frames, force]
};

/// `ends`: errors of the measured displacement that drives the ends [unknowns x frames, length]; `loads`: of the measured force [frames, force].
Response respond(ForwardModel& model, const std::vector<double>& parameters, int frames, const GaussNewtonOptions& options,
                 std::span<const Eigen::MatrixXd> ends, std::span<const Eigen::VectorXd> loads) {
  const Control control = control_of_images(options);
  const auto& record = model.record();
  const Specimen& specimen = model.specimen();
  const bool forces = control != Control::displacement, direct = options.sensitivities == Sensitivities::direct;
  const std::size_t both = ends.size() + (forces ? loads.size() : 0);
  std::vector<Eigen::MatrixXd> driving;
  for (const auto& error : ends) driving.push_back(options.noise_model.driving ? options.noise_model.driving(error) : error);
  const auto require_all = [&](const std::vector<Path>& paths) {
    for (const Path& path : paths)
      if (path.frames < frames) throw ConvergenceError(path.message);
  };

  std::vector<Path> driven, paths;
  if (direct) {
    Run run{.parameters = parameters, .accuracy = accuracy_of_responses};
    for (const auto& error : driving) run.directions.push_back({.prescribed = specimen.from_surface(Control::displacement) * error});
    if (!forces) {
      driven = paths = model.simulate(Control::displacement, {run}, frames);
    } else {
      const auto distribution = model.distribute_forces({run}, frames, driven).front();
      Run loaded{.parameters = parameters, .forces = &distribution, .accuracy = accuracy_of_responses};
      const auto on_the_ends = [&](const auto& of_frame) {
        std::vector<Eigen::Triplet<double>> entries;
        for (int t = 0; t < frames; ++t) {
          const Eigen::VectorXd column = of_frame(t);
          for (std::size_t i = 0; i < distribution.dofs.size(); ++i) entries.emplace_back(distribution.dofs[i], t, column[static_cast<Eigen::Index>(i)]);
        }
        Eigen::SparseMatrix<double> force(3 * specimen.volume.nodes.rows(), frames);
        force.setFromTriplets(entries.begin(), entries.end());
        return force;
      };
      for (std::size_t k = 0; k < ends.size(); ++k)
        loaded.directions.push_back({.prescribed = specimen.from_surface(control) * driving[k], .force = on_the_ends([&](int t) { return record.force[t] * distribution.d_pattern[k].col(t); })});
      const Eigen::MatrixXd held = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(specimen.dofs(control).size()), frames);
      for (const auto& error : loads) loaded.directions.push_back({.prescribed = held, .force = on_the_ends([&](int t) { return error[t] * distribution.pattern.col(t); })});
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
    for (const auto& resultant : resultants) runs.push_back({.parameters = parameters, .forces = &distributions.front(), .resultant = &resultant});
    paths = model.simulate(control, runs, frames);
  }
  require_all(driven), require_all(paths);
  Response response;
  for (std::size_t k = 1; k < paths.size(); ++k) {
    response.surface.emplace_back(paths[k].surface - paths[0].surface);
    response.reaction.emplace_back(k <= ends.size() ? Eigen::VectorXd(driven[k].reaction - driven[0].reaction) : Eigen::VectorXd(Eigen::VectorXd::Zero(frames)));
  }
  return response;
}

/// Noise of the measurement, taken through the last linearisation: dLambda = A^-1 sum_t [w S^T (b_t - M dU_t) + v s (dF_t - dR_t)],
/// A the matrix of Eq. 10 with the weights w and v of images and force. b_t, the noise of frame and reference, is known:
/// its part is Eq. 14, with the reference's noise as what it is, common to all frames. dU and dR, what the simulation
/// makes of a noisy force and of ends driven by a noisy displacement, are the response to draws of it.
Covariance covariance(ForwardModel& model, const ImageData& images, const Linearisation& at, const NormalEquations& normal,
                      const Stage& stage, const GaussNewtonOptions& options, const std::vector<double>& parameters) {
  const auto unknowns = normal.right.size();
  const NoiseModel& noise = options.noise_model;
  const Eigen::MatrixXd inverse = solve_symmetric(normal.matrix, Eigen::MatrixXd::Identity(unknowns, unknowns));
  const double w = 1.0 / (2.0 * images.noise * images.noise), v = has_force(options.functional) ? 1.0 / (options.force_noise * options.force_noise) : 0.0;
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
    if (v > 0.0)
      for (Eigen::Index j = 0; j < unknowns; ++j) column[j] = at.force_sensitivity[static_cast<std::size_t>(j)][t];
    return column;
  };
  const Eigen::MatrixXd none = Eigen::MatrixXd::Zero(unknowns, unknowns);
  Covariance result{.image = none, .force = none, .boundary = none, .calibration = none, .total = none};

  Eigen::MatrixXd of_frames = none, common = Eigen::MatrixXd::Zero(at.surface.rows(), unknowns);
  std::vector<Eigen::MatrixXd> MS(static_cast<std::size_t>(at.frames));
  for (int t : frames) {
    MS[static_cast<std::size_t>(t)] = images.M * S(t);
    of_frames += S(t).transpose() * MS[static_cast<std::size_t>(t)];
    common += S(t);
  }
  result.image = w * w * noise.image * noise.image * inverse *
                 (of_frames + common.transpose() * (images.M * common) / noise.references) * inverse;
  result.total = result.image;
  Eigen::MatrixXd of_force = none;  // where F itself is in the functional
  for (int t : frames) of_force += v * v * noise.force * noise.force * s(t) * s(t).transpose();
  result.force = inverse * of_force * inverse;
  if (noise.draws == 0) {
    result.total += result.force;
    return result;
  }

  // Draws: noise of b, of the DIC displacement on the ends that follows from it, and of the force.
  OpticalNoise draw(images, noise.seed);
  const auto draws = static_cast<std::size_t>(noise.draws);
  const int last = at.frames;
  std::vector<Eigen::MatrixXd> b(draws), moved(draws);
  std::vector<Eigen::VectorXd> force(draws, Eigen::VectorXd(last));
  for (std::size_t d = 0; d < draws; ++d) {
    const Eigen::MatrixXd of_reference = draw.b(1) / std::sqrt(noise.references);
    b[d] = noise.image * (draw.b(last).colwise() + of_reference.col(0));
    moved[d] = draw.displacement(b[d]);
    for (double& value : force[d]) value = noise.force * draw.scalar();
  }
  /// -(w S^T M dU + v s dR) of one response.
  const auto through = [&](const Eigen::MatrixXd& surface, const Eigen::VectorXd& reaction) {
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(unknowns);
    for (int t : frames) sum -= w * MS[static_cast<std::size_t>(t)].transpose() * surface.col(t) + v * s(t) * reaction[t];
    return sum;
  };

  const Response response = respond(model, parameters, last, options, moved, force);
  Eigen::MatrixXd by_image(unknowns, noise.draws), by_force = by_image, by_ends = by_image;
  for (Eigen::Index d = 0; d < noise.draws; ++d) {
    const auto k = static_cast<std::size_t>(d);
    Eigen::VectorXd image = Eigen::VectorXd::Zero(unknowns), load = image;
    for (int t : frames) {
      image += w * S(t).transpose() * b[k].col(t);
      load += v * s(t) * force[k][t];
    }
    if (draws + k < response.surface.size()) load += through(response.surface[draws + k], response.reaction[draws + k]);
    by_image.col(d) = inverse * image, by_force.col(d) = inverse * load, by_ends.col(d) = inverse * through(response.surface[k], response.reaction[k]);
  }
  const auto mean_square = [&](const Eigen::MatrixXd& x, const Eigen::MatrixXd& y) -> Eigen::MatrixXd { return x * y.transpose() / static_cast<double>(x.cols()); };
  result.force = mean_square(by_force, by_force);
  result.boundary = mean_square(by_ends, by_ends);
  result.total = result.image + result.force + result.boundary + mean_square(by_image, by_ends) + mean_square(by_ends, by_image);

  // An error of the cameras' numbers is the same in all frames: it moves the measured displacement that judges and that drives.
  if (noise.calibration.empty()) return result;
  std::vector<Eigen::MatrixXd> errors;
  for (const auto& error : noise.calibration) errors.push_back(error.leftCols(last));
  const Response of_cameras = respond(model, parameters, last, options, errors, {});
  Eigen::MatrixXd by_cameras(unknowns, static_cast<Eigen::Index>(errors.size()));
  for (std::size_t d = 0; d < errors.size(); ++d) {
    Eigen::VectorXd sum = through(of_cameras.surface[d], of_cameras.reaction[d]);
    for (int t : frames) sum += w * MS[static_cast<std::size_t>(t)].transpose() * errors[d].col(t);
    by_cameras.col(static_cast<Eigen::Index>(d)) = inverse * sum;
  }
  result.calibration = mean_square(by_cameras, by_cameras);
  result.total += result.calibration;
  return result;
}

}  // namespace

Functional functional_from(const std::string& name) {
  if (name == "force_driven") return Functional::force_driven;
  if (name == "displacement_driven") return Functional::displacement_driven;
  if (name == "combined") return Functional::combined;
  if (name == "equilibrium_gap") return Functional::equilibrium_gap;
  throw InputError("identify.functional", name, "force_driven, displacement_driven, combined, equilibrium_gap");
}

double reaction_noise(Communicator world, ForwardModel& model, const Eigen::MatrixXd& driving, const std::vector<double>& parameters) {
  // Betti: the resultant that a displacement of the ends takes is the work on it of the forces that hold the ends where the loaded one moves by one.
  const Specimen& specimen = model.specimen();
  const auto& dofs = specimen.displacement_dofs;
  const double small = 1e-6 * (specimen.volume.nodes.col(specimen.axis).maxCoeff() - specimen.volume.nodes.col(specimen.axis).minCoeff());
  Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(dofs.size()), 1);
  for (std::size_t i = 0; i < dofs.size(); ++i)
    if (dofs[i] % 3 == specimen.axis && std::binary_search(specimen.loaded.begin(), specimen.loaded.end(), dofs[i] / 3)) unit(static_cast<Eigen::Index>(i), 0) = small;
  const Eigen::MatrixXd at_rest = Eigen::MatrixXd::Zero(driving.rows(), 1);
  Eigen::VectorXd holding = Eigen::VectorXd::Zero(unit.rows());
  const Solutions before = model.solutions();
  const Path path = model.simulate(Control::displacement, {{.parameters = parameters, .driving = &at_rest, .beyond = &unit}}, 1, [&](int, int, const mechanics::FrameState& state) {
    for (std::size_t i = 0; i < dofs.size(); ++i) holding[static_cast<Eigen::Index>(i)] = state.internal[dofs[i]] / small;
  }).front();
  model.start_from(before);
  if (path.frames < 1) throw ConvergenceError("the noise of the reaction: " + path.message);
  world.broadcast(std::span(holding.data(), dofs.size()));  // of the first group
  const Eigen::RowVectorXd resultants = specimen.section_factor * (holding.transpose() * (specimen.displacement_from_surface * driving));
  return std::sqrt(resultants.squaredNorm() / static_cast<double>(driving.cols()));
}

StageResult gauss_newton(Communicator world, ForwardModel& model, const ImageData& images,
                         const std::vector<ParameterInfo>& information, const Stage& stage,
                         const GaussNewtonOptions& options, std::vector<double>& parameters,
                         const std::function<void(const Iterate&)>& report, const Continuation& continuation) {
  if (options.sensitivities == Sensitivities::direct && !model.differentiable())
    throw std::invalid_argument("gauss_newton: direct sensitivities of hex8s elements");
  StagePoint at;
  if (continuation.from != nullptr) {
    at = *continuation.from;
    parameters = at.iterates.back().parameters;
  }
  if (options.alpha > 0.0) model.follow_images(images, options.alpha, at.iterates.empty() ? parameters : at.iterates.front().parameters);
  const auto note = [&](double eta, bool converged) {
    at.iterates.push_back(describe(at.normal, parameters, eta));
    at.iterates.back().message = at.linear.message;
    at.iterates.back().increments = std::max(model.increments(), at.finer.number);
    at.converged = converged;
    if (report) report(at.iterates.back());
    if (continuation.reached) continuation.reached(at);
  };

  if (at.iterates.empty()) {
    const bool direct = options.sensitivities == Sensitivities::direct, by_reaction = direct && control_of_images(options) == Control::force;
    if (by_reaction) parameters = nearest_reaction(model, parameters, information, stage, options);
    // Nobody knows yet how far the parameters are: coarsely first, unless they are near.
    bool coarse = direct && control_of_images(options) == Control::displacement;
    for (;; coarse = false) {
      at.linear = linearise(model, images, parameters, stage, options, coarse ? accuracy_of_a_long_step : accuracy_of_steps(options, 0.0));
      if (at.linear.frames == 0) throw ConvergenceError("the first frame cannot be simulated: " + at.linear.message);
      at.normal = assemble(world, model, images, at.linear, stage, options);
      const Eigen::VectorXd step = step_within_bounds(at.normal.matrix, at.normal.right, parameters, information, stage, options);
      if (!coarse || relative_size(step, moved(parameters, step, stage), stage, options) > far_step) break;
    }
    note(0.0, false);
  }

  const auto may_go_on = [&] { return static_cast<int>(at.iterates.size()) <= options.max_iterations; };
  const auto iterate = [&] {
    Eigen::VectorXd step = step_within_bounds(at.normal.matrix, at.normal.right, parameters, information, stage, options);  // Eq. (10)
    const double before = at.iterates.back().cost;
    const int frames_before = at.iterates.back().frames;
    double eta = 0.0;
    for (int halving = 0;; ++halving) {
      const auto trial = moved(parameters, step, stage);
      eta = relative_size(step, trial, stage, options);  // Eq. (13)
      // A shortened step starts from where `linear` no longer is.
      if (halving == 0 && (eta < options.eta || is_straight(eta, at.iterates.back().eta, at.linear, stage, options))) {
        parameters = trial;
        extrapolate(at.linear, step);
        at.normal = assemble(world, model, images, at.linear, stage, options);
        break;
      }
      const bool near = options.sensitivities == Sensitivities::direct && eta < near_steps * options.eta && at.linear.frames > stage.frames.back();
      at.linear = linearise(model, images, trial, stage, options, accuracy_of_steps(options, eta), near ? &at.linear : nullptr);
      add(at.linear, 1.0, at.finer);
      at.normal = assemble(world, model, images, at.linear, stage, options);
      const double after = at.normal.frames > 0 ? at.normal.cost / at.normal.frames : INFINITY;
      // Small steps are taken as they are: the cost no longer tells them apart from the noise.
      const bool acceptable = after <= 1.02 * before || at.normal.frames > frames_before || eta < 10.0 * options.eta;
      if ((acceptable && at.normal.frames >= frames_before) || halving >= 4) {
        parameters = trial;
        break;
      }
      step *= 0.5;
    }
    note(eta, eta < options.eta);
  };

  const bool looks_finer = options.most_increments > model.increments();
  for (;;) {
    while (!at.converged && may_go_on()) iterate();
    if (!looks_finer || !may_go_on() || (at.finer.number > 0 && is_known(at.finer, parameters, stage, options))) break;
    FinerIncrements finer = find_finer_increments(world, model, images, at, stage, options);
    if (finer.number == 0) break;
    add(at.linear, -1.0, at.finer), add(at.linear, 1.0, finer);
    at.finer = std::move(finer);
    at.normal = assemble(world, model, images, at.linear, stage, options);
    note(0.0, false);
  }

  StageResult result{.iterates = std::move(at.iterates), .covariance = {}, .converged = at.converged, .unsure = at.finer.unsure, .unknown_noise = {}, .message = at.linear.message};
  try {
    result.covariance = covariance(model, images, at.linear, at.normal, stage, options, parameters);
  } catch (const ConvergenceError& error) {
    result.unknown_noise = error.what();
    GaussNewtonOptions of_images = options;
    of_images.noise_model.draws = 0;
    result.covariance = covariance(model, images, at.linear, at.normal, stage, of_images, parameters);
  }
  if (at.normal.frames < static_cast<int>(stage.frames.size()))
    result.message = fmt::format("{} of {} frames took part: {}", at.normal.frames, stage.frames.size(), at.linear.message);
  return result;
}

}  // namespace imic3d::identification
