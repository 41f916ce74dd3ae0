#pragma once
// What the uncertainty of the cameras' numbers does to the measured displacement.

#include <Eigen/Core>
#include <vector>

#include "imic3d/app/observation.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// Declared standard deviations of a pinhole camera's numbers, in the order of imaging::camera_number_names [23]; zeros
/// where none is given. Throws InputError (unknown name).
[[nodiscard]] Eigen::VectorXd calibration_deviations(const io::CameraCase& declared);

/// Draws of the error of the measured displacement U [unknowns x frames, length] that the uncertainty of the cameras'
/// numbers (declared, or the calibration file's covariance) makes. Cameras with wrong numbers place the mesh on the
/// reference images (pinhole: its pose by least squares over the nodes, as the correlation of the references finds it),
/// so that a node stands for another point; what its image moves by is taken for its motion, again by least squares
/// over the cameras. Empty if nothing is uncertain.
[[nodiscard]] std::vector<Eigen::MatrixXd> calibration_errors(const Observation& observation, const io::Case& test,
                                                              const identification::Specimen& specimen,
                                                              const Eigen::MatrixXd& U, int draws, unsigned seed = 1);

}  // namespace imic3d::app
