// imic3d check: everything that can be said about a case before any long work starts.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "imic3d/app/observation.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "curves.hpp"
#include "fields.hpp"
#include "placement.hpp"
#include "rig.hpp"
#include "several_cameras.hpp"

namespace imic3d::app {

void check(const Communicator& world, const CommandOptions& options) {
  spdlog::set_level(spdlog::level::warn);  // the plan on stdout says it all
  const io::Case test = read_case(options, {}, true, true);
  if (!test.experiments.empty() && test.cameras.empty()) {
    const auto curves = make_curves(test);
    if (!world.is_root()) return;
    fmt::print("{}\n", test.title);
    print_experiments(test);
    for (std::size_t k = 0; k < test.identify.stages.size(); ++k) fmt::print("  stage {}      {}\n", k + 1, fmt::join(test.identify.stages[k].free, ", "));
    return;
  }
  const bool several = several_cameras(test), simulated = !test.specimen.held.empty();
  for (const auto& face : seen_faces(test)) {
    if (!several) break;
    const Rig rig = make_rig(test, face.back, surface_of(test, face.back));
    if (!world.is_root()) continue;
    if (!simulated) fmt::print("{}\n", test.title);
    fmt::print("  {:12} {} elements, {} unknowns\n", face.back ? "back" : "front", rig.surface.cells.rows(), face.components * rig.surface.nodes.rows());
    for (std::size_t c = 0; c < rig.views.size(); ++c)
      fmt::print("  camera       {}: {} frames of {} x {} px, {:.4g} px per {} in the middle\n", test.cameras[static_cast<std::size_t>(rig.cameras[c])].name,
                 test.cameras[static_cast<std::size_t>(rig.cameras[c])].images.size(), rig.views[c].reference.width, rig.views[c].reference.height,
                 std::sqrt(std::abs(rig.views[c].camera->jacobian(rig.surface.nodes.colwise().mean().transpose()).leftCols<2>().determinant())), test.units.length);
    if (rig.placed)
      fmt::print("  placement    points {:.2f} px; {} of {} patches on a plane, rms {:.3g} {}; references differ by {:.3f}\n", rig.pose.points_rms, rig.pose.matched,
                 rig.pose.patches, rig.pose.plane_rms, test.units.length, test.specimen.place->shape > 0.0 ? rig.pose.rms_shape : rig.pose.rms_pose);
  }
  if (several && !simulated) return;
  const identification::Specimen specimen = make_specimen(test);
  std::size_t most_free = 0;
  for (const auto& stage : test.identify.stages) most_free = std::max(most_free, stage.free.size());
  const GroupLayout simulations(world, static_cast<int>(1 + most_free), test.identify.groups);
  const GroupLayout frames(world, std::max(1, static_cast<int>(test.frames.size())), test.dic.groups);
  std::string images = "none";
  if (test.fields) {
    const auto data = imported_fields(test, specimen);
    images = fmt::format("{} displacement fields of another program, {}", data.frames.size(), std::isfinite(data.force_noise) ? "with a load record" : "no load record");
  }
  if (!several && !test.cameras.empty() && !test.cameras.front().images.empty()) {
    const auto& camera = test.cameras.front();
    const auto reference = imaging::read_image(camera.images[static_cast<std::size_t>(test.index_of(camera.reference.front()))]);
    const auto placed = place_camera(camera, specimen.surface.mesh, reference);
    const double pixel = 1.0 / std::sqrt(std::abs(placed.linear.leftCols<2>().determinant()));
    double area = 0.0;
    const auto& surface = specimen.surface.mesh;
    for (Eigen::Index e = 0; e < surface.cells.rows(); ++e) {
      const Eigen::Vector3d d1 = surface.nodes.row(surface.cells(e, 2)) - surface.nodes.row(surface.cells(e, 0));
      const Eigen::Vector3d d2 = surface.nodes.row(surface.cells(e, 3)) - surface.nodes.row(surface.cells(e, 1));
      area += 0.5 * (d1[0] * d2[1] - d1[1] * d2[0]);
    }
    images = fmt::format("{} frames of {} x {} px, {:.6g} {} per pixel, {:.0f} pixels per element", camera.images.size(),
                         reference.width, reference.height, pixel, test.units.length,
                         area / (pixel * pixel) / static_cast<double>(surface.cells.rows()));
  }
  if (!world.is_root()) return;
  fmt::print("{}\n", test.title);
  const auto& volume = specimen.volume;
  fmt::print("  simulation   {} {}{}, {} unknowns\n", volume.cells.rows(), mesh::name(volume.type),
             test.specimen.plane_stress() ? " in plane stress" : "", mesh::dimension(volume.type) * volume.nodes.rows());
  if (!test.specimen.unused.empty()) fmt::print("  not used     {}\n", fmt::join(test.specimen.unused, ", "));
  fmt::print("  correlation  {} elements, {} unknowns\n", specimen.surface.mesh.cells.rows(), specimen.projection.rows());
  if (!several) fmt::print("  images       {}\n", images);
  for (std::size_t k = 0; k < test.identify.stages.size(); ++k)
    fmt::print("  stage {}      {} from frames {}\n", k + 1, fmt::join(test.identify.stages[k].free, ", "), io::to_text(test.identify.stages[k].frames));
  for (const auto& [effect, quantities] : test.effects)
    for (const auto& [quantity, one] : quantities)
      fmt::print("  effect       {}: {}{}{}\n", effect, quantity, one.value ? fmt::format(" {:g}", *one.value) : "", one.free ? " free" : "");
  fmt::print("  ranks        {}: simulations in {} group{}, frames of the correlation in {}\n", world.size(), simulations.groups(),
             simulations.groups() == 1 ? "" : "s", frames.groups());
}

}  // namespace imic3d::app
