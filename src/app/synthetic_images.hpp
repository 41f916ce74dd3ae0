#pragma once
// Synthetic images of a motion, made of the measured reference, and what the correlation sees of it.

#include <Eigen/Core>
#include <functional>

#include "imic3d/app/observation.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// Shown an image that was made, of a camera (from 0) of a face, and the displacement that the correlation found in it.
using ImageShown = std::function<void(std::size_t face, int camera, int frame, const imaging::Image& image,
                                      const Eigen::VectorXd& displacement)>;

/// Images of faces, of a specimen with another mesh, that move by U [its unknowns x frames, length], made of the
/// references of all cameras and correlated like the measured ones, without noise: [unknowns x frames, length]. The rim
/// of what surrounds a face moves with it, what lies farther off stands still. Collective. Throws ConvergenceError if a
/// frame cannot be correlated.
[[nodiscard]] Eigen::MatrixXd correlated_images(const Observation& seen, const io::Case& test,
                                                const Communicator& world, const identification::Specimen& specimen,
                                                const Eigen::MatrixXd& U, const ImageShown& shown = {});

}  // namespace imic3d::app
