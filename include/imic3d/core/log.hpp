#pragma once
// Messages and progress: from the root rank only; progress lines only on a terminal.

#include <spdlog/spdlog.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>

#include "imic3d/core/parallel.hpp"

namespace imic3d {

/// Sets up the default spdlog logger: rank 0 writes to stderr, and to the log file once there is one; the others are
/// silent.
void start_log(const Communicator& communicator);
/// Begins the log file of rank 0, with all lines so far, or goes on with the one that is there. One that cannot be
/// written (a full disk) is warned of, and does no more.
void begin_log_file(const std::filesystem::path& file, bool append = false);
/// A line for the log file alone.
void note_in_log_file(const std::string& line);

/// One line that is rewritten in place while long work goes on; silent when stderr is not a terminal.
class Progress {
 public:
  Progress(const Communicator& communicator, std::string what, int steps);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  /// Shows `done` of the steps, the time left and `detail`.
  void update(int done, const std::string& detail = {});

 private:
  bool visible_ = false;
  std::string what_;
  int steps_ = 0;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace imic3d
