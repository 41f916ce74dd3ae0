#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <csignal>

#include "imic3d/core/error.hpp"
#include "imic3d/io/checkpoint.hpp"
#include "imic3d/io/results_file.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_checkpoint {

using ::testing::HasSubstr;

Checkpoint example(double scale = 1.0) {
  Checkpoint content;
  Eigen::MatrixXd matrix(2, 3);
  matrix << 1.0, 2.0, 3.0, 0.1, std::nan(""), -1e-300;
  content.put("stages/0/values", scale * matrix);
  content.put("one", scale);
  content.put("no columns", Eigen::MatrixXd(3, 0));
  content.put("no rows", Eigen::MatrixXd(0, 2));
  content.put("text", std::string("ä b\n"));
  content.put("no text", std::string());
  return content;
}

void expect_example(const Checkpoint& content, double scale = 1.0) {
  const auto& matrix = content.matrix("stages/0/values");
  ASSERT_EQ(matrix.rows(), 2);
  ASSERT_EQ(matrix.cols(), 3);
  EXPECT_EQ(matrix(0, 2), scale * 3.0);
  EXPECT_EQ(matrix(1, 0), scale * 0.1);
  EXPECT_TRUE(std::isnan(matrix(1, 1)));
  EXPECT_EQ(matrix(1, 2), scale * -1e-300);
  EXPECT_EQ(content.number("one"), scale);
  EXPECT_EQ(content.matrix("no columns").rows(), 3);
  EXPECT_EQ(content.matrix("no columns").cols(), 0);
  EXPECT_EQ(content.matrix("no rows").rows(), 0);
  EXPECT_EQ(content.matrix("no rows").cols(), 2);
  EXPECT_EQ(content.text("text"), "ä b\n");
  EXPECT_EQ(content.text("no text"), "");
}

std::string bytes_of(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::string refused(const std::filesystem::path& path) {
  try {
    (void)Checkpoint::read(path);
  } catch (const InputError& error) {
    return error.what();
  }
  return "read";
}

TEST(Checkpoint, IsReadAsItWasWritten) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "checkpoint.h5";
  example().write(path);
  expect_example(Checkpoint::read(path));
  example(2.0).write(path);  // over the old one
  expect_example(Checkpoint::read(path), 2.0);
  EXPECT_FALSE(std::filesystem::exists(path.string() + ".part"));
  auto content = Checkpoint::read(path);
  content.erase("stages/");
  EXPECT_FALSE(content.has("stages/0/values"));
  EXPECT_THROW((void)content.matrix("stages/0/values"), InputError);
  EXPECT_TRUE(content.has("text"));
}

TEST(Checkpoint, IsTheSameOnEveryRank) {
  const Communicator world;
  Checkpoint content = world.is_root() ? example() : Checkpoint();
  content.broadcast(world);
  expect_example(content);
}

TEST(Checkpoint, ACutOrChangedFileIsRefused) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "checkpoint.h5";
  example().write(path);
  const std::string whole = bytes_of(path);
  ASSERT_GT(whole.size(), 1000U);
  for (const double part : {0.0, 0.001, 0.1, 0.5, 0.9, 0.999}) {
    const auto cut =
        folder.write("cut.h5", whole.substr(0, static_cast<std::size_t>(part * static_cast<double>(whole.size()))));
    EXPECT_THAT(refused(cut), HasSubstr("not a whole checkpoint")) << part;
  }
  // Of bytes that are changed here and there none changes the contents unnoticed.
  int noticed = 0;
  for (std::size_t at = 7; at < whole.size(); at += 97) {
    std::string changed = whole;
    changed[at] = static_cast<char>(changed[at] ^ 0x10);
    const auto file = folder.write("changed.h5", changed);
    try {
      expect_example(Checkpoint::read(file));
    } catch (const InputError&) {
      ++noticed;
    }
  }
  EXPECT_GT(noticed, 3);
}

TEST(Checkpoint, AnotherFileIsRefused) {
  const TemporaryFolder folder;
  EXPECT_THAT(refused(folder.path() / "none.h5"), HasSubstr("not a whole checkpoint"));
  EXPECT_THAT(refused(folder.write("text.h5", "not HDF5")), HasSubstr("not a whole checkpoint"));
  auto results = ResultsFile::create(folder.path() / "results.h5");
  results.store("mesh/nodes", {2}, std::vector<double>{1.0, 2.0}, "mm", "nodes");
  results.start();
  EXPECT_THAT(refused(folder.path() / "results.h5"), HasSubstr("not a checkpoint"));
}

/// Files longer than `limit` bytes cannot be written: as on a full disk.
int write_with_limit(const std::filesystem::path& path, rlim_t limit) {
  const pid_t child = ::fork();
  if (child == 0) {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit most{limit, limit};
    ::setrlimit(RLIMIT_FSIZE, &most);
    Checkpoint content = example(3.0);
    content.put("large", Eigen::MatrixXd::Ones(1000, 100));
    int status = 0;
    try {
      content.write(path);
    } catch (const InputError& error) {
      status = std::string(error.what()).find("File too large") != std::string::npos ? 7 : 8;
    } catch (...) {
      status = 9;
    }
    ::_exit(status);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

TEST(Checkpoint, AFullDiskLeavesTheOldOne) {
  if (Communicator().size() > 1) GTEST_SKIP() << "forks; on one rank only";
  const TemporaryFolder folder;
  const auto path = folder.path() / "checkpoint.h5";
  example().write(path);
  for (const rlim_t limit : {1000, 100'000, 700'000}) {
    EXPECT_EQ(write_with_limit(path, limit), 7) << limit;
    expect_example(Checkpoint::read(path));
    EXPECT_FALSE(std::filesystem::exists(path.string() + ".part"));
  }
  EXPECT_EQ(write_with_limit(path, 100'000'000), 0);
  expect_example(Checkpoint::read(path), 3.0);
}

TEST(Fingerprint, TellsWhatChangesTheResult) {
  const TemporaryFolder folder;
  const std::string text =
      "title: a\nspecimen: {mesh: a.msh}\nmaterial: {parameters: {E: 1}}\nidentify: {eta: 1e-3, groups: 2}\noutput: "
      "b\n";
  Case test;
  test.specimen.mesh = folder.write("a.msh", "mesh");
  test.frames = {0, 1, 2};
  test.loads.records = {{.frame = 0, .time = 0.0, .force = 1.0, .image = {}, .line = 2}};
  CameraCase camera;
  camera.images = {folder.write("1.png", "image")};
  camera.frames = {1};
  test.cameras.push_back(camera);
  const auto of = [&](const std::string& contents) {
    test.file = folder.write("case.yaml", contents);
    return fingerprint(test);
  };
  const auto changed = [&](std::string contents, const std::string& from, const std::string& to) {
    return of(contents.replace(contents.find(from), from.size(), to));
  };
  const auto first = of(text);
  EXPECT_EQ(of("# the same\n" + text), first);
  EXPECT_EQ(changed(text, "title: a", "title: another"), first);
  EXPECT_EQ(changed(text, "groups: 2", "groups: 3"), first);
  EXPECT_EQ(changed(text, "output: b", "output: c"), first);
  const auto other = changed(text, "E: 1", "E: 2");
  for (const auto& [section, hash] : first) EXPECT_EQ(other.at(section) == hash, section != "material") << section;
  (void)of(text);
  folder.write("a.msh", "mesH");
  EXPECT_NE(fingerprint(test).at("specimen"), first.at("specimen"));
  test.loads.records[0].force = 1.0 + 1e-15;
  EXPECT_NE(fingerprint(test).at("loads"), first.at("loads"));
  folder.write("1.png", "other image");
  EXPECT_NE(fingerprint(test).at("cameras"), first.at("cameras"));
}

}  // namespace test_checkpoint
}  // namespace imic3d::io
