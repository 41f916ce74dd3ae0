#pragma once
// The program: command line, start and end of MPI and PETSc, and the exit status.

#include <filesystem>
#include <string>

#include "imic3d/core/error.hpp"
#include "imic3d/core/parallel.hpp"

namespace imic3d::app {

/// Everything between main's braces: reads the command line, runs the command, returns its exit status (the same on
/// every rank). Errors are said once, by rank 0.
int run(int argc, char** argv);

/// What every command gets from the command line.
struct CommandOptions {
  std::filesystem::path case_file;
  std::filesystem::path output;    ///< folder of the results; empty: as the case file says
  bool resume = false;             ///< identify, loop: goes on from the checkpoint
  std::filesystem::path from, to;  ///< explain: result.json of the two sets of parameters
  /// explain: relative standard deviation of what the sets' own deviations leave out
  double tolerance = 0.01;
};

// One function per command, each in a file of its own name.
void check(const Communicator& world, const CommandOptions& options);
void simulate(const Communicator& world, const CommandOptions& options);
void virtual_test(const Communicator& world, const CommandOptions& options);
void dic(const Communicator& world, const CommandOptions& options);
void identify(const Communicator& world, const CommandOptions& options);
void loop(const Communicator& world, const CommandOptions& options);
void explain(const Communicator& world, const CommandOptions& options);
void effects(const Communicator& world, const CommandOptions& options);
void calibrate(const Communicator& world, const CommandOptions& options);
void report(const Communicator& world, const CommandOptions& options);

/// Program, git revision and the versions of the libraries, one per line.
[[nodiscard]] std::string version_text();
/// Git revision the program was built from.
[[nodiscard]] std::string revision();

}  // namespace imic3d::app
