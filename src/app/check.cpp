// imic3d check: everything that can be said about a case before any long work starts.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "curves.hpp"
#include "fields.hpp"
#include "imic3d/app/observation.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "loop_case.hpp"
#include "rig.hpp"
#include "several_cameras.hpp"

namespace imic3d::app {

namespace {

/// How the ranks are shared out over the frames of the correlation and over the simulations.
void print_groups(int ranks, const io::Case& test, Eigen::Index unknowns, double image_pixels, double mesh_pixels) {
  const auto most_idle = [](const GroupPlan& plan) {
    return fmt::format("{}, idle up to {:.0f} %", to_text(plan),
                       100.0 * *std::max_element(plan.idle.begin(), plan.idle.end()));
  };
  fmt::print("  ranks        {}\n", ranks);
  if (image_pixels > 0.0) {
    int frames = static_cast<int>(test.frames.size());
    for (int number : test.cameras.front().reference)
      frames = std::min(frames, static_cast<int>(test.frames.size()) - 1 - test.index_of(number));
    if (frames > 0)
      fmt::print("  frames       {} correlated in {}\n", frames,
                 most_idle(correlation::plan_frames(ranks, frames, image_pixels, mesh_pixels, test.dic.groups)));
  }
  if (test.identify.stages.empty()) return;
  const auto [side_by_side, before] = simulation_tasks(test);
  fmt::print("  simulations  {} in {}\n",
             side_by_side == 1 ? "one after another" : fmt::format("nominal and {} perturbed", side_by_side - 1),
             most_idle(identification::plan_simulations(ranks, unknowns, side_by_side, before, test.identify.groups)));
}

/// What imic3d loop would look for, and how its ranks share out series of frames.
void print_loop(int ranks, const io::Case& test) {
  fmt::print("  loop         {} candidates at most, {} draws", possible_candidates(test).size(), test.loop.draws);
  if (!test.loop.leave_out.empty()) fmt::print(", left out: {}", fmt::join(test.loop.leave_out, ", "));
  if (test.experiments.empty())
    fmt::print("; series in {}",
               to_text(plan_groups(ranks, {.tasks = ranks},
                                   test.identify.groups > 0 ? test.identify.groups : std::min(64, ranks))));
  fmt::print("\n");
}

/// `loop`: it is imic3d loop that will take it.
void check_case(const Communicator& world, const io::Case& test, bool loop) {
  if (!test.experiments.empty() && test.cameras.empty()) {
    (void)doubts_of_curves(test, make_curves(test));  // said in the log
    if (!world.is_root()) return;
    fmt::print("{}\n", test.title);
    print_experiments(test);
    for (std::size_t k = 0; k < test.identify.stages.size(); ++k)
      fmt::print("  stage {}      {}\n", k + 1, fmt::join(test.identify.stages[k].free, ", "));
    if (loop) print_loop(world.size(), test);
    return;
  }
  double image_pixels = 0.0, mesh_pixels = 0.0;  // that the correlation reads, and that it compares
  const bool several = several_cameras(test), simulated = !test.specimen.held.empty();
  for (const auto& face : seen_faces(test)) {
    if (!several) break;
    const Rig rig = make_rig(test, face.back, surface_of(test, face.back));
    for (const auto& view : rig.views) {
      image_pixels += static_cast<double>(view.reference.width) * view.reference.height;
      mesh_pixels +=
          mesh::plane_area(rig.surface) *
          std::abs(view.camera->jacobian(rig.surface.nodes.colwise().mean().transpose()).leftCols<2>().determinant());
    }
    if (!world.is_root()) continue;
    if (!simulated) fmt::print("{}\n", test.title);
    fmt::print("  {:12} {} elements, {} unknowns\n", face.back ? "back" : "front", rig.surface.cells.rows(),
               face.components * rig.surface.nodes.rows());
    for (std::size_t c = 0; c < rig.views.size(); ++c)
      fmt::print("  camera       {}: {} frames of {} x {} px, {:.4g} px per {} in the middle\n",
                 test.cameras[static_cast<std::size_t>(rig.cameras[c])].name,
                 test.cameras[static_cast<std::size_t>(rig.cameras[c])].images.size(), rig.views[c].reference.width,
                 rig.views[c].reference.height,
                 std::sqrt(std::abs(rig.views[c]
                                        .camera->jacobian(rig.surface.nodes.colwise().mean().transpose())
                                        .leftCols<2>()
                                        .determinant())),
                 test.units.length);
    if (rig.placed)
      fmt::print(
          "  placement    points {:.2f} px; {} of {} patches on a plane, rms {:.3g} {}; references differ by {:.3f}\n",
          rig.pose.points_rms, rig.pose.matched, rig.pose.patches, rig.pose.plane_rms, test.units.length,
          test.specimen.place->shape > 0.0 ? rig.pose.rms_shape : rig.pose.rms_pose);
  }
  if (several && !simulated) return;
  const identification::Specimen specimen = make_specimen(test);
  std::string images = "none";
  if (test.fields) {
    const auto data = imported_fields(test, specimen);
    images = fmt::format("{} displacement fields of another program, {}", data.frames.size(),
                         std::isfinite(data.force_noise) ? "with a load record" : "no load record");
  }
  if (!several && !test.cameras.empty() && !test.cameras.front().images.empty()) {
    const auto& camera = test.cameras.front();
    const Observation seen = observe(test, specimen);  // says what is doubted of the place and of the pictures
    const auto& reference = seen.faces.front().rig->views.front().reference;
    const double pixel =
        1.0 / std::sqrt(std::abs(seen.faces.front().dic->correlation().pixels_per_length().determinant()));
    image_pixels = static_cast<double>(reference.width) * reference.height;
    mesh_pixels = mesh::plane_area(specimen.surface.mesh) / (pixel * pixel);
    images = fmt::format("{} frames of {} x {} px, {:.6g} {} per pixel, {:.0f} pixels per element",
                         camera.images.size(), reference.width, reference.height, pixel, test.units.length,
                         mesh_pixels / static_cast<double>(specimen.surface.mesh.cells.rows()));
  }
  if (!world.is_root()) return;
  fmt::print("{}\n", test.title);
  const auto& volume = specimen.volume;
  fmt::print("  simulation   {} {}{}, {} unknowns\n", volume.cells.rows(), mesh::name(volume.type),
             test.specimen.plane_stress() ? " in plane stress" : "",
             mesh::dimension(volume.type) * volume.nodes.rows());
  if (!test.specimen.unused.empty()) fmt::print("  not used     {}\n", fmt::join(test.specimen.unused, ", "));
  fmt::print("  correlation  {} elements, {} unknowns\n", specimen.surface.mesh.cells.rows(),
             specimen.projection.rows());
  if (!several) fmt::print("  images       {}\n", images);
  if (const std::string small = small_elements(
          mesh_pixels > 0.0 ? mesh_pixels / static_cast<double>(specimen.surface.mesh.cells.rows()) : INFINITY);
      !several && !small.empty() && test.dic.regularisation.value_or(0.0) == 0.0)
    spdlog::warn("{}", small);
  for (std::size_t k = 0; k < test.identify.stages.size(); ++k)
    fmt::print("  stage {}      {} from frames {}\n", k + 1, fmt::join(test.identify.stages[k].free, ", "),
               io::to_text(test.identify.stages[k].frames));
  for (const auto& [effect, quantities] : test.effects)
    for (const auto& [quantity, one] : quantities)
      fmt::print("  effect       {}: {}{}{}\n", effect, quantity, one.value ? fmt::format(" {:g}", *one.value) : "",
                 one.free ? " free" : "");
  print_groups(world.size(), test, mesh::dimension(volume.type) * volume.nodes.rows(), image_pixels, mesh_pixels);
  if (loop) print_loop(world.size(), test);
}

}  // namespace

void check(const Communicator& world, const CommandOptions& options) {
  spdlog::set_level(spdlog::level::warn);  // the plan on stdout says it all
  const io::Case test = read_case(options, {}, true, true, true);
  check_output(test, options);
  if (test.tests.empty()) {
    const bool loop = test.loop.given || test.fields;
    if (loop) check_loop_case(test);
    check_case(world, test, loop);
    return;
  }
  const auto cases = cases_of_tests(test, options, [&](const io::Case& one) { check_case(world, one, true); });
  if (world.is_root()) fmt::print("{}: {} tests\n", test.title, cases.size());
}

}  // namespace imic3d::app
