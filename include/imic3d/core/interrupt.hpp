#pragma once
// Signals that ask a run to stop where it can go on later.

#include <csignal>
#include <stdexcept>

#include "imic3d/core/parallel.hpp"

namespace imic3d {

/// A run that was asked to stop (exit status 4); what() is the signal's name. What was computed before is kept. `collectively` keeps its type.
class Interrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// While it lives, SIGTERM and SIGUSR1 (what SLURM's --signal sends) are noted and do not end the process.
class SignalWatch {
 public:
  SignalWatch();
  ~SignalWatch();
  SignalWatch(const SignalWatch&) = delete;
  SignalWatch& operator=(const SignalWatch&) = delete;

 private:
  struct sigaction terminate_ {}, user_ {};  // what was there before
};

/// Throws Interrupted on every rank of `communicator` once a signal was noted on any of them. Collective.
void stop_if_asked(const Communicator& communicator);

}  // namespace imic3d
