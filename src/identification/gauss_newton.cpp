#include "imic3d/identification/gauss_newton.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "imic3d/core/bounded_step.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "parameter_noise.hpp"

namespace imic3d::identification {

namespace {

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

/// The largest relative change of `which` parameters between two sets of them.
double largest_move(const std::vector<double>& from, const std::vector<double>& to, const std::vector<int>& which,
                    const GaussNewtonOptions& options) {
  double move = 0.0;
  for (const int j : which)
    move = std::max(move, std::abs(to[static_cast<std::size_t>(j)] - from[static_cast<std::size_t>(j)]) /
                              std::max(scale_of(to, j, options), 1e-300));
  return move;
}

/// What the simulation leaves open of its rigid motion: the images are asked afterwards.
void settle(Path& path, const ForwardModel& model, const ImageData& images, const Eigen::MatrixXd& dic,
            const GaussNewtonOptions& options) {
  fit_rigid_motion(model.specimen(), control_of_images(options), images.M, dic, path);
}

/// The derivatives of the path with those of the rigid motion that the images fix: a fit of the surface alone, by
/// central differences.
void settle_derivatives(Path& path, const ForwardModel& model, const ImageData& images,
                        const GaussNewtonOptions& options) {
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

/// Of simulations that only lead to where the iterations begin: with steps of 10 % it moves by 1e-4. They are made
/// anew, alike, where a run is taken up within them.
constexpr mechanics::Accuracy accuracy_of_start{.forces = 1e-6, .derivatives = 1e-3};
/// Of a first linearisation whose step is long: what it leads to moves by 1e-3.
constexpr mechanics::Accuracy accuracy_of_a_long_step{.forces = 1e-4, .derivatives = 2e-2};

/// A step (Eq. 13) behind which another one follows that does not ask for the last digits.
constexpr double far_step = 3e-2;
/// Steps of so many eta_c, after which derivatives are taken for those before them: they change by as much, and move
/// what is found by that part of its standard deviation. With ten, runs that are taken up again end 4e-9 apart.
constexpr double near_steps = 4.0;

/// Of the simulations that steps follow from. What is left depends on the factors at hand, and must not show where a
/// run is taken up again without them (1e-8 of the parameters): a residual moves them by a tenth of it on the plate of
/// docs/performance.md, by 13 times as much where two parameters are hard to tell apart. Differences of perturbed
/// simulations need all digits: a Newton iteration may end just below a tolerance.
constexpr mechanics::Accuracy accuracy_of_differences{.forces = 1e-13};
/// `eta`: of the step that led there (Eq. 13).
mechanics::Accuracy accuracy_of_steps(const GaussNewtonOptions& options, double eta) {
  if (options.sensitivities == Sensitivities::perturbed) return accuracy_of_differences;
  return {.forces = eta > far_step ? 1e-9 : 1e-10, .derivatives = std::clamp(1e-3 * options.eta, 1e-9, 1e-6)};
}

/// `near`: a linearisation so near that its derivatives hold here, too; null: there is none. `increments`: 0: the
/// model's.
Linearisation linearise(ForwardModel& model, const ImageData& images, const std::vector<double>& parameters,
                        const Stage& stage, const GaussNewtonOptions& options, const mechanics::Accuracy& accuracy,
                        const Linearisation* near = nullptr, int increments = 0) {
  const int frames = stage.frames.back() + 1;
  const bool direct = options.sensitivities == Sensitivities::direct, differentiate = direct && near == nullptr,
             perturb = !direct && near == nullptr;
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
    if (options.functional == Functional::combined && perturb)
      driven = model.simulate(Control::displacement, sets, driven.front().frames);
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
      if (has_force(options.functional))
        result.force_sensitivity.emplace_back(driven.front().d_reaction[j].head(common));
      continue;
    }
    const double step = step_of(parameters, stage.free[j], options);
    result.sensitivity.emplace_back((paths[1 + j].surface.leftCols(common) - paths.front().surface.leftCols(common)) /
                                    step);
    if (has_force(options.functional))
      result.force_sensitivity.emplace_back(
          (driven[1 + j].reaction.head(common) - driven.front().reaction.head(common)) / step);
  }
  return result;
}

/// Whether what a step leads to is that of the linearisation, up to a thousandth of eta_c in the parameters. The step
/// before left what its second-order terms moved, `eta` of `before`^2; those of this step move by as much of eta^2. The
/// forces that Sec. 3.4 takes from the parameters at hand are not part of a linearisation.
bool is_straight(double eta, double before, const Linearisation& at, const Stage& stage,
                 const GaussNewtonOptions& options) {
  return options.functional == Functional::displacement_driven && options.sensitivities == Sensitivities::direct &&
         at.frames > stage.frames.back() && eta < near_steps * options.eta &&
         eta * eta * eta < 1e-3 * options.eta * before * before;
}

/// What is observed after a step so small that second-order terms do not count: no simulation is needed, nor are other
/// derivatives.
void extrapolate(Linearisation& at, const Eigen::VectorXd& step) {
  for (std::size_t j = 0; j < at.sensitivity.size(); ++j) {
    at.surface.leftCols(at.frames) += step[static_cast<Eigen::Index>(j)] * at.sensitivity[j];
    if (!at.force_sensitivity.empty()) at.reaction += step[static_cast<Eigen::Index>(j)] * at.force_sensitivity[j];
  }
}

/// Adds `times` what the measured force says. `difference`: difference_noise, as far as it is known.
void add_force(NormalEquations& sums, const Record& record, const Linearisation& at, const Stage& stage,
               const GaussNewtonOptions& options, const Eigen::VectorXd& difference, double times) {
  for (const int t : stage.frames) {
    if (t >= at.frames) continue;
    Eigen::VectorXd s(sums.right.size());
    for (Eigen::Index j = 0; j < s.size(); ++j) s[j] = at.force_sensitivity[static_cast<std::size_t>(j)][t];
    const double missing = record.force[t] - at.reaction[t],
                 weight = times * std::pow(difference_noise(difference, options, t), -2);
    sums.matrix += weight * s * s.transpose();
    sums.right += weight * s * missing;
    sums.cost += weight * missing * missing;
    sums.force += times * missing * missing;
  }
}

NormalEquations assemble(Communicator world, ForwardModel& model, const ImageData& images, const Linearisation& at,
                         const Stage& stage, const GaussNewtonOptions& options, const Eigen::VectorXd& difference) {
  const auto unknowns = static_cast<Eigen::Index>(stage.free.size());
  NormalEquations sums;
  sums.matrix.setZero(unknowns, unknowns);
  sums.right.setZero(unknowns);
  Eigen::VectorXd local = Eigen::VectorXd::Zero(unknowns * unknowns + unknowns + 5);
  Eigen::Map<Eigen::MatrixXd> matrix(local.data(), unknowns, unknowns);
  Eigen::Map<Eigen::VectorXd> right(local.data() + unknowns * unknowns, unknowns);
  auto scalars = local.tail<5>();

  const auto add = [&](std::size_t i) {
    const int t = stage.frames[i];
    if (t >= at.frames || static_cast<int>(i) % world.size() != world.rank()) return;
    const double weight = images.weight_of(t);
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
    scalars[4] += 1.0;
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
  sums.frames = static_cast<int>(std::lround(scalars[4]));
  if (has_force(options.functional)) add_force(sums, model.record(), at, stage, options, difference, 1.0);
  return sums;
}

/// Solves Eq. (10) within the bounds and the largest step.
Eigen::VectorXd step_within_bounds(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right,
                                   const std::vector<double>& parameters, const std::vector<ParameterInfo>& information,
                                   const Stage& stage, const GaussNewtonOptions& options) {
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
  for (std::size_t j = 0; j < stage.free.size(); ++j)
    parameters[static_cast<std::size_t>(stage.free[j])] += step[static_cast<Eigen::Index>(j)];
  return parameters;
}

/// Eq. (13) of a step that leads to `parameters`.
double relative_size(const Eigen::VectorXd& step, const std::vector<double>& parameters, const Stage& stage,
                     const GaussNewtonOptions& options) {
  double eta = 0.0;
  for (std::size_t j = 0; j < stage.free.size(); ++j)
    eta = std::max(eta, std::abs(step[static_cast<Eigen::Index>(j)]) /
                            std::max(scale_of(parameters, stage.free[j], options), 1e-300));
  return eta;
}

/// The parameters at which the reaction R of the DIC-driven simulation is nearest to the measured force (the ratio of
/// Sec. 2.2), up to a step that Eqs 10-12 do better: R is nearly linear in the parameters, where the displacement under
/// the whole force may be far off, or more than the specimen carries. A missing force counts as the displacement that
/// the force's own change brought at that frame.
std::vector<double> nearest_reaction(ForwardModel& model, std::vector<double> parameters,
                                     const std::vector<ParameterInfo>& information, const Stage& stage,
                                     const GaussNewtonOptions& options) {
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
      path = model
                 .simulate(Control::displacement,
                           {Run{.parameters = parameters, .free = stage.free, .accuracy = accuracy_of_start}}, frames)
                 .front();
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
      for (Eigen::Index j = 0; j < unknowns; ++j)
        s[j] = compliance(t) * path.d_reaction[static_cast<std::size_t>(j)][t];
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

void add(Linearisation& at, double times, const Addition& addition) {
  for (Eigen::Index t = 0; t < at.frames && addition.surface.cols() > 0; ++t) {
    const Eigen::Index known = std::min(t, addition.surface.cols() - 1);  // it may not reach the last frames
    at.surface.col(t) += times * addition.surface.col(known);
    at.reaction[t] += times * addition.reaction[known];
  }
}

/// What infinitely many increments add to `to` by two numbers of them, the second `times` the first: the error goes
/// with their length.
Addition extrapolate(const Linearisation& coarse, const Linearisation& fine, double times, const Linearisation& to) {
  const int frames = std::min({coarse.frames, fine.frames, to.frames});
  const double beyond = 1.0 / (times - 1.0);
  return {fine.surface.leftCols(frames) + beyond * (fine.surface - coarse.surface).leftCols(frames) -
              to.surface.leftCols(frames),
          fine.reaction.head(frames) + beyond * (fine.reaction.head(frames) - coarse.reaction.head(frames)) -
              to.reaction.head(frames)};
}

/// At the parameters of `at`, with its derivatives.
FinerIncrements find_finer_increments(Communicator world, ForwardModel& model, const ImageData& images,
                                      const StagePoint& at, const Stage& stage, const GaussNewtonOptions& options) {
  FinerIncrements finer = at.finer;
  finer.parameters = at.iterates.back().parameters;
  Linearisation coarse = at.linear;
  add(coarse, -1.0, at.finer.endless);
  const auto simulate = [&](int number) {
    return linearise(model, images, finer.parameters, stage, options, accuracy_of_steps(options, 0.0), &coarse, number);
  };
  if (finer.number > 0) {
    Linearisation second = simulate(2 * model.increments());
    Addition first = extrapolate(coarse, second, 2.0, coarse);
    const Eigen::Index frames =
        std::min({first.surface.cols(), finer.first.surface.cols(), finer.endless.surface.cols()});
    finer.endless = {
        finer.endless.surface.leftCols(frames) + first.surface.leftCols(frames) - finer.first.surface.leftCols(frames),
        finer.endless.reaction.head(frames) + first.reaction.head(frames) - finer.first.reaction.head(frames)};
    finer.first = std::move(first);
    return finer;
  }

  const auto unknowns = at.normal.right.size();
  const Eigen::MatrixXd inverse = solve_symmetric(at.normal.matrix, Eigen::MatrixXd::Identity(unknowns, unknowns));
  Linearisation last = coarse;
  int of_last = model.increments();
  Eigen::VectorXd before = inverse * at.normal.right;
  for (int number = 2 * of_last; number <= options.most_increments; number *= 2) {
    Linearisation fine = simulate(number);
    if (fine.frames == 0) break;
    finer.number = number;
    finer.endless = extrapolate(last, fine, static_cast<double>(number) / of_last, coarse);
    if (of_last == model.increments()) finer.first = finer.endless;
    Linearisation endless = coarse;
    endless.frames = static_cast<int>(finer.endless.surface.cols());
    add(endless, 1.0, finer.endless);
    const Eigen::VectorXd step =
        inverse * assemble(world, model, images, endless, stage, options, at.noise.difference).right;
    finer.unsure = (step - before).cwiseAbs();
    bool sure = true;
    for (Eigen::Index j = 0; j < unknowns; ++j) {
      const double deviation = std::sqrt(std::max(0.0, at.noise.covariance.total(j, j)));
      sure = sure &&
             finer.unsure[j] <
                 std::max(options.eta * scale_of(finer.parameters, stage.free[static_cast<std::size_t>(j)], options),
                          0.3 * deviation);
    }
    if (sure) {
      finer.unsure.resize(0);
      break;
    }
    last = std::move(fine), of_last = number, before = step;
  }
  return finer;
}

/// `normal`, with the weights of `known`, becomes that with the weights that the noise asks for.
ParameterNoise find_noise(ForwardModel& model, const ImageData& images, const Linearisation& at, const Stage& stage,
                          const GaussNewtonOptions& options, const std::vector<double>& parameters,
                          const Eigen::VectorXd& known, NormalEquations& normal) {
  ParameterNoise noise{.parameters = parameters, .covariance = {}, .difference = {}, .unknown = {}};
  NoiseDraws draws;
  try {
    draws = draw_noise(model, images, at.frames, options, parameters);
  } catch (const ConvergenceError& error) {
    noise.unknown = error.what();
  }
  noise.difference = difference_noise(draws, options);
  if (has_force(options.functional)) {
    add_force(normal, model.record(), at, stage, options, known, -1.0);
    add_force(normal, model.record(), at, stage, options, noise.difference, 1.0);
  }
  noise.covariance = parameter_covariance(images, at, normal, stage, options, noise.difference, draws);
  return noise;
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

}  // namespace

Functional functional_from(const std::string& name) {
  if (name == "force_driven") return Functional::force_driven;
  if (name == "displacement_driven") return Functional::displacement_driven;
  if (name == "combined") return Functional::combined;
  if (name == "equilibrium_gap") return Functional::equilibrium_gap;
  throw InputError("identify.functional", name, "force_driven, displacement_driven, combined, equilibrium_gap");
}

int steps_taken(const std::vector<Iterate>& iterates) {
  return static_cast<int>(
      std::count_if(iterates.begin(), iterates.end(), [](const Iterate& at) { return at.eta > 0.0; }));
}

double reaction_noise(Communicator world, ForwardModel& model, const Eigen::MatrixXd& driving,
                      const std::vector<double>& parameters) {
  // Betti: the resultant that a displacement of the ends takes is the work on it of the forces that hold the ends where
  // the loaded one moves by one.
  const Specimen& specimen = model.specimen();
  const auto& dofs = specimen.displacement_dofs;
  const double small = 1e-6 * (specimen.volume.nodes.col(specimen.axis).maxCoeff() -
                               specimen.volume.nodes.col(specimen.axis).minCoeff());
  Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(dofs.size()), 1);
  for (std::size_t i = 0; i < dofs.size(); ++i)
    if (dofs[i] % 3 == specimen.axis && std::binary_search(specimen.loaded.begin(), specimen.loaded.end(), dofs[i] / 3))
      unit(static_cast<Eigen::Index>(i), 0) = small;
  const Eigen::MatrixXd at_rest = Eigen::MatrixXd::Zero(driving.rows(), 1);
  Eigen::VectorXd holding = Eigen::VectorXd::Zero(unit.rows());
  const Solutions before = model.solutions();
  const Path path =
      model
          .simulate(Control::displacement, {{.parameters = parameters, .driving = &at_rest, .beyond = &unit}}, 1,
                    [&](int, int, const mechanics::FrameState& state) {
                      for (std::size_t i = 0; i < dofs.size(); ++i)
                        holding[static_cast<Eigen::Index>(i)] = state.internal[dofs[i]] / small;
                    })
          .front();
  model.start_from(before);
  if (path.frames < 1) throw ConvergenceError("the noise of the reaction: " + path.message);
  world.broadcast(std::span(holding.data(), dofs.size()));  // of the first group
  const Eigen::RowVectorXd resultants =
      specimen.section_factor * (holding.transpose() * (specimen.displacement_from_surface * driving));
  return std::sqrt(resultants.squaredNorm() / static_cast<double>(driving.cols()));
}

namespace {
/// Whether `step` takes back most of the step before: where a point begins to yield the residual has a kink, and steps
/// from one side to the other lead to where they came from.
bool turns_back(const Eigen::VectorXd& step, const StagePoint& at, const Stage& stage) {
  const auto count = at.iterates.size();
  if (count < 2) return false;
  Eigen::VectorXd last(step.size());
  for (Eigen::Index j = 0; j < step.size(); ++j) {
    const auto k = static_cast<std::size_t>(stage.free[static_cast<std::size_t>(j)]);
    last[j] = at.iterates[count - 1].parameters[k] - at.iterates[count - 2].parameters[k];
  }
  const Eigen::VectorXd weighed = at.normal.matrix * last;
  return step.dot(weighed) < -0.5 * last.dot(weighed);
}
}  // namespace

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
  if (options.alpha > 0.0)
    model.follow_images(images, options.alpha, at.iterates.empty() ? parameters : at.iterates.front().parameters);
  const auto note = [&](double eta, bool converged) {
    at.iterates.push_back(describe(at.normal, parameters, eta));
    at.iterates.back().message = at.linear.message;
    at.iterates.back().increments = std::max(model.increments(), at.finer.number);
    at.converged = converged;
    if (report) report(at.iterates.back());
    if (continuation.reached) continuation.reached(at);
  };

  if (at.iterates.empty()) {
    const bool direct = options.sensitivities == Sensitivities::direct,
               by_reaction = direct && control_of_images(options) == Control::force;
    if (by_reaction) parameters = nearest_reaction(model, parameters, information, stage, options);
    // Nobody knows yet how far the parameters are: coarsely first, unless they are near.
    bool coarse = direct && control_of_images(options) == Control::displacement;
    for (;; coarse = false) {
      at.linear = linearise(model, images, parameters, stage, options,
                            coarse ? accuracy_of_a_long_step : accuracy_of_steps(options, 0.0));
      if (at.linear.frames == 0)
        throw ConvergenceError("the first frame cannot be simulated: " + at.linear.message +
                               "; are force, thickness and material in the units of the case file, and the axis the "
                               "direction of the load?");
      at.normal = assemble(world, model, images, at.linear, stage, options, at.noise.difference);
      const Eigen::VectorXd step =
          step_within_bounds(at.normal.matrix, at.normal.right, parameters, information, stage, options);
      if (!coarse || relative_size(step, moved(parameters, step, stage), stage, options) > far_step) break;
    }
    note(0.0, false);
  }

  const auto may_go_on = [&] { return steps_taken(at.iterates) < options.max_iterations; };
  const auto iterate = [&] {
    // Eq. (10)
    Eigen::VectorXd step =
        step_within_bounds(at.normal.matrix, at.normal.right, parameters, information, stage, options);
    if (turns_back(step, at, stage)) step *= 0.5;
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
        at.normal = assemble(world, model, images, at.linear, stage, options, at.noise.difference);
        break;
      }
      const bool near = options.sensitivities == Sensitivities::direct && eta < near_steps * options.eta &&
                        at.linear.frames > stage.frames.back();
      at.linear =
          linearise(model, images, trial, stage, options, accuracy_of_steps(options, eta), near ? &at.linear : nullptr);
      add(at.linear, 1.0, at.finer.endless);
      at.normal = assemble(world, model, images, at.linear, stage, options, at.noise.difference);
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
    if (at.noise.parameters.empty() || largest_move(at.noise.parameters, parameters, stage.free, options) > 0.2) {
      at.noise = find_noise(model, images, at.linear, stage, options, parameters, at.noise.difference, at.normal);
      if (at.converged && has_force(options.functional) && at.noise.difference.size() > 0) {
        note(0.0, false);
        continue;
      }
    }
    if (!looks_finer || !may_go_on()) break;
    if (at.finer.number > 0 &&
        std::pow(largest_move(at.finer.parameters, parameters, stage.free, options), 2) < options.eta)
      break;
    FinerIncrements finer = find_finer_increments(world, model, images, at, stage, options);
    if (finer.number == 0) break;
    add(at.linear, -1.0, at.finer.endless), add(at.linear, 1.0, finer.endless);
    at.finer = std::move(finer);
    at.normal = assemble(world, model, images, at.linear, stage, options, at.noise.difference);
    note(0.0, false);
  }

  StageResult result{.iterates = std::move(at.iterates),
                     .covariance = std::move(at.noise.covariance),
                     .converged = at.converged,
                     .finer = std::move(at.finer),
                     .difference = std::move(at.noise.difference),
                     .unknown_noise = at.noise.unknown,
                     .message = at.linear.message};
  if (at.normal.frames < static_cast<int>(stage.frames.size()))
    result.message =
        fmt::format("{} of {} frames took part: {}", at.normal.frames, stage.frames.size(), at.linear.message);
  return result;
}

FreedAtOnce free_at_once(Communicator world, ForwardModel& model, const ImageData& images, const Stage& all,
                         const GaussNewtonOptions& options, const std::vector<double>& parameters,
                         const FinerIncrements& finer) {
  Linearisation at = linearise(model, images, parameters, all, options, accuracy_of_steps(options, 0.0));
  if (at.frames == 0) return {};
  add(at, 1.0, finer.endless);
  NormalEquations normal = assemble(world, model, images, at, all, options, {});
  ParameterNoise noise = find_noise(model, images, at, all, options, parameters, {}, normal);
  return {solve_symmetric(normal.matrix, normal.right), std::move(noise)};
}

Eigen::VectorXd moved_by_mesh(Communicator world, const OnMesh& coarse, const OnMesh& fine,
                              const Eigen::SparseMatrix<double>& onto, const Stage& stage,
                              const GaussNewtonOptions& options, const std::vector<double>& parameters,
                              const FinerIncrements& finer, const Eigen::VectorXd& difference) {
  Linearisation at =
      linearise(coarse.model, coarse.images, parameters, stage, options, accuracy_of_steps(options, 0.0));
  at.frames = std::min({at.frames, coarse.path.frames, fine.path.frames});
  if (at.frames == 0) return {};
  const auto normal = [&](const OnMesh& mesh, Linearisation there, const Addition& endless) {
    there.surface = mesh.path.surface.leftCols(at.frames), there.reaction = mesh.path.reaction.head(at.frames);
    add(there, 1.0, endless);
    return assemble(world, mesh.model, mesh.images, there, stage, options, difference);
  };
  const NormalEquations here = normal(coarse, at, finer.endless);
  for (auto& s : at.sensitivity) s = (onto * s).eval();
  return solve_symmetric(
      here.matrix,
      normal(fine, at, {.surface = onto * finer.endless.surface, .reaction = finer.endless.reaction}).right -
          here.right);
}

}  // namespace imic3d::identification
