#include "imic3d/identification/forward_model.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/memory.hpp"
#include "imic3d/identification/way_between_frames.hpp"

namespace imic3d::identification {

namespace {

/// U + dU/dLambda (Lambda - Lambda of the solution) at frame t.
Eigen::VectorXd predicted(const Solution& solution, std::size_t t, const std::vector<double>& wanted) {
  Eigen::VectorXd U = solution.displacement[t];
  for (std::size_t k = 0; k < solution.free.size(); ++k) {
    const auto j = static_cast<std::size_t>(solution.free[k]);
    U += (wanted[j] - solution.parameters[j]) * solution.d_displacement[t][k];
  }
  return U;
}

}  // namespace

GroupPlan plan_simulations(int ranks, Eigen::Index unknowns, int tasks, int before, int groups) {
  // Small systems are factorised by one rank after another; the messages of assembly and solution weigh less the larger
  // the system is.
  const double serial = 0.1 + 0.6 / (1.0 + static_cast<double>(unknowns) / 2e4);
  return plan_groups(ranks, {.tasks = tasks, .serial = serial, .before = before}, groups);
}

struct ForwardModel::Implementation {
  GroupLayout layout;
  GroupClock clock{layout};
  mesh::Partition partition;
  std::shared_ptr<const material::FiniteStrainLaw> law;
  mechanics::EquilibriumOptions options;
  std::array<std::unique_ptr<mechanics::Equilibrium>, 3> solver;  // by Control
  mechanics::OpticalTerm optical;
  Solutions last;        // by Control
  mechanics::Work work;  // of this group

  Implementation(Communicator world, const Specimen& specimen, std::shared_ptr<const material::FiniteStrainLaw> law_,
                 mechanics::EquilibriumOptions options_, int tasks, int groups, int before)
      : layout(world, tasks,
               plan_simulations(world.size(), mesh::dimension(specimen.volume.type) * specimen.volume.nodes.rows(),
                                tasks, before, groups)
                   .groups()),
        partition(mesh::partition(specimen.volume, layout.group(), "mechanics_")),
        law(std::move(law_)),
        options(std::move(options_)) {
    // All groups choose alike; each may have two solvers, driven by images and under forces.
    options.memory_of_solver = -0.5 * world.max(-layout.group().sum(memory_of_a_rank(world)));
  }

  mechanics::Equilibrium& equilibrium(const Specimen& specimen, Control control) {
    auto& slot = solver[static_cast<std::size_t>(control)];
    if (!slot)
      slot = std::make_unique<mechanics::Equilibrium>(partition, specimen.volume, law, specimen.dofs(control), options);
    return *slot;
  }
};

ForwardModel::ForwardModel(Communicator world, const Specimen& specimen,
                           std::shared_ptr<const material::FiniteStrainLaw> law, Record record,
                           mechanics::EquilibriumOptions options, int tasks, int groups, int before)
    : specimen_(specimen),
      record_(std::move(record)),
      impl_(std::make_unique<Implementation>(world, specimen, std::move(law), std::move(options), tasks, groups,
                                             before)) {}

ForwardModel::~ForwardModel() = default;

void ForwardModel::follow_images(const ImageData& images, double alpha, const std::vector<double>& parameters) {
  Eigen::VectorXd v = Eigen::VectorXd::Zero(3 * specimen_.volume.nodes.rows());
  for (Eigen::Index i = 0; i < specimen_.volume.nodes.rows(); ++i)
    v[3 * i + specimen_.axis] = specimen_.volume.nodes(i, specimen_.axis);
  const Eigen::SparseMatrix<double> M = specimen_.projection.transpose() * images.M * specimen_.projection;
  constexpr double strain = 1e-6;  // elastic
  double work = 0.0;
  collectively(impl_->layout.world(),
               [&] { work = impl_->equilibrium(specimen_, Control::images).internal_work(strain * v, parameters); });
  const double m0 = v.dot(M * v), k0 = work / (strain * strain);
  const double c = k0 / m0 * alpha / (1.0 - alpha);
  impl_->optical.stiffness = c * M;
  impl_->optical.force = [this, &images, c](int t, double fraction, const Eigen::VectorXd& U) -> Eigen::VectorXd {
    const Eigen::VectorXd seen = specimen_.project(U);
    Eigen::VectorXd dic = record_.surface_displacement.col(t);
    if (fraction < 1.0)  // no image between two frames: the way from one DIC displacement to the next
      dic = fraction * dic + (1.0 - fraction) * (t > 0 ? Eigen::VectorXd(record_.surface_displacement.col(t - 1))
                                                       : Eigen::VectorXd::Zero(dic.size()));
    const Eigen::VectorXd gap = dic - seen, Mgap = images.M * gap;
    const bool far = std::sqrt(images.distance(gap, Mgap)) > images.reach;
    const Eigen::VectorXd b = far || fraction < 1.0 ? Mgap : images.evaluate(t, seen, impl_->layout.group()).b;
    return c * (specimen_.projection.transpose() * b);
  };
  // Grey levels are differentiated by central differences over a twentieth of a pixel to either side.
  impl_->optical.d_force = [this, &images, c](int t, double fraction, const Eigen::VectorXd& U,
                                              const Eigen::VectorXd& dU) -> Eigen::VectorXd {
    const Eigen::VectorXd seen = specimen_.project(U), moves = specimen_.projection * dU, Mmoves = images.M * moves;
    const Eigen::VectorXd gap = record_.surface_displacement.col(t) - seen;
    const double largest = moves.lpNorm<Eigen::Infinity>();
    if (fraction < 1.0 || largest == 0.0 || std::sqrt(images.distance(gap, images.M * gap)) > images.reach)
      return -c * (specimen_.projection.transpose() * Mmoves);
    const double h = 0.05 / images.pixels_per_length / largest;
    const auto b = [&](double side) { return images.evaluate(t, seen + side * h * moves, impl_->layout.group()).b; };
    return c / (2.0 * h) * (specimen_.projection.transpose() * (b(1.0) - b(-1.0)));
  };
}

int ForwardModel::groups() const { return impl_->layout.groups(); }
int ForwardModel::increments() const { return impl_->options.increments; }
std::vector<GroupTime> ForwardModel::group_times() const { return impl_->clock.times(); }
mechanics::Work ForwardModel::work() const {
  mechanics::Work work = impl_->work;
  const bool counts = impl_->layout.group().is_root();
  for (int* number : {&work.frames, &work.passes, &work.tangents, &work.factorisations, &work.solutions,
                      &work.derivative_passes, &work.derivative_solutions})
    *number = static_cast<int>(impl_->layout.world().sum(counts ? *number : 0.0));
  return work;
}
const Solutions& ForwardModel::solutions() const { return impl_->last; }
void ForwardModel::start_from(Solutions solutions) { impl_->last = std::move(solutions); }

std::vector<Path> ForwardModel::simulate(Control control, const std::vector<Run>& runs, int frames,
                                         const FrameSink& sink, bool fields) {
  const Eigen::Index unknowns = record_.surface_displacement.rows();
  const auto steps_of = [&](const Run& run) {
    const Eigen::MatrixXd& driving = run.driving != nullptr ? *run.driving : record_.driving;
    const Eigen::VectorXd& resultant = run.resultant != nullptr ? *run.resultant : record_.force;
    std::vector<mechanics::LoadStep> steps(static_cast<std::size_t>(frames));
    Eigen::MatrixXd prescribed = specimen_.from_surface(control) * driving.leftCols(frames);
    if (run.beyond != nullptr) prescribed += run.beyond->leftCols(frames);
    const auto bends_of = [&](const Eigen::MatrixXd& displacement) {
      return bends(displacement, specimen_.dofs(control), specimen_.volume.nodes, run.straight);
    };
    const auto bend = bends_of(prescribed);
    std::vector<std::array<Eigen::MatrixXd, 2>> d_bend;
    for (const auto& direction : run.directions) {
      const double h = std::max(1e-300, 1e-6 * prescribed.norm() / std::max(1e-300, direction.prescribed.norm()));
      const auto more = bends_of(prescribed + h * direction.prescribed.leftCols(frames)),
                 less = bends_of(prescribed - h * direction.prescribed.leftCols(frames));
      d_bend.push_back({(more[0] - less[0]) / (2.0 * h), (more[1] - less[1]) / (2.0 * h)});
    }
    for (int t = 0; t < frames; ++t) {
      auto& step = steps[static_cast<std::size_t>(t)];
      step.time = record_.time[t];
      step.prescribed = prescribed.col(t);
      for (std::size_t side = 0; side < 2; ++side) {
        step.bend[side] = bend[side].col(t);
        step.d_bend[side].resize(step.prescribed.size(), static_cast<Eigen::Index>(run.directions.size()));
        for (std::size_t k = 0; k < run.directions.size(); ++k)
          step.d_bend[side].col(static_cast<Eigen::Index>(k)) = d_bend[k][side].col(t);
      }
      step.d_prescribed.resize(step.prescribed.size(), static_cast<Eigen::Index>(run.directions.size()));
      step.d_force.resize(3 * specimen_.volume.nodes.rows(), step.d_prescribed.cols());
      for (std::size_t k = 0; k < run.directions.size(); ++k) {
        const auto& direction = run.directions[k];
        step.d_prescribed.col(static_cast<Eigen::Index>(k)) = direction.prescribed.col(t);
        if (direction.force.size() > 0) step.d_force.col(static_cast<Eigen::Index>(k)) = direction.force.col(t);
      }
      if (t == 0 && std::any_of(run.directions.begin(), run.directions.end(),
                                [](const auto& direction) { return direction.section.size() > 0; })) {
        step.d_section.setZero(specimen_.volume.cells.rows(), step.d_prescribed.cols());
        for (std::size_t k = 0; k < run.directions.size(); ++k)
          if (run.directions[k].section.size() > 0)
            step.d_section.col(static_cast<Eigen::Index>(k)) = run.directions[k].section;
      }
      if (control == Control::displacement) continue;
      step.force.setZero(3 * specimen_.volume.nodes.rows());
      for (std::size_t i = 0; i < run.forces->dofs.size(); ++i)
        step.force[run.forces->dofs[i]] = resultant[t] * run.forces->pattern(static_cast<Eigen::Index>(i), t);
    }
    return steps;
  };

  const auto tasks = static_cast<int>(runs.size());
  std::vector<Path> paths(runs.size());
  for (std::size_t task = 0; task < runs.size(); ++task) {
    paths[task].surface.setZero(unknowns, frames);
    paths[task].reaction.setZero(frames);
    paths[task].d_surface.assign(runs[task].free.size() + runs[task].directions.size(),
                                 Eigen::MatrixXd::Zero(unknowns, frames));
    paths[task].d_reaction.assign(runs[task].free.size() + runs[task].directions.size(), Eigen::VectorXd::Zero(frames));
  }
  const auto resultant_of = [&](const Eigen::VectorXd& internal) {
    double resultant = 0.0;
    for (int node : specimen_.loaded) resultant += internal[3 * node + specimen_.axis];
    return specimen_.section_factor * resultant;
  };
  const Communicator world = impl_->layout.world();
  const auto runs_here = [&](int task) { return task % impl_->layout.groups() == impl_->layout.index(); };
  Solution solution{
      runs.front().parameters, runs.front().free, std::vector<Eigen::VectorXd>(static_cast<std::size_t>(frames)), {}};
  solution.d_displacement.resize(static_cast<std::size_t>(frames));
  int first_increments = 0;
  for (const Run& run : runs)
    first_increments = std::max(first_increments, run.increments > 0 ? run.increments : impl_->options.increments);
  std::vector<int> increments(static_cast<std::size_t>(frames), first_increments);
  std::vector<char> current(runs.size(), 0);  // simulated with these increments
  for (int round = 0; round < 8 && std::count(current.begin(), current.end(), 0) > 0; ++round) {
    impl_->clock.side_by_side([&] {
      auto& equilibrium = impl_->equilibrium(specimen_, control);
      for (int task = 0; task < tasks; ++task) {
        if (!runs_here(task) || current[static_cast<std::size_t>(task)] != 0) continue;
        const Run& run = runs[static_cast<std::size_t>(task)];
        Path& path = paths[static_cast<std::size_t>(task)];
        path.surface.setZero();
        path.reaction.setZero();
        Eigen::VectorXd start;
        const auto status = equilibrium.run(
            steps_of(run), run.parameters, record_.start_time,
            [&](int t, const mechanics::FrameState& state) {
              if (task == 0) {
                solution.displacement[static_cast<std::size_t>(t)] = state.displacement;
                const auto& derivatives = state.d_displacement;
                solution.d_displacement[static_cast<std::size_t>(t)].assign(
                    derivatives.begin(), derivatives.begin() + static_cast<std::ptrdiff_t>(run.free.size()));
              }
              path.surface.col(t) = specimen_.project(state.displacement);
              path.reaction[t] = resultant_of(state.internal);
              for (std::size_t k = 0; k < path.d_surface.size(); ++k) {
                path.d_surface[k].col(t) = specimen_.project(state.d_displacement[k]);
                path.d_reaction[k][t] = resultant_of(state.d_internal[k]);
              }
              if (sink) sink(task, t, state);
              stop_if_asked(impl_->layout.group());
            },
            [&](int t) -> const Eigen::VectorXd* {
              // Not from its own where images pull weakly: what hardly costs anything, such as hourglass modes, would
              // wander.
              for (const Control of :
                   {control == Control::images ? Control::displacement : control, Control::displacement}) {
                const Solution& last = impl_->last[static_cast<std::size_t>(of)];
                if (static_cast<std::size_t>(t) >= last.displacement.size()) continue;
                start = predicted(last, static_cast<std::size_t>(t), run.parameters);
                return &start;
              }
              return nullptr;
            },
            increments, control == Control::images ? &impl_->optical : nullptr, run.free, run.accuracy, sink && fields);
        impl_->work += status.work;
        path.frames = status.frames;
        path.limit_point = status.limit_point;
        path.message = status.message;
        path.newton_iterations = status.total_iterations;
        path.increments = status.increments;
        path.increments.resize(static_cast<std::size_t>(frames), 1);
      }
    });
    // The increments that suit every run, on the frames that every run reached.
    std::vector<double> taken(static_cast<std::size_t>(frames) * runs.size(), 0.0), reached(runs.size(), 0.0);
    for (int task = 0; task < tasks; ++task) {
      if (!impl_->layout.group().is_root() || !runs_here(task)) continue;
      reached[static_cast<std::size_t>(task)] = paths[static_cast<std::size_t>(task)].frames;
      for (int t = 0; t < frames; ++t)
        taken[static_cast<std::size_t>(task * frames + t)] =
            paths[static_cast<std::size_t>(task)].increments[static_cast<std::size_t>(t)];
    }
    world.sum(taken);
    world.sum(reached);
    const auto common = static_cast<std::size_t>(*std::min_element(reached.begin(), reached.end()));
    for (std::size_t t = 0; t < common; ++t)
      for (int task = 0; task < tasks; ++task)
        increments[t] = std::max(increments[t], static_cast<int>(taken[static_cast<std::size_t>(task * frames) + t]));
    for (int task = 0; task < tasks; ++task) {
      bool same = true;
      for (std::size_t t = 0; t < common; ++t)
        same = same && static_cast<int>(taken[static_cast<std::size_t>(task * frames) + t]) == increments[t];
      current[static_cast<std::size_t>(task)] = same ? 1 : 0;
    }
  }

  // Every path to every rank: the root of the group that ran it has it, the others have nothing.
  const bool group_root = impl_->layout.group().is_root();
  for (int task = 0; task < tasks; ++task) {
    Path& path = paths[static_cast<std::size_t>(task)];
    const bool mine = group_root && runs_here(task);
    const auto share = [&](auto& values) {
      if (!mine) values.setZero();
      world.sum(std::span(values.data(), static_cast<std::size_t>(values.size())));
    };
    share(path.surface), share(path.reaction);
    for (auto& values : path.d_surface) share(values);
    for (auto& values : path.d_reaction) share(values);
    path.frames = static_cast<int>(world.sum(mine ? path.frames : 0.0));
    path.limit_point = world.sum(mine && path.limit_point ? 1.0 : 0.0) > 0.5;
    path.newton_iterations = static_cast<int>(world.sum(mine ? path.newton_iterations : 0.0));
    path.increments = increments;
    const auto speaker = static_cast<int>(world.max(mine ? world.rank() : -1));
    world.broadcast(path.message, speaker);
  }
  // Run 0, on which the next series starts: within its group every rank has it.
  const auto reached = static_cast<std::size_t>(paths.front().frames);
  solution.displacement.resize(reached), solution.d_displacement.resize(reached);
  const auto from_group = [&](Eigen::VectorXd& values) {
    if (impl_->layout.groups() == 1) return;
    if (!group_root || !runs_here(0)) values.setZero(3 * specimen_.volume.nodes.rows());
    world.sum(std::span(values.data(), static_cast<std::size_t>(values.size())));
  };
  for (std::size_t t = 0; t < reached; ++t) {
    solution.d_displacement[t].resize(solution.free.size());
    from_group(solution.displacement[t]);
    for (auto& values : solution.d_displacement[t]) from_group(values);
  }
  Solution& last = impl_->last[static_cast<std::size_t>(control)];
  if (solution.free.empty() &&
      last.displacement.size() >= reached) {  // the derivatives of the series before serve the next one's start, too
    solution.free = last.free, solution.d_displacement = std::move(last.d_displacement);
    solution.d_displacement.resize(reached);
  }
  last = std::move(solution);
  return paths;
}

std::vector<ForceDistribution> ForwardModel::distribute_forces(const std::vector<Run>& runs, int frames,
                                                               std::vector<Path>& driven) {
  std::set<int> ends;
  for (const auto* end : {&specimen_.held, &specimen_.loaded})
    for (int node : *end) ends.insert({3 * node, 3 * node + 1});
  std::vector<ForceDistribution> distributions(runs.size());
  for (std::size_t run = 0; run < runs.size(); ++run) {
    distributions[run].dofs.assign(ends.begin(), ends.end());
    distributions[run].pattern.setZero(static_cast<Eigen::Index>(ends.size()), frames);
    distributions[run].d_pattern.assign(runs[run].directions.size(), distributions[run].pattern);
  }
  driven = simulate(
      Control::displacement, runs, frames,
      [&](int run, int t, const mechanics::FrameState& state) {
        auto& distribution = distributions[static_cast<std::size_t>(run)];
        const std::size_t first = runs[static_cast<std::size_t>(run)].free.size();
        for (std::size_t i = 0; i < distribution.dofs.size(); ++i) {
          distribution.pattern(static_cast<Eigen::Index>(i), t) = state.internal[distribution.dofs[i]];
          for (std::size_t k = 0; k < distribution.d_pattern.size(); ++k)
            distribution.d_pattern[k](static_cast<Eigen::Index>(i), t) =
                state.d_internal[first + k][distribution.dofs[i]];
        }
      },
      false);

  const Communicator world = impl_->layout.world();
  for (std::size_t run = 0; run < runs.size(); ++run) {
    auto& pattern = distributions[run].pattern;
    const Path& path = driven[run];
    const auto share = [&](Eigen::MatrixXd& values) {  // the group that ran it has it, the others have nothing
      if (!impl_->layout.group().is_root()) values.setZero();
      world.sum(std::span(values.data(), static_cast<std::size_t>(values.size())));
    };
    share(pattern);
    for (auto& values : distributions[run].d_pattern) share(values);
    const double small = 0.02 * path.reaction.head(path.frames).cwiseAbs().maxCoeff();
    int loaded = path.frames - 1;
    while (loaded > 0 && std::abs(path.reaction[loaded]) <= small) --loaded;
    // the frame whose reactions each takes
    std::vector<int> source(static_cast<std::size_t>(path.frames), loaded);
    for (int t = loaded; t >= 0; --t)
      source[static_cast<std::size_t>(t)] = std::abs(path.reaction[t]) > small ? loaded = t : loaded;
    const Eigen::MatrixXd reactions = pattern;
    for (int t = 0; t < path.frames; ++t)
      pattern.col(t) =
          reactions.col(source[static_cast<std::size_t>(t)]) / path.reaction[source[static_cast<std::size_t>(t)]];
    for (std::size_t k = 0; k < distributions[run].d_pattern.size(); ++k) {
      auto& derivative = distributions[run].d_pattern[k];
      const Eigen::MatrixXd d_reactions = derivative;
      for (int t = 0; t < path.frames; ++t) {
        const int from = source[static_cast<std::size_t>(t)];
        derivative.col(t) =
            (d_reactions.col(from) - path.d_reaction[runs[run].free.size() + k][from] * pattern.col(t)) /
            path.reaction[from];
      }
    }
  }
  return distributions;
}

}  // namespace imic3d::identification
