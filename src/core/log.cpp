#include "imic3d/core/log.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <spdlog/sinks/basic_file_sink.h>
#include <spdlog/sinks/null_sink.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <unistd.h>

#include <cstdio>
#include <vector>

namespace imic3d {

void start_log(const Communicator& communicator, const std::string& file) {
  std::vector<spdlog::sink_ptr> sinks;
  if (communicator.is_root()) {
    sinks.push_back(std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
    if (!file.empty()) sinks.push_back(std::make_shared<spdlog::sinks::basic_file_sink_mt>(file, true));
  } else {
    sinks.push_back(std::make_shared<spdlog::sinks::null_sink_mt>());
  }
  auto logger = std::make_shared<spdlog::logger>("imic3d", sinks.begin(), sinks.end());
  logger->set_pattern("[%H:%M:%S] %^%l%$ %v");
  logger->flush_on(spdlog::level::info);
  spdlog::set_default_logger(logger);
}

Progress::Progress(const Communicator& communicator, std::string what, int steps)
    : visible_(communicator.is_root() && isatty(fileno(stderr)) == 1),
      what_(std::move(what)),
      steps_(steps),
      start_(std::chrono::steady_clock::now()) {}

Progress::~Progress() {
  if (visible_) fmt::print(stderr, "\r\033[K");
}

void Progress::update(int done, const std::string& detail) {
  if (!visible_) return;
  const double spent = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const double left = done > 0 ? spent * (steps_ - done) / done : 0.0;
  fmt::print(stderr, "\r\033[K{} {}/{}  {}  {:.0f} s left", what_, done, steps_, detail, left);
  std::fflush(stderr);
}

}  // namespace imic3d
