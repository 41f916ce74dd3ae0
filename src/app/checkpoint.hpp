#pragma once
// checkpoint.h5 of `imic3d identify`: what a run has reached, so that --resume goes on from there.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "checkpoint_file.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/identification/gauss_newton.hpp"

namespace imic3d::app {

/// A stage that is done.
struct StageDone {
  std::vector<double> values;  ///< of all parameters at its end
  identification::StageResult result;
};

/// What a run has reached, the same on every rank.
struct RunState {
  std::vector<correlation::DicSeries> dic;  ///< of each face
  std::optional<double> reaction_noise;     ///< identification::reaction_noise [force]
  std::vector<StageDone> stages;
  std::optional<identification::StagePoint> point;     ///< within the next stage
  std::optional<identification::Solutions> solutions;  ///< where its next simulation starts
};

/// The file; every function is called on every rank.
class RunCheckpoint {
 public:
  /// As a CheckpointFile. Collective.
  RunCheckpoint(const Communicator& world, const std::filesystem::path& folder, const io::Case& test, bool resume);

  [[nodiscard]] const RunState& found() const { return found_; }

  // Each keeps what it is given, writes the file (the first leaves that to the others) and stops the run if it was
  // asked to (Interrupted).
  void reaction_noise(double noise);
  /// Written at first, about every 10 s, when all `frames` are done, and before a stop.
  void dic(std::size_t face, const correlation::DicSeries& series, std::size_t frames);
  void stage_point(const identification::StagePoint& point, const identification::Solutions& solutions);
  /// `solutions`: where the next stage starts; none after the last stage.
  void stage_done(const StageDone& stage, const identification::Solutions* solutions);

 private:
  void put(const identification::Solutions& solutions);

  Communicator world_;
  CheckpointFile file_;
  RunState found_;
  std::size_t stages_ = 0;
  std::vector<std::size_t> kept_;  // frames of each face in the file
};

}  // namespace imic3d::app
