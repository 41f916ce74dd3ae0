#include "calibration_error.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "imic3d/core/error.hpp"
#include "imic3d/imaging/calibration.hpp"

namespace imic3d::app {

Eigen::VectorXd calibration_deviations(const io::CameraCase& declared) {
  const auto& names = imaging::camera_number_names;
  Eigen::VectorXd deviations = Eigen::VectorXd::Zero(imaging::camera_numbers);
  for (const auto& [name, value] : declared.calibration_sd) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) throw InputError("cameras." + declared.name + ".calibration_sd", name, fmt::format("{}", fmt::join(names, ", ")));
    deviations[found - names.begin()] = value;
  }
  return deviations;
}

}  // namespace imic3d::app
