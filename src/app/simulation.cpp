#include "imic3d/app/simulation.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <set>

#include "imic3d/core/log.hpp"

namespace imic3d::app {

namespace {

/// Area share of each node of the loaded end [length^2] (in plane stress of its line, [length]): the integral of its
/// shape function over the faces whose corners are all on it. A quarter of a hex8's face each; of a hex20's (flat, its
/// middles in the middle) a third for the middles and -1/12 for the corners. Half a quad4's edge each; of a quad8's two
/// thirds for the middle and a sixth for the corners.
Eigen::VectorXd end_areas(const identification::Specimen& specimen) {
  const auto& mesh = specimen.volume;
  Eigen::VectorXd share = Eigen::VectorXd::Zero(mesh.nodes.rows());
  const std::set<int> end(specimen.loaded.begin(), specimen.loaded.end());
  const mesh::Cells facets = mesh::with_middles(mesh, mesh::boundary_facets(mesh).nodes);
  const bool plane = mesh::dimension(mesh.type) == 2, quadratic = facets.cols() == 8 || facets.cols() == 3;
  const int corners = plane ? 2 : 4;
  const double of_corner = plane ? (quadratic ? 1.0 / 6.0 : 0.5) : (quadratic ? -1.0 / 12.0 : 0.25);
  const double of_middle = plane ? 2.0 / 3.0 : 1.0 / 3.0;
  for (Eigen::Index f = 0; f < facets.rows(); ++f) {
    std::array<Eigen::Vector3d, 4> x;
    bool on_end = true;
    for (int a = 0; a < corners; ++a) {
      on_end = on_end && end.contains(facets(f, a));
      x[static_cast<std::size_t>(a)] = mesh.nodes.row(facets(f, a)).transpose();
    }
    if (!on_end) continue;
    const double area = plane ? (x[1] - x[0]).norm() : 0.5 * (x[2] - x[0]).cross(x[3] - x[1]).norm();
    for (int a = 0; a < facets.cols(); ++a) share[facets(f, a)] += (a < corners ? of_corner : of_middle) * area;
  }
  return share;
}

}  // namespace

void run_simulation(const Communicator& world, const io::Case& test, const identification::Specimen& specimen,
                    const Material& material,
                    const std::function<void(int, const mechanics::FrameState&, double)>& done,
                    const std::function<double(int, double)>& beyond) {
  const io::SimulateCase& declared = *test.simulate;
  const bool force_control = declared.control == "force";
  const std::set<int> held(specimen.held.begin(), specimen.held.end()),
      loaded(specimen.loaded.begin(), specimen.loaded.end());
  const auto along = [&](int dof) { return dof % 3 == specimen.axis; };

  // Both ends along the axis; across it too if clamped, else just what keeps the specimen from turning away.
  std::set<int> dofs;
  for (int dof : specimen.displacement_dofs) {
    const bool on_loaded = loaded.contains(dof / 3), on_held = held.contains(dof / 3);
    const bool through_thickness = dof % 3 == 2;
    if (through_thickness || (along(dof) && (on_held || !force_control)) ||
        (!along(dof) && declared.clamped && (on_held || on_loaded)))
      dofs.insert(dof);
  }
  if (!declared.clamped) {  // the node of the held end nearest the axis cannot move across
    int middle = specimen.held.front();
    for (int node : specimen.held)
      if (std::abs(specimen.volume.nodes(node, 1 - specimen.axis)) <
          std::abs(specimen.volume.nodes(middle, 1 - specimen.axis)) - 1e-9)
        middle = node;
    dofs.insert(3 * middle + 1 - specimen.axis);
  }
  const std::vector<int> constrained(dofs.begin(), dofs.end());
  const Eigen::VectorXd areas = force_control ? end_areas(specimen) : Eigen::VectorXd();

  std::vector<mechanics::LoadStep> steps;
  const double front = specimen.volume.nodes.col(2).maxCoeff();
  double start = declared.time.empty() ? 0.0 : declared.time.front();
  const bool at_rest_first = specimen.volume.initial_strain.size() > 0;
  if (at_rest_first) {
    steps.push_back({.time = start,
                     .prescribed = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(constrained.size())),
                     .force = {}});
    if (force_control) steps.back().force.setZero(3 * specimen.volume.nodes.rows());
    start -= 1e-9 * (1.0 + std::abs(start));
  }
  for (std::size_t frame = 1; frame < declared.value.size(); ++frame) {
    mechanics::LoadStep step;
    step.time = frame < declared.time.size() ? declared.time[frame] : static_cast<double>(frame);
    step.prescribed.setZero(static_cast<Eigen::Index>(constrained.size()));
    const double value = declared.value[frame];
    if (force_control) {
      step.force.setZero(3 * specimen.volume.nodes.rows());
      for (int node : specimen.loaded)
        step.force[3 * node + specimen.axis] = value / specimen.section_factor * areas[node] / areas.sum();
    } else {
      for (std::size_t i = 0; i < constrained.size(); ++i) {
        if (!along(constrained[i])) continue;
        const double part =
            loaded.contains(constrained[i] / 3) ? (declared.centred ? 0.5 : 1.0) : (declared.centred ? -0.5 : 0.0);
        step.prescribed[static_cast<Eigen::Index>(i)] = part * value;
        if (beyond && loaded.contains(constrained[i] / 3))
          step.prescribed[static_cast<Eigen::Index>(i)] +=
              beyond(static_cast<int>(frame), specimen.volume.nodes(constrained[i] / 3, 2) - front);
      }
    }
    steps.push_back(std::move(step));
  }
  const mesh::Partition partition = mesh::partition(specimen.volume, world, "mechanics_");
  mechanics::Equilibrium equilibrium(partition, specimen.volume, material.law, constrained,
                                     {.increments = declared.steps_per_frame, .once = true});
  Progress progress(world, "simulation", static_cast<int>(steps.size()));
  const auto status = equilibrium.run(steps, material.values, start,
                                      [&](int t, const mechanics::FrameState& state) {
                                        double force = 0.0;
                                        for (int node : specimen.loaded)
                                          force += state.internal[3 * node + specimen.axis];
                                        done(at_rest_first ? t : t + 1, state, specimen.section_factor * force);
                                        progress.update(t + 1);
                                      },
                                      {}, {}, nullptr, {}, {.forces = 1e-9});
  if (!status.message.empty()) throw ConvergenceError(status.message);
}

}  // namespace imic3d::app
