#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "imic3d/core/error.hpp"
#include "imic3d/io/loads.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_loads {

namespace fs = std::filesystem;

std::string mistakes_in(const std::string& text, const LoadColumns& columns = {}) {
  const TemporaryFolder folder;
  try {
    const auto records = read_loads(folder.write("loads.csv", text), columns);
    return "none in " + std::to_string(records.size());
  } catch (const InputError& error) {
    return folder.without_folder(error.what());
  }
}

TEST(Loads, AnySeparatorCommentsAndQuotes) {
  const TemporaryFolder folder;
  for (const char* text : {"frame,time_s,force_N\n0,0,1.5\n1,0.5,-2e3\n",
                           "# made by hand\n\nframe;time_s;force_N\r\n0;0;1.5\r\n# gap\r\n1;+0.5;-2e3\r\n",
                           "\xEF\xBB\xBF\"force_N\"\tframe\t\"time_s\"\n1.5\t0\t0\n\"-2e3\"\t1\t0.5",
                           "Machine 7, frame, operator\n  frame   time_s force_N\n      0      0.0     1,5 \n      1   "
                           "   0.5    -2e3\r\n"}) {
    const auto records = read_loads(folder.write("loads.csv", text), {}, 2.0);
    ASSERT_EQ(records.size(), 2U) << text;
    EXPECT_EQ(records[1].frame, 1);
    EXPECT_EQ(records[1].time, 0.5);
    EXPECT_EQ(records[0].force, 3.0);
    EXPECT_EQ(records[1].force, -4000.0);
    EXPECT_TRUE(records[1].image.empty());
  }
}

/// As a testing machine set to German writes it; a comma that parts fields is no decimal sign, not even in quotes,
/// and 1.234,5 is no number.
TEST(Loads, DecimalCommasAndARowOfUnits) {
  const TemporaryFolder folder;
  for (const char* text : {"\xEF\xBB\xBF"
                           "frame;time_s;force_N\r\n;[s];[N]\r\n0;0,0;1,5\r\n1;0,5;-2,5E3\r\n",
                           "\"frame\"\t\"time_s\"\t\"force_N\"\n\"\"\t\"(s)\"\t\"(N)\"\n\"0\"\t\"0\"\t\"1,"
                           "5\"\n\"1\"\t\"0.5\"\t\"-2500\"\n"}) {
    const auto records = read_loads(folder.write("loads.csv", text));
    ASSERT_EQ(records.size(), 2U) << text;
    EXPECT_EQ(records[0].force, 1.5);
    EXPECT_EQ(records[1].time, 0.5);
    EXPECT_EQ(records[1].force, -2500.0);
  }
  EXPECT_EQ(read_loads(folder.write("loads.csv", "frame;time_s;force_N\nBild;s;N\n0;0,0;1,5\n"))[0].force, 1.5);
  for (const char* no_units : {"first;soon;none", "1;s;N"})
    EXPECT_NE(mistakes_in(fmt::format("frame;time_s;force_N\n{}\n1;0;1\n", no_units)), "") << no_units;
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n0,0,\"1,5\"\n"),
            "loads.csv:2 column \"force_N\": 1,5; allowed: a finite number");
  EXPECT_EQ(mistakes_in("frame;time_s;force_N\n0;0;1.234,5\n"),
            "loads.csv:2 column \"force_N\": 1.234,5; allowed: a finite number");
  EXPECT_EQ(mistakes_in("frame;time_s;force_N\n0;0;1\n;[s];[N]\n"),
            "loads.csv:3 column \"frame\": nothing; allowed: a frame number (an integer from 0)\nloads.csv:3 column "
            "\"time_s\": [s]; allowed: a finite number\nloads.csv:3 column \"force_N\": [N]; allowed: a finite number");
}

/// The case file is in UTF-8, whatever the machine writes.
TEST(Loads, AHeaderInLatin1) {
  const TemporaryFolder folder;
  const LoadColumns columns{.image = "Bild", .time = "Zeit", .force = "L\xC3\xA4ngskraft"};
  for (const std::string written : {"\xC3\xA4", "\xE4"}) {
    const auto file = folder.write("loads.csv", "Bild;Zeit;L" + written + "ngskraft\n0;0;1,5\n");
    EXPECT_EQ(read_loads(file, columns)[0].force, 1.5);
  }
  EXPECT_EQ(mistakes_in("frame;time_s;L\xE4ngskraft\n0;0;1\n"),
            "loads.csv:1 column \"force_N\": not there; allowed: one of \"frame\", \"time_s\", \"L\xC3\xA4ngskraft\"");
}

TEST(Loads, FilesOfImagesMayBeNamedAndMayBeAbsent) {
  const TemporaryFolder folder;
  const auto file = folder.write("loads.csv", "frame,time_s,force_N,image_file\n0,0,1,\"a, \"\"b\"\".png\"\n4,0,2,\n");
  const auto records = read_loads(file);
  EXPECT_EQ(records[0].image, folder.path() / "a, \"b\".png");
  EXPECT_TRUE(records[1].image.empty());
  EXPECT_EQ(records[1].frame, 4);
}

TEST(Loads, MistakesAreNamedWithLineAndColumn) {
  EXPECT_EQ(mistakes_in("frame,t,force_N\n0,0,1\n"),
            "loads.csv:1 column \"time_s\": not there; allowed: one of \"frame\", \"t\", \"force_N\"");
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n0,0,nan\n1,x,\n"),
            "loads.csv:2 column \"force_N\": nan; allowed: a finite number\n"
            "loads.csv:3 column \"time_s\": x; allowed: a finite number\n"
            "loads.csv:3 column \"force_N\": nothing; allowed: a finite number");
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n0,0,1\n1,2,1\n2,1.5,1\n"),
            "loads.csv:4 column \"time_s\": 1.5 after 2; allowed: a time that does not decrease");
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n0,0,1\n2,1,1\n1,2,1\n2,3,1\n"),
            "loads.csv:4 column \"frame\": 1 after 2; allowed: ascending frames\n"
            "loads.csv:5 column \"frame\": 2; allowed: a frame once (it stands in line 3 too)");
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n0.5,0,1\n1,0\n2,0,\"1\n"),
            "loads.csv:4: a quote that is not closed\n"
            "loads.csv:2 column \"frame\": 0.5; allowed: a frame number (an integer from 0)\n"
            "loads.csv:3 column \"force_N\": nothing; allowed: a finite number");
  EXPECT_EQ(
      mistakes_in("frame,time_s,force_N\n0,0,1,5\n"),
      "loads.csv:2: 4 fields; allowed: 3 as in the header (where a comma parts fields, the decimal sign is the point)");
  EXPECT_EQ(mistakes_in(std::string("\xFF\xFE"
                                    "f\0r\0",
                                    6)),
            "loads.csv: text in UTF-16; allowed: UTF-8");
  EXPECT_EQ(
      mistakes_in("0,0,1\n1,0,2\n"),
      "loads.csv: no row with the columns \"time_s\", \"frame\", \"force_N\"; allowed: columns of \"0\", \"0\", \"1\"");
  EXPECT_EQ(mistakes_in(""), "loads.csv: an empty file; allowed: a load record (.csv) with a header row");
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n"), "loads.csv: no rows; allowed: one row for each frame");
  EXPECT_EQ(mistakes_in("frame,time_s,force_N,force_N\n"),
            "loads.csv:1 column \"force_N\": there 2 times; allowed: once");
  EXPECT_THROW(read_loads("nowhere/loads.csv"), InputError);
  EXPECT_THROW(read_loads("/tmp"), InputError);
}

TEST(Loads, StaticFramesMayShareATime) {
  EXPECT_EQ(mistakes_in("frame,time_s,force_N\n0,0.000,12\n1,0.000,14\n2,0.000,-25\n3,1,6036\n"), "none in 4");
}

TEST(Loads, AHundredMistakesAreCounted) {
  std::string text = "frame,time_s,force_N\n";
  for (int i = 0; i < 100; ++i) text += "x,0,0\n";
  EXPECT_NE(mistakes_in(text).find("95 more mistakes"), std::string::npos);
}

TEST(Loads, TheLagOfTheRecorderIsUndone) {
  // A force that grows as t^2 behind a low-pass of 0.3 s reads t^2 - 0.6 t + 0.18 once the start is forgotten; the
  // steps are uneven and two rows share a time.
  std::vector<LoadRecord> records;
  for (double t : {1.0, 1.1, 1.3, 1.4, 1.4, 1.6, 1.7})
    records.push_back({.time = t, .force = t * t - 0.6 * t + 0.18, .image = {}});
  const auto read = records;
  remove_lag(records, 0.3);
  for (std::size_t i : {1U, 2U}) EXPECT_NEAR(records[i].force, read[i].time * read[i].time, 1e-12) << i;
  for (std::size_t i : {0U, 6U}) EXPECT_NEAR(records[i].force, read[i].time * read[i].time, 0.3 * 0.1 + 1e-12) << i;
  records = read;
  remove_lag(records, 0.0);
  EXPECT_EQ(records[3].force, read[3].force);
}

/// A parabola in uneven rows, two of which share a time; frames before and after it were taken without a record.
TEST(Loads, FramesByTheirTimesAreLinearBetweenTheRows) {
  const TemporaryFolder folder;
  const auto record =
      read_loads(folder.write("machine.txt", "Test 12\nt;F\n[s];[kN]\n1,0;1,0\n1,5;2,25\n3,0;9,0\n3,0;8,0\n4,0;16,0\n"),
                 {.image = "", .time = "t", .force = "F"}, 1000.0);
  ASSERT_EQ(record.size(), 5U);
  EXPECT_EQ(record[4].frame, 4);
  const auto taken = read_loads(folder.write("camera.csv",
                                             "frame,time_s,image_file\n3,0.9,a.png\n5,1,b.png\n6,2,c.png\n7,3,d.png\n9,"
                                             "3.5,e.png\n10,4,f.png\n11,4.001,g.png\n"),
                                {.force = ""});
  const auto frames = at_frames(record, taken);
  ASSERT_EQ(frames.size(), 5U);
  const double expected[] = {1000.0, 4500.0, 8000.0, 12000.0, 16000.0};
  for (std::size_t i = 0; i < 5; ++i) EXPECT_EQ(frames[i].force, expected[i]) << i;
  EXPECT_EQ(frames[1].frame, 6);
  EXPECT_EQ(frames[1].time, 2.0);
  EXPECT_EQ(frames[1].image, folder.path() / "c.png");
  EXPECT_EQ(frames[1].line, 5);
  EXPECT_TRUE(at_frames({}, taken).empty());
}

TEST(Loads, MeasuredRecords) {
  const char* given = std::getenv("IMIC3D_DATA");
  const fs::path data = given ? fs::path(given) : fs::path(IMIC3D_SOURCE_DIRECTORY) / "../shared/data";
  if (!fs::exists(data)) GTEST_SKIP() << "no measured data at " << data << " (IMIC3D_DATA)";
  const auto plate = read_loads(data / "plate_independent/loads.csv");
  EXPECT_EQ(plate.size(), 48U);
  EXPECT_EQ(plate[3].force, 6036.16);
  const auto tension = read_loads(data / "pcabs_tension/frames.csv", {.force = "force_kN"}, 1000.0);
  ASSERT_EQ(tension.size(), 281U);
  EXPECT_NEAR(tension[8].force, 60.810, 1e-9);
  EXPECT_EQ(fs::weakly_canonical(tension[8].image), fs::weakly_canonical(data / "pcabs_tension/images/frame_008.png"));
  EXPECT_TRUE(tension[13].image.empty());
}

}  // namespace test_loads
}  // namespace imic3d::io
