// The page of imic3d loop, written from a summary of two candidates by hand.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>

#include "imic3d/io/loop_page.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_loop_page {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

json candidate(const char* name, double kappa, double z) {
  return {{"name", name},
          {"link", "record"},
          {"sentence", std::string(name) + " is off"},
          {"confused_with", "E"},
          {"separated_by", std::string("a second look at ") + name},
          {"kappa", kappa},
          {"visible", kappa >= 0.05},
          {"z", z},
          {"p", 0.5},
          {"degrees", 1},
          {"predicted_drop", z * z},
          {"significant", z > 3.5},
          {"contradicted", false},
          {"in_set", false},
          {"sizes",
           {{{"parameter", "size"},
             {"unit", "mm"},
             {"size", 1.0},
             {"standard_deviation", 0.1},
             {"interval", {0.804, 1.196}},
             {"detectable", 0.4},
             {"shift_of_parameters_at_detectable_size", {{"E", 800.0}}},
             {"usual_size", 0.02},
             {"usual_size_is_unit", false},
             {"shift_of_parameters_at_usual_size", {{"E", 4000.0}}}}}}};
}

json model(double level) {
  return {{"added", json::array()},
          {"parameters", {{"E", {{"value", 2e5}, {"standard_deviation", 1000.0}, {"unit", "MPa"}}}}},
          {"level", level},
          {"threshold", 3.5},
          {"omnibus", {{"deviations", 15.1}, {"threshold", 2.3}}},
          {"chi",
           {{"fitted", 2.0},
            {"held_out", 2.1},
            {"null_fitted", 1.1},
            {"null_held_out", 1.2},
            {"frames", {1.0, 2.5, 2.0}},
            {"null_frames", {1.1, 1.2, 1.3}},
            {"images", 1.5},
            {"null_images", 1.15},
            {"force", 7.5},
            {"null_force", 1.25}}},
          {"candidates", {candidate("seen", 0.8, 9.0), candidate("hidden", 0.01, 0.3)}},
          {"not_tested", json::array()}};
}

/// One effect added to a declared model.
json summary() {
  json all = {{"title", "A <test>"},     {"sentence", "Something is missing."},
              {"verdict", "attributed"}, {"set", {"seen"}},
              {"named", {"seen"}},       {"frames", {4, 6, 8}},
              {"held_out", {6}},         {"invisible", {"hidden"}},
              {"before", model(0.04)},   {"after", model(0.01)}};
  json& tried = all["before"]["candidates"][0];
  tried["in_set"] = true,
  tried["tried"] = {
      {"achieved_drop", 77.7}, {"fitted", true}, {"sufficient", true}, {"plausible", true}, {"objection", ""}};
  json small = candidate("small", 0.6, 0.5);
  small["reason"] = "no size within its bounds would be found", small["sizes"][0]["usual_size_is_unit"] = true;
  all["before"]["not_tested"] = {small, {{"name", "lost"}, {"reason", "the model could not be computed with it"}}};
  json trial = model(0.01);
  trial["candidate"] = "seen", trial["plausible"] = true, trial["sufficient"] = true, trial["objection"] = "",
  trial["largest_score"] = {{"z", 1.2}, {"limit", 3.9}, {"candidate", "other"}, {"contradicted", false}};
  json rival = model(0.01);
  rival["candidate"] = "rival", rival["plausible"] = false, rival["sufficient"] = false,
  rival["objection"] = "at its bound";
  all["rounds"] = {{{"set", {"seen"}}, {"trials", {trial, rival}}}};
  all["after"]["not_tested"] = all["before"]["not_tested"];
  all["after"]["added"] = {"seen"}, all["after"]["chi"]["frames"] = {1.0, 1.1, 0.9};
  all["after"]["parameters"]["size"] = {{"value", 1.0}, {"standard_deviation", 0.1}, {"unit", "mm"}};
  all["remainder"] = {{"share_of_first_mode", 0.3}, {"time", {0.1, -0.2, 0.3}}};
  all["load"] = {{"force", {10.0, 20.0, 30.0}}, {"unit", "N"}};
  all["force_residual"] = {
      {"before", {1.0, 2.0, 3.0}}, {"after", {0.1, 0.2, 0.1}}, {"null_rms", {0.5, 0.5, 0.5}}, {"unit", "N"}};
  all["next"] = {{"measurements", {{{"measurement", "a second look at seen"}, {"for", {"seen"}}}}}};
  return all;
}

std::string page_of(const json& all) {
  const TemporaryFolder folder;
  write_loop_page(folder.path() / "report.html", all, {});
  std::ifstream stream(folder.path() / "report.html");
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST(LoopPage, AnswersFirstThenShowsThenSaysWhatItCannotSee) {
  const std::string page = page_of(summary());
  std::size_t at = 0;
  for (const char* part :
       {"<h1>A &lt;test&gt;", "Something is missing.", "Verdict: <strong>attributed</strong>: seen. Held out: 6.",
        "Error before and after", ">Load<", "Error of each frame", "Force, measured",
        "Candidates under the declared model", "Round 1", "Candidates under the final model", "<h2>Parameters",
        "What this test cannot see", "What to measure next", "This would confirm it:"}) {
    const std::size_t found = page.find(part, at);
    ASSERT_NE(found, std::string::npos) << part;
    at = found;
  }
  EXPECT_THAT(page, HasSubstr("<td>χ of the displacement, fitted frames</td><td>1.500</td>"));
  EXPECT_THAT(page, HasSubstr("<td>χ of the force, fitted frames</td><td>7.500</td><td>7.500</td><td>1.250</td>"));
  EXPECT_THAT(page, Not(HasSubstr("nan")));
}

TEST(LoopPage, AParameterThatItsBoundHoldsHasNoStandardDeviation) {
  json all = summary();
  all["before"]["parameters"]["E"]["standard_deviation"] = 0.0;
  EXPECT_THAT(page_of(all),
              HasSubstr("<td>E</td><td>200000</td><td>its bound</td><td>→</td><td>200000</td><td>± 1000"));
}

TEST(LoopPage, ScoresAndEnergyStandBesideTheirOwnLimits) {
  const std::string page = page_of(summary());
  EXPECT_THAT(page, HasSubstr("<td>+15.1 (limit 2.3)</td><td>1.2 (limit 3.9)<br><span "
                              "class=\"note\">other</span></td><td class=\"words\">nothing is left</td>"));
  EXPECT_THAT(page,
              HasSubstr("<td>+15.1 (limit 2.3)</td><td>–</td><td class=\"words\">not plausible: at its bound</td>"));
  const std::size_t final_model = page.find("Candidates under the final model"),
                    declared = page.find("in 4 of 100 tests");
  EXPECT_LT(declared, final_model);
  EXPECT_EQ(page.find("in 4 of 100 tests", final_model), std::string::npos);
  EXPECT_NE(page.find("in 1 of 100 tests", final_model), std::string::npos);
}

TEST(LoopPage, ACandidateHasItsIntervalAndWhatItsTrialAchieved) {
  EXPECT_THAT(page_of(summary()),
              HasSubstr("<strong>seen</strong><br><span class=\"note\">record</span></td><td>9.0 "
                        "*</td><td>0.80</td><td class=\"left\">1.00 [0.80, 1.20] mm</td><td>81.0</td><td>77.7</td><td "
                        "class=\"words\">plausible; nothing is left</td>"));
}

TEST(LoopPage, SizesOfOneOfSeveralTestsAreShort) {
  json all = summary();
  json& one = all["before"]["candidates"][0];
  one["name"] = "taper (plate)";
  one["sizes"].push_back(one["sizes"][0]);
  one["sizes"][0]["parameter"] = "taper_x (plate)", one["sizes"][1]["parameter"] = "taper_y (plate)",
  one["sizes"][1]["interval"] = nullptr;
  all["part_of_several_tests"] = true;
  const std::string page = page_of(all);
  EXPECT_THAT(page, HasSubstr("taper_x 1.00 [0.80, 1.20] mm<br>taper_y not determined<"));
  EXPECT_THAT(page, HasSubstr("One of several tests"));
}

TEST(LoopPage, WhatCannotBeSeenHasItsBias) {
  const std::string page = page_of(summary());
  EXPECT_THAT(page,
              HasSubstr("hidden<br><span class=\"note\">κ 0.010</span></td><td class=\"left\">size 0.020 mm</td><td "
                        "class=\"words\">E +4000 MPa (4.0 sd)</td><td class=\"words\">a second look at hidden</td>"));
  EXPECT_THAT(page, HasSubstr("small<br><span class=\"note\">no size within its bounds would be found</span></td><td "
                              "class=\"left\">size 0.020 mm (a unit)</td>"));
  EXPECT_THAT(
      page,
      HasSubstr(
          "<tr><td>seen</td><td class=\"left\">size 0.40 mm</td><td class=\"words\">E +800 MPa (0.80 sd)</td></tr>"));
  EXPECT_THAT(page, HasSubstr("<li>lost, because the model could not be computed with it</li>"));
}

TEST(LoopPage, WhatCannotBeToldApartIsAParagraph) {
  json all = summary();
  all["verdict"] = "ambiguous", all["set"] = {"seen", "twin"};
  all["ambiguity"] = {candidate("seen", 0.8, 9.0), candidate("twin", 0.8, 9.0)};
  const std::string page = page_of(all);
  EXPECT_THAT(
      page,
      HasSubstr(
          "<li><strong>twin</strong>: twin is off. Confused with E. What would tell it: a second look at twin.</li>"));
  EXPECT_THAT(page, HasSubstr("This would tell them apart:"));
}

TEST(LoopPage, TheUnexplainedHasAPlaceAndATime) {
  json all = summary();
  all["verdict"] = "unexplained", all["next"] = {{"measurements", json::array()}, {"look_at", "frame 8"}};
  all["remainder"]["map"] = {
      {"place", {1.0, 2.5}}, {"frame", 8}, {"largest", 9.0}, {"limit", 3.5}, {"share_beyond_limit", 0.1}};
  all["remainder"]["goes_with"] = {{"force", 0.9}};
  EXPECT_THAT(page_of(all),
              HasSubstr("Look where it is largest: frame 8; on the surface about (1.00, 2.50) in frame 8."));
}

TEST(LoopPage, WhereNothingIsHeldOutThereIsNoErrorOfIt) {
  json all = summary();
  EXPECT_THAT(page_of(all), HasSubstr("χ of the held-out frames"));
  all["held_out"] = json::array();
  EXPECT_THAT(page_of(all), HasSubstr("Held out: nothing."));
  EXPECT_THAT(page_of(all), Not(HasSubstr("χ of the held-out frames")));
}

TEST(LoopPage, WhereNothingIsAddedThereIsOneCurve) {
  json all = summary();
  all["verdict"] = "nothing found", all["named"] = json::array(), all["rounds"] = json::array(),
  all["after"] = all["before"];
  const std::string page = page_of(all);
  EXPECT_THAT(page, HasSubstr(">declared model</text>"));
  EXPECT_THAT(page, Not(HasSubstr("Candidates under the final model")));
  EXPECT_THAT(page, HasSubstr("This would show what this test cannot see:"));
}

}  // namespace test_loop_page
}  // namespace imic3d::io
