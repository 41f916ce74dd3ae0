#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/core/parallel.hpp"
#include "imic3d/io/results_file.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_results_file {

using ::testing::ElementsAre;

TEST(ResultsFile, WhatIsDeclaredIsNaNUntilItIsWritten) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "new/results.h5";
  {
    auto file = ResultsFile::create(path);
    file.declare("fields/displacement", {3, 2, 3}, "mm", "displacement of the nodes [frame, node, axis]");
    file.declare("residual/image", {3, 4}, "grey level", "residual", Storage::real32);
    file.declare_frames_done("fields", 3);
    file.store("mesh/cells", {2, 2}, std::vector<int>{0, 1, 1, 2}, "-", "nodes of the cells");
    file.store("frames/time", {3}, std::vector<double>{0, 1, 2.5}, "s", "time");
    file.store_text("case/text", "title: é\n", "the case file");
    file.store_texts("parameters/names", {"E", "S_y", "δ"}, "names");
    file.store_text("program/empty", "", "nothing");
    file.start();
    EXPECT_THROW(file.declare("late", {1}, "-", ""), std::logic_error);
    file.write("fields/displacement", 1, std::vector<double>{1, 2, 3, 4, 5, 6});
    file.write("residual/image", 2, std::vector<double>{0.5, 1, 2, 4});
    file.mark_done("fields", 1);
    EXPECT_THROW(file.write("fields/displacement", 3, std::vector<double>(6)), std::invalid_argument);
    EXPECT_THROW(file.write("fields/displacement", 0, std::vector<double>(5)), std::invalid_argument);
    EXPECT_THROW(file.write("nothing", 0, std::vector<double>(5)), std::runtime_error);
    // another reader while the file is open
    EXPECT_THAT(ResultsFile::open(path).frames_done("fields"), ElementsAre(1U));
  }
  const auto file = ResultsFile::open(path);
  EXPECT_TRUE(std::isnan(file.read("fields/displacement", 0)[0]));
  EXPECT_THAT(file.read("fields/displacement", 1), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_THAT(file.read("residual/image", 2), ElementsAre(0.5, 1, 2, 4));
  EXPECT_THAT(file.shape("fields/displacement"), ElementsAre(3U, 2U, 3U));
  EXPECT_EQ(file.unit("fields/displacement"), "mm");
  EXPECT_EQ(file.description("frames/time"), "time");
  EXPECT_THAT(file.read_integers("mesh/cells"), ElementsAre(0, 1, 1, 2));
  EXPECT_EQ(file.read_text("case/text"), "title: é\n");
  EXPECT_EQ(file.read_text("program/empty"), "");
  EXPECT_THAT(file.read_texts("parameters/names"), ElementsAre("E", "S_y", "δ"));
  EXPECT_THAT(file.frames_done("fields"), ElementsAre(1U));
  EXPECT_TRUE(file.has("mesh/cells"));
  EXPECT_FALSE(file.has("mesh/cells2"));
  EXPECT_FALSE(file.has("nowhere/cells"));
  EXPECT_THAT(file.names(), ElementsAre("case/text", "fields/displacement", "fields/frames_done", "frames/time",
                                        "mesh/cells", "parameters/names", "program/empty", "residual/image"));
}

TEST(ResultsFile, AFileThatCannotBeMadeOrReadIsBadInput) {
  const TemporaryFolder folder;
  EXPECT_THROW((void)ResultsFile::create("/proc/results.h5"), InputError);
  EXPECT_THROW((void)ResultsFile::open(folder.path() / "results.h5"), InputError);
  EXPECT_THROW((void)ResultsFile::open(folder.write("results.h5", "not HDF5")), InputError);
}

TEST(ResultsFile, AnOldFileStaysUntilTheNewOneHasItsStructure) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "results.h5";
  auto old = ResultsFile::create(path);
  old.store("a", {1}, std::vector<double>{1}, "-", "old");
  old.start();
  {
    auto half = ResultsFile::create(path);
    half.store("b", {1}, std::vector<double>{1}, "-", "new");
    EXPECT_TRUE(ResultsFile::open(path).has("a"));
  }
  EXPECT_TRUE(ResultsFile::open(path).has("a"));
  EXPECT_FALSE(std::filesystem::exists(path.string() + ".part"));
}

/// What a child writes until it is killed: frame i holds i + 1 everywhere.
[[noreturn]] void write_frames_for_ever(const std::filesystem::path& path, std::size_t frames, std::size_t nodes) {
  auto file = ResultsFile::open(path, true);
  for (std::size_t i = 0;; i = (i + 1) % frames) {
    const std::vector<double> values(nodes * 3, static_cast<double>(i + 1));
    file.write("fields/displacement", i, values);
    file.write("frames/force", i, {values.data(), 1});
    file.mark_done("fields", i);
  }
}

// Not under mpirun with several ranks: a killed child of a rank is nobody's business there.
TEST(ResultsFile, AKilledRunLeavesEveryFinishedFrame) {
  if (Communicator().size() > 1) GTEST_SKIP() << "forks; on one rank only";
  const TemporaryFolder folder;
  constexpr std::size_t frames = 2000, nodes = 1000;
  std::mt19937 random(1);
  std::size_t most = 0;
  for (int trial = 0; trial < 20 || (most <= 10 && trial < 40);
       ++trial) {  // on a busy machine children write little in the first 20
    const auto path = folder.path() / "results.h5";
    {
      auto file = ResultsFile::create(path);
      file.declare("fields/displacement", {frames, nodes, 3}, "mm", "displacement");
      file.declare("frames/force", {frames}, "N", "force");
      file.declare_frames_done("fields", frames);
      file.start();
    }
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) write_frames_for_ever(path, frames, nodes);
    ::usleep(1000 + random() % (trial < 20 ? 60000 : 600000));
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);

    const auto file = ResultsFile::open(path);
    const auto done = file.frames_done("fields");
    most = std::max(most, done.size());
    for (const auto frame : done) {
      const auto values = file.read("fields/displacement", frame);
      ASSERT_TRUE(std::all_of(values.begin(), values.end(),
                              [&](double value) { return value == static_cast<double>(frame + 1); }))
          << "trial " << trial << " frame " << frame;
      ASSERT_EQ(file.read("frames/force", frame)[0], static_cast<double>(frame + 1));
    }
  }
  RecordProperty("most_frames_done", static_cast<int>(most));
  EXPECT_GT(most, 10U);  // the children did write
}

}  // namespace test_results_file
}  // namespace imic3d::io
