#include "imic3d/core/interrupt.hpp"

#include <cmath>

namespace imic3d {

namespace {
volatile std::sig_atomic_t noted = 0;  // the last signal
extern "C" void note(int signal) { noted = signal; }
}  // namespace

SignalWatch::SignalWatch() {
  noted = 0;
  struct sigaction action {};
  action.sa_handler = note;
  action.sa_flags = SA_RESTART;  // no read or write is cut short
  sigemptyset(&action.sa_mask);
  sigaction(SIGTERM, &action, &terminate_);
  sigaction(SIGUSR1, &action, &user_);
}

SignalWatch::~SignalWatch() {
  sigaction(SIGTERM, &terminate_, nullptr);
  sigaction(SIGUSR1, &user_, nullptr);
}

void stop_if_asked(const Communicator& communicator) {
  const auto signal = static_cast<int>(std::lround(communicator.max(noted)));
  if (signal != 0) throw Interrupted(signal == SIGTERM ? "SIGTERM" : "SIGUSR1");
}

}  // namespace imic3d
