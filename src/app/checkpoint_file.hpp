#pragma once
// The file of a run on a case, from which the run can go on.

#include <chrono>
#include <filesystem>
#include <functional>
#include <map>
#include <string>

#include "imic3d/core/parallel.hpp"
#include "imic3d/io/checkpoint.hpp"

namespace imic3d::app {

/// Rank 0 reads and writes it. A file that cannot be written is warned of, and the run goes on: what was written before
/// stays.
class CheckpointFile {
 public:
  /// With `resume` takes up what the file holds; where there is none, a line says so and the run starts anew. Without
  /// `resume` an old one is removed. `sections`: hashes of what the run depends on, asked for on rank 0. Throws
  /// InputError if the checkpoint is broken, or of another case or program. Collective.
  CheckpointFile(const Communicator& world, std::filesystem::path path,
                 const std::function<std::map<std::string, std::string>()>& sections, bool resume);

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  /// Whether there was one to go on from.
  [[nodiscard]] bool found() const { return found_; }
  /// What the file holds, or will: on rank 0; nothing on others.
  [[nodiscard]] io::Checkpoint& content() { return content_; }
  /// The same on every rank. Collective.
  [[nodiscard]] io::Checkpoint everywhere() const;
  void write();
  /// Whether it is time to write what comes often: of the time no more than a twentieth goes into that.
  [[nodiscard]] bool due() const { return std::chrono::steady_clock::now() >= next_; }

 private:
  Communicator world_;
  std::filesystem::path path_;
  io::Checkpoint content_;
  bool found_ = false;
  std::chrono::steady_clock::time_point next_{};
};

}  // namespace imic3d::app
