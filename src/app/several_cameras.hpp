#pragma once
// imic3d dic with perspective cameras, one or several.

#include <string>

#include "imic3d/app/program.hpp"
#include "imic3d/core/parallel.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/correlation/specimen_pose.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// Whether a case has several cameras, or a perspective one.
[[nodiscard]] bool several_cameras(const io::Case& test);

/// Throws InputError if it has: for the commands that take one telecentric camera.
void require_one_telecentric(const io::Case& test, const std::string& command);

/// 3 if several cameras see the displacement through the plane, else 2: telecentric ones face the specimen.
[[nodiscard]] int unknowns_per_node(const io::Case& test);

/// What the cameras see of the specimen's surface.
struct Rig {
  mesh::Mesh surface;  ///< with its measured shape
  std::vector<correlation::View> views;
  std::vector<int> references;  ///< images averaged to each view's reference
  std::vector<bool> noise_is_measured;
  correlation::SpecimenPose pose;  ///< of the specimen in front of the pinhole cameras
};
/// Reads the references, places the cameras. Throws InputError.
[[nodiscard]] Rig make_rig(const io::Case& test);

/// The displacement of every frame; writes results.h5, results.xdmf, result.json, motion.csv, pictures.
void dic_with_several(const Communicator& world, const CommandOptions& options, const io::Case& test);

}  // namespace imic3d::app
