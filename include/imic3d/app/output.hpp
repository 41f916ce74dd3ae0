#pragma once
// The results of a run on the root rank: results.h5, results.xdmf, result.json, pictures and the report.

#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "imic3d/app/observation.hpp"
#include "imic3d/io/run_results.hpp"

namespace imic3d::app {

/// What groups of ranks did with their time, by what they did.
using GroupTimes = std::map<std::string, std::vector<GroupTime>>;
/// Ranks, busy and idle seconds of each group.
[[nodiscard]] nlohmann::json to_json(const GroupTimes& times);
/// One line of the log for each that there is.
void say(const GroupTimes& times);

/// How a stage went, for the summary.
struct StageSummary {
  std::vector<std::string> free;
  int iterations = 0;
  int increments = 1;  ///< load increments between two frames, identification::Iterate
  bool converged = false;
  double eta = 0.0;  ///< Eq. 13, of the last step
  std::string message;
  identification::Covariance covariance;
  Eigen::VectorXd unsure;     ///< identification::FinerIncrements
  std::string unknown_noise;  ///< identification::StageResult
};

/// Says how a stage that did not converge ended.
[[nodiscard]] std::string not_converged(std::size_t stage, const StageSummary& summary);

/// Writes on rank 0 only; every function may be called on every rank.
class RunOutput {
 public:
  RunOutput(const Communicator& world, std::filesystem::path folder, const io::Case& test,
            const identification::Specimen& specimen, const Material& material, const Observation& seen);

  void dic_frame(int place, const correlation::DicFrame& frame);
  void noise(double sigma);
  void iteration(int stage, int iteration, const identification::Iterate& at);
  void identified(const std::vector<double>& values, const Eigen::MatrixXd& covariance, const std::set<int>& on_bound);
  /// Of parameters that stages found one after another; a doubt where they would move by more than noise.
  void freed_at_once(const Material& material, const std::vector<int>& free,
                     const identification::FreedAtOnce& at_once);
  enum class Finer { mesh, in_space };
  /// What parameters would change by on a finer mesh, or in space; a doubt where that is more than their standard
  /// deviations.
  void moved_by(Finer finer, const Material& material, const std::vector<int>& free, const Eigen::VectorXd& moved,
                const Eigen::MatrixXd& covariance);
  void simulation_frame(int place, const mechanics::FrameState& state);
  /// Residual of the model on every frame (collective) and the force of the DIC-driven simulation; pictures of the
  /// residual at a few frames.
  void model(const Communicator& world, const identification::ImageData& images, const identification::Record& record,
             const identification::Path& shown, const identification::Path& driven);
  /// The parameters in result.json and report.html before it is asked what a finer mesh, or a simulation in space,
  /// would change: that may take longer than all before.
  void before_checks();
  /// result.json, pictures and report.html; prints the table of the parameters. `force_left`: measured force less the
  /// reaction of the DIC-driven simulation, rms in units of its noise; `seconds`: time of the run; `groups`: what
  /// groups of ranks did with theirs, by what they did.
  void finish(const Material& material, const Eigen::MatrixXd& covariance, const std::vector<StageSummary>& stages,
              double force_left, double seconds, const GroupTimes& groups);

 private:
  void draw_residual(int t, const identification::Record& record, const identification::Path& shown) const;

  std::filesystem::path folder_;
  const io::Case& test_;
  const identification::Specimen& specimen_;
  const Observation& seen_;
  std::optional<io::ResultsFile> file_;  // on the root only
  std::vector<std::string> doubts_;
  bool in_turn_ = false;  // stages found parameters one after another
};

/// The results of a direct simulation; rank 0 writes, every function may be called on every rank.
class SimulationOutput {
 public:
  SimulationOutput(const Communicator& world, std::filesystem::path folder, const io::Case& test,
                   const identification::Specimen& specimen);
  void frame(int frame, const mechanics::FrameState& state, double force);
  void finish();  ///< result.json
  /// The same with `more` in it; returns it, nothing on other ranks than the root.
  nlohmann::json finish(const nlohmann::json& more);

 private:
  std::filesystem::path folder_;
  const identification::Specimen& specimen_;
  std::optional<io::ResultsFile> file_;
};

/// Versions for the results file.
[[nodiscard]] std::map<std::string, std::string> versions();

}  // namespace imic3d::app
