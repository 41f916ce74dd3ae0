#pragma once
// Synthetic images of a motion, made of the measured reference, and what the correlation sees of it.

#include <Eigen/Core>
#include <functional>

#include "imic3d/app/observation.hpp"
#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::app {

/// Shown an image that was made, of a camera (from 0) of a face, and the displacement that the correlation found in it.
using ImageShown = std::function<void(std::size_t face, int camera, int frame, const imaging::Image& image, const Eigen::VectorXd& displacement)>;

/// Images of a surface [quad4] that moves by U [2 nodes x frames, length], made of the reference of the only camera and correlated like the
/// measured ones, without noise: [2n x frames, length]. The rim of what surrounds the surface moves with it, what lies farther off stands still.
/// Collective. Throws ConvergenceError if a frame cannot be correlated.
[[nodiscard]] Eigen::MatrixXd correlated_images(const Observation& seen, const io::Case& test, const Communicator& world, const imaging::TelecentricCamera& camera,
                                                const mesh::Mesh& surface, const Eigen::MatrixXd& U, const ImageShown& shown = {});

}  // namespace imic3d::app
