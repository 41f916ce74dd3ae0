#include "imic3d/core/log.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/sinks/null_sink.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <mutex>
#include <utility>
#include <vector>

namespace imic3d {

namespace {

/// Keeps its lines until it is known where the file stands. A write that fails loses its lines and nothing else.
class FileSink final : public spdlog::sinks::base_sink<std::mutex> {
 public:
  void begin(const std::filesystem::path& path, bool append) {
    const std::lock_guard lock(mutex_);
    file_.open(path, append ? std::ios::app : std::ios::trunc);
    known_ = true;
    write(std::exchange(before_, {}));
  }
  [[nodiscard]] bool good() const { return file_.good(); }

 private:
  void sink_it_(const spdlog::details::log_msg& message) override {
    spdlog::memory_buf_t line;
    formatter_->format(message, line);
    if (known_)
      write(fmt::to_string(line));
    else
      before_ += fmt::to_string(line);
  }
  void flush_() override {}
  void write(const std::string& text) {
    file_.clear();
    file_ << text << std::flush;
  }

  std::ofstream file_;
  std::string before_;
  bool known_ = false;
};

/// Of the default logger; none on other ranks than 0.
std::shared_ptr<FileSink> file_sink() {
  const auto& sinks = spdlog::default_logger()->sinks();
  return sinks.empty() ? nullptr : std::dynamic_pointer_cast<FileSink>(sinks.back());
}

}  // namespace

void start_log(const Communicator& communicator) {
  std::vector<spdlog::sink_ptr> sinks;
  if (communicator.is_root()) {
    sinks.push_back(std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
    sinks.push_back(std::make_shared<FileSink>());
  } else {
    sinks.push_back(std::make_shared<spdlog::sinks::null_sink_mt>());
  }
  auto logger = std::make_shared<spdlog::logger>("imic3d", sinks.begin(), sinks.end());
  logger->set_pattern("[%H:%M:%S] %^%l%$ %v");
  logger->flush_on(spdlog::level::info);
  spdlog::set_default_logger(logger);
}

void begin_log_file(const std::filesystem::path& file, bool append) {
  const auto sink = file_sink();
  if (!sink) return;
  sink->begin(file, append);
  if (!sink->good()) spdlog::warn("{} cannot be written: the run has no log file", file.string());
}

void note_in_log_file(const std::string& line) {
  const auto sink = file_sink();
  if (sink) sink->log({"imic3d", spdlog::level::info, line});
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
