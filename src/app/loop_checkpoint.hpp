#pragma once
// loop_checkpoint.h5 of `imic3d loop`: what its experiment has answered, so that --resume goes on from there.

#include <deque>
#include <filesystem>
#include <span>

#include "checkpoint_file.hpp"
#include "imic3d/loop/recorded.hpp"

namespace imic3d::app {

class LoopCheckpoint {
 public:
  /// As a CheckpointFile, of `test` and, if it is a file of several tests, of their `cases`. Collective.
  LoopCheckpoint(const Communicator& world, const std::filesystem::path& folder, const io::Case& test,
                 std::span<const io::Case> cases, bool resume);

  /// The answers of the run before, the same on every rank. Collective.
  [[nodiscard]] std::deque<loop::Answer> known();
  /// The next answer. Written now and then; stops the run if it was asked to (Interrupted). Collective.
  void keep(const loop::Answer& answer);
  /// Writes what was kept.
  void write() { file_.write(); }

 private:
  Communicator world_;
  CheckpointFile file_;
  std::size_t kept_ = 0;
};

}  // namespace imic3d::app
