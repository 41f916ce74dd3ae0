#pragma once
// Messages and progress: from the root rank only; progress lines only on a terminal.

#include <chrono>
#include <memory>
#include <string>

#include <spdlog/spdlog.h>

#include "imic3d/core/parallel.hpp"

namespace imic3d {

/// Sets up the default spdlog logger: rank 0 writes to stderr (and to `file` if given), the others are silent.
void start_log(const Communicator& communicator, const std::string& file = {});

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
