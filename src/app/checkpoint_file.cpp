#include "checkpoint_file.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "imic3d/app/program.hpp"
#include "imic3d/core/log.hpp"

namespace imic3d::app {

CheckpointFile::CheckpointFile(const Communicator& world, std::filesystem::path path,
                               const std::function<std::map<std::string, std::string>()>& sections, bool resume)
    : world_(world), path_(std::move(path)) {
  collectively(world, [&] {
    if (!world.is_root()) return;
    std::error_code error;
    found_ = resume && std::filesystem::exists(path_, error);
    if (found_) {
      constexpr const char* or_anew = "without --resume the run starts anew";
      content_ = io::Checkpoint::read(path_);
      if (content_.text("program") != revision())
        throw InputError(path_.string(), "a checkpoint of imic3d " + content_.text("program"),
                         fmt::format("one of this program, {}; {}", revision(), or_anew));
      std::vector<std::string> others;
      for (const auto& [section, hash] : sections())
        if (!content_.has("case/" + section) || content_.text("case/" + section) != hash) others.push_back(section);
      if (!others.empty())
        throw InputError(path_.string(),
                         fmt::format("a checkpoint of another case: {} changed, or what {} names",
                                     fmt::join(others, ", "), others.size() == 1 ? "it" : "they"),
                         fmt::format("the same case; {}", or_anew));
    } else {
      std::filesystem::remove(path_, error);
      content_.put("program", revision());
      for (const auto& [section, hash] : sections()) content_.put("case/" + section, hash);
    }
  });
  found_ = world.max(found_ ? 1.0 : 0.0) > 0.5;
  if (resume && !found_) spdlog::info("{}: no checkpoint, the run starts from the beginning", path_.string());
}

io::Checkpoint CheckpointFile::everywhere() const {
  io::Checkpoint all = content_;
  all.broadcast(world_);
  return all;
}

void CheckpointFile::write() {
  if (!world_.is_root()) return;
  const auto start = std::chrono::steady_clock::now();
  try {
    content_.write(path_);
  } catch (const std::exception& error) {
    std::error_code ignored;
    spdlog::warn("no checkpoint: {}. The run goes on; {}", error.what(),
                 std::filesystem::exists(path_, ignored) ? "the checkpoint before stays" : "there is none yet");
  }
  const auto end = std::chrono::steady_clock::now();
  next_ = end + std::max<std::chrono::steady_clock::duration>(std::chrono::seconds(10), 20 * (end - start));
}

}  // namespace imic3d::app
