#pragma once
// Signals that ask a run to stop where it can go on later.

#include <array>
#include <csignal>
#include <stdexcept>

#include "imic3d/core/parallel.hpp"

namespace imic3d {

/// A run that was asked to stop (exit status 4); what() is the signal's name. What was computed before is kept.
/// `collectively` keeps its type.
class Interrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// While it lives, SIGTERM, SIGUSR1 (what SLURM's --signal sends), SIGINT (Ctrl-C, of which a second one ends the
/// process) and SIGHUP (a terminal that closes) are noted and do not end the process.
class SignalWatch {
 public:
  SignalWatch();
  ~SignalWatch();
  SignalWatch(const SignalWatch&) = delete;
  SignalWatch& operator=(const SignalWatch&) = delete;

 private:
  std::array<struct sigaction, 4> before_{};
};

/// Throws Interrupted on every rank of `communicator` once a signal was noted on any of them. Collective.
void stop_if_asked(const Communicator& communicator);

}  // namespace imic3d
