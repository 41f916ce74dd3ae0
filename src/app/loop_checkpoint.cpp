#include "loop_checkpoint.hpp"

#include <fmt/format.h>

#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/log.hpp"

namespace imic3d::app {

namespace {

std::map<std::string, std::string> sections_of(const io::Case& test, std::span<const io::Case> cases) {
  auto sections = io::fingerprint(test, true);
  for (std::size_t k = 0; k < cases.size(); ++k)
    for (const auto& [section, hash] : io::fingerprint(cases[k], true))
      sections[fmt::format("{} of {}", section, test.tests[k].name)] = hash;
  return sections;
}

std::string place_of(std::size_t answer) { return fmt::format("answers/{:06d}/", answer); }

}  // namespace

LoopCheckpoint::LoopCheckpoint(const Communicator& world, const std::filesystem::path& folder, const io::Case& test,
                               std::span<const io::Case> cases, bool resume)
    : world_(world),
      file_(
          world, folder / "loop_checkpoint.h5", [&] { return sections_of(test, cases); }, resume) {}

std::deque<loop::Answer> LoopCheckpoint::known() {
  std::deque<loop::Answer> answers;
  if (!file_.found()) return answers;
  const io::Checkpoint all = file_.everywhere();
  for (; all.has(place_of(kept_) + "question"); ++kept_) {
    const std::string at = place_of(kept_);
    auto& answer = answers.emplace_back(loop::Answer{all.matrix(at + "question"), {}, all.text(at + "failure")});
    for (int k = 0; all.has(fmt::format("{}{}", at, k)); ++k)
      answer.numbers.push_back(all.matrix(fmt::format("{}{}", at, k)));
  }
  spdlog::info("goes on from {}: {} answers of the test", file_.path().string(), kept_);
  return answers;
}

void LoopCheckpoint::keep(const loop::Answer& answer) {
  if (world_.is_root()) {
    const std::string at = place_of(kept_);
    file_.content().put(at + "question", answer.question);
    file_.content().put(at + "failure", answer.failure);
    for (std::size_t k = 0; k < answer.numbers.size(); ++k)
      file_.content().put(fmt::format("{}{}", at, k), answer.numbers[k]);
  }
  ++kept_;
  if (file_.due()) file_.write();
  stop_if_asked(world_);
}

}  // namespace imic3d::app
