#pragma once
// What the uncertainty of the cameras' numbers does to the measured displacement.

#include <Eigen/Core>
#include <vector>

#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// Declared standard deviations of a pinhole camera's numbers, in the order of imaging::camera_number_names [23]; zeros where
/// none is given. Throws InputError (unknown name).
[[nodiscard]] Eigen::VectorXd calibration_deviations(const io::CameraCase& declared);

}  // namespace imic3d::app
