#pragma once
// What a run leaves behind: results.h5, results.xdmf beside it, result.json. Used on the root rank only.
//
// results.h5 holds (F frames, N nodes and M cells of the simulation's mesh, n nodes and k cells of the DIC mesh,
// P parameters; rows are places in Case::frames, not frame numbers):
//   case/      file, text, title, held, loaded, axis         program/  git revision, versions of the libraries
//   mesh/      nodes [N,3], cells [M,8], front [:,4], node_groups/*       surface/  nodes [n,3], cells [k,4]
//   frames/    number [F], time [F], force_measured [F], force_predicted [F], images [F],
//              use [F] (0: not fitted, 1: fitted in some stage, 2: held out)
//   fields/    displacement [F,N,3], cauchy_stress [F,M,6] (11,22,33,12,23,13), von_mises [F,M], plastic_strain [F,M],
//              reaction [F,3], frames_done [F]
//   dic/       displacement [F,n,3], frames_done [F]
//   residual/  rms_dic [F], rms_model [F], element_dic [F,k], element_model [F,k], noise [1],
//              frames_done [F]
//   identification/  parameters [P], units [P], initial [P], values [P], standard_deviation [P], covariance [P,P],
//              iterations/{count [1], stage, iteration, values [:,P], eta, residual}

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "imic3d/io/case.hpp"
#include "imic3d/io/results_file.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::io {

/// What a run is going to write; decides what is declared.
struct RunPlan {
  /// e.g. {"imic3d", "0.1.0"}, {"git_revision", "9ae1877"}, {"PETSc", …}
  std::map<std::string, std::string> versions;
  /// the simulation's mesh (hexahedra, or quadrilaterals in plane stress): mesh/ and fields/
  const mesh::Mesh* volume = nullptr;
  const mesh::Mesh* surface = nullptr;    ///< the DIC mesh (quad4): surface/, dic/ and residual/
  std::vector<ParameterInfo> parameters;  ///< not empty: identification/
  int most_iterations = 500;              ///< rows kept for iterations, all stages together
};

/// Makes results.h5 and results.xdmf in `folder` (made if need be) with everything that is known beforehand. Returns
/// the file, started. Throws InputError if it cannot be written.
[[nodiscard]] ResultsFile create_results(const std::filesystem::path& folder, const Case& test, const RunPlan& plan);

/// The case file and the versions, case/ and program/ of every results file; before start().
void store_case(ResultsFile& file, const Case& test, const std::map<std::string, std::string>& versions);

/// The same for a result.json: title, case_file, case_text, program.
[[nodiscard]] nlohmann::json case_summary(const ResultsFile& file);

/// One frame of the simulation.
struct SimulationFrame {
  std::span<const double> displacement;    ///< [N x 3, length]
  std::span<const double> cauchy_stress;   ///< [M x 6, stress], cell averages
  std::span<const double> von_mises;       ///< [M, stress]
  std::span<const double> plastic_strain;  ///< [M, -], accumulated
  std::array<double, 3> reaction{};        ///< resultant on the loaded end [force]
  double force = 0.0;                      ///< predicted force along the axis [force]
};
void write_simulation_frame(ResultsFile& file, std::size_t index, const SimulationFrame& frame);

/// One frame of DIC. displacement [n x 3, length]; rms over the region and per element of f - g(x + u) [grey level].
void write_dic_frame(ResultsFile& file, std::size_t index, std::span<const double> displacement, double rms,
                     std::span<const double> element_rms);

/// Standard deviation of the images' noise [grey level].
void write_noise(ResultsFile& file, double noise);

/// The residual of the identified model.
void write_model_residual(ResultsFile& file, std::size_t index, double rms, std::span<const double> element_rms);

/// The state of the parameters after one iteration; more than the plan's `most_iterations` are not kept.
void write_iteration(ResultsFile& file, int stage, int iteration, std::span<const double> values, double eta,
                     double residual);

/// The final values [P] and covariance [P x P], NaN for parameters that were not free; `on_bound`: parameters that
/// ended on a bound.
void write_identified(ResultsFile& file, std::span<const double> values, std::span<const double> covariance,
                      const std::set<int>& on_bound = {});

/// What parameters that stages found one after another would change by, free at once, and their standard deviations
/// then [P each], NaN for others.
void write_freed_at_once(ResultsFile& file, std::span<const double> changes, std::span<const double> deviations);
/// What each parameter would change by: on a mesh that is refined once (`refined_mesh`), simulated in space
/// (`in_space`); NaN where that was not found.
void write_change(ResultsFile& file, const std::string& by, std::span<const double> changes);

/// The .xdmf for a results file, to be put beside it; opens in ParaView (with its "XDMF Reader"; the Xdmf3 readers skip
/// the fields). Its time is the frame's number, because static frames share a time. Every frame is there; those that
/// are not done are NaN. Of a loop's results the displacement that is left, before and after, and the remainder.
/// Written atomically.
void write_xdmf(const ResultsFile& file, const std::filesystem::path& path);

/// Number with its unit as {"value": …, "unit": …}; null for NaN.
[[nodiscard]] nlohmann::json quantity(double value, const std::string& unit);

/// {parameters: [names], values: [rows]} of a covariance [P x P] for those of the named parameters [P] whose variance
/// is finite; 0 where a covariance of two of them is not. Nothing where there are none.
[[nodiscard]] nlohmann::json covariance_of(const std::vector<std::string>& names, const Eigen::MatrixXd& covariance);

/// The headline numbers that a results file has: title, versions, frames, parameters with standard deviations, rms of
/// force and residual. Commands may add to it.
[[nodiscard]] nlohmann::json summary(const ResultsFile& file);

/// Writes a JSON file atomically (a temporary file is renamed). Throws InputError if the place cannot be written.
void write_json(const std::filesystem::path& path, const nlohmann::json& value);

/// Writes any text file atomically.
void write_text_file(const std::filesystem::path& path, const std::string& text);

}  // namespace imic3d::io
