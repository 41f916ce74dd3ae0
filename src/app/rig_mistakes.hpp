#pragma once
// What a rig whose cameras do not agree may have been mistaken in.

#include <span>
#include <string>

#include "imic3d/correlation/specimen_pose.hpp"

namespace imic3d::app {

/// Throws InputError where two cameras have the same reference, or the same place in the calibration.
void require_different(std::span<const correlation::RigView> views);

/// The mistake in the declaration of a rig without which the cameras' references agree on the mesh, in words; empty if
/// none of the usual ones is it: cameras, their lenses or images exchanged, poses the other way round, lengths in
/// another unit, images of another size. `left`: by how much the references differ as declared (SpecimenPose), infinite
/// where no pose is found.
[[nodiscard]] std::string likely_mistake(const mesh::Mesh& face, std::span<const correlation::RigView> views,
                                         std::span<const correlation::PlacedPoint> points,
                                         const correlation::PoseOptions& options, double left);

}  // namespace imic3d::app
