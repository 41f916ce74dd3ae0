#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>

#include "example_run.hpp"
#include "imic3d/core/error.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_run_results {

TEST(RunResults, EveryDatasetSaysItsUnitAndWhatItIs) {
  const TemporaryFolder folder;
  const auto file = example_run(folder.path());
  for (const auto& name : file.names()) {
    EXPECT_FALSE(file.description(name).empty()) << name;
    const bool is_text = name.starts_with("case/") || name.starts_with("program/") || name == "frames/images" ||
                         name == "identification/parameters" || name == "identification/units";
    EXPECT_EQ(file.unit(name).empty(), is_text) << name;
  }
  EXPECT_EQ(file.unit("fields/von_mises"), "MPa");
  EXPECT_EQ(file.read_text("case/text").substr(0, 6), "title:");
  EXPECT_EQ(file.frames_done("fields").size(), 11U);
  EXPECT_EQ(file.read_integers("identification/iterations/count")[0], 6);
  EXPECT_EQ(file.read("identification/iterations/values", 4)[1], 281.0);
  EXPECT_EQ(file.read("identification/standard_deviation")[0], 200.0);
}

TEST(RunResults, MoreIterationsThanRowsAreNotKept) {
  const TemporaryFolder folder;
  Case test;
  test.frames = {0, 1};
  RunPlan plan;
  plan.parameters = {{"E", "MPa", "", 0, 1e7, {}}};
  plan.most_iterations = 2;
  auto file = create_results(folder.path(), test, plan);
  for (int i = 0; i < 4; ++i) write_iteration(file, 0, i, std::vector<double>{1.0 * i}, 0.1, 1.0);
  EXPECT_EQ(file.read_integers("identification/iterations/count")[0], 2);
}

TEST(RunResults, TheXdmfFileFitsTheHdf5File) {
  const TemporaryFolder folder;
  (void)example_run(folder.path());
  if (std::system("/usr/bin/python3 -c 'import h5py, numpy' 2>/dev/null") != 0)
    GTEST_SKIP() << "no h5py for /usr/bin/python3";
  const std::string command = "/usr/bin/python3 " IMIC3D_TEST_DIRECTORY "/check_xdmf.py " +
                              (folder.path() / "results.xdmf").string() + " >/dev/null";
  EXPECT_EQ(std::system(command.c_str()), 0);
}

TEST(RunResults, TheSummaryHasEveryHeadlineNumberWithItsUnit) {
  const TemporaryFolder folder;
  const auto file = example_run(folder.path());
  write_json(folder.path() / "result.json", summary(file));
  const auto result = nlohmann::json::parse(std::ifstream(folder.path() / "result.json"));
  EXPECT_EQ(result["parameters"]["E"]["value"], 198e3);
  EXPECT_EQ(result["parameters"]["E"]["standard_deviation"], 200.0);
  EXPECT_EQ(result["parameters"]["E"]["unit"], "MPa");
  EXPECT_TRUE(result["parameters"]["nu"]["standard_deviation"].is_null());
  EXPECT_EQ(result["iterations_per_stage"], nlohmann::json({2, 2}));
  EXPECT_EQ(result["frames"]["simulated"], 11);
  EXPECT_EQ(result["force_rms_difference"]["unit"], "N");
  EXPECT_GT(result["residual_rms_model"]["value"], 2.0);
  EXPECT_NEAR(result["fitted"]["residual_rms_model"]["value"], 2.075, 0.01);  // frames 0 to 5: 2.00 to 2.15
  EXPECT_TRUE(result["held_out"]["residual_rms_model"]["value"].is_null());   // the last frame was not reached
  EXPECT_EQ(result["program"]["PETSc"], "3.18.5");
  EXPECT_THROW(write_json("/proc/result.json", result), InputError);
  // no temporary file is left
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path())) names.push_back(entry.path().filename());
  EXPECT_THAT(names, ::testing::UnorderedElementsAre("results.h5", "results.xdmf", "result.json"));
}

}  // namespace test_run_results
}  // namespace imic3d::io
