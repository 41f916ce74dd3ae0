#include "imic3d/core/interrupt.hpp"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <iterator>

namespace imic3d {

namespace {
volatile std::sig_atomic_t noted = 0;  // the last signal
extern "C" void note(int signal) {
  noted = signal;
  std::signal(SIGINT, SIG_DFL);  // who asks twice does not want to wait
}
constexpr int watched[] = {SIGTERM, SIGUSR1, SIGINT, SIGHUP};
constexpr const char* names[] = {"SIGTERM", "SIGUSR1", "SIGINT", "SIGHUP"};
}  // namespace

SignalWatch::SignalWatch() {
  noted = 0;
  struct sigaction action {};
  action.sa_handler = note;
  action.sa_flags = SA_RESTART;  // no read or write is cut short
  sigemptyset(&action.sa_mask);
  for (std::size_t i = 0; i < before_.size(); ++i) {
    sigaction(watched[i], nullptr, &before_[i]);
    if (before_[i].sa_handler != SIG_IGN) sigaction(watched[i], &action, nullptr);  // nohup's SIGHUP stays ignored
  }
}

SignalWatch::~SignalWatch() {
  for (std::size_t i = 0; i < before_.size(); ++i) sigaction(watched[i], &before_[i], nullptr);
}

void stop_if_asked(const Communicator& communicator) {
  const auto signal = static_cast<int>(std::lround(communicator.max(noted)));
  if (signal != 0)
    throw Interrupted(names[std::find(std::begin(watched), std::end(watched), signal) - std::begin(watched)]);
}

}  // namespace imic3d
