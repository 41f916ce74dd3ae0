#pragma once
// What imic3d loop leaves behind: result.json, results.h5 and the page for a test engineer.

#include <filesystem>
#include <nlohmann/json.hpp>

#include "imic3d/app/output.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/field_experiment.hpp"

namespace imic3d::app {

/// Residual fields before and after.
struct LoopFields {
  /// measured - predicted [unknowns x frames, length]
  Eigen::MatrixXd displacement_before, displacement_after;
  Eigen::VectorXd force_before, force_after;  ///< [frames, force]
};

/// Collective.
[[nodiscard]] LoopFields loop_fields(loop::FieldExperiment& experiment, const loop::Report& report);

/// Writes result.json, results.h5 (tools/plot_loop.py), pictures and report.html to the folder and prints the verdict.
/// `light`: its own section; null where no images were correlated; `left_out`: of Observation; `groups`: what groups of
/// ranks did with their time. Rank 0 only.
void write_loop_report(const std::filesystem::path& folder, const io::Case& test,
                       const loop::FieldExperiment& experiment, const loop::Report& report, const LoopFields& fields,
                       const nlohmann::json& light, const std::string& left_out, const GroupTimes& groups,
                       double seconds);

}  // namespace imic3d::app
