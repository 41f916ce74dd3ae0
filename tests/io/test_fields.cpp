#include <gtest/gtest.h>

#include "imic3d/core/error.hpp"
#include "imic3d/io/experiments.hpp"
#include "imic3d/io/fields.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_fields {

std::string mistakes_in(const std::string& text, const PointColumns& columns = {}) {
  const TemporaryFolder folder;
  try {
    const auto table = read_points(folder.write("points.csv", text), columns);
    return "none in " + std::to_string(table.at.rows());
  } catch (const InputError& error) {
    return folder.without_folder(error.what());
  }
}

TEST(Fields, WhatAnotherProgramWritesBeforeTheHeaderIsPassedOver) {
  const TemporaryFolder folder;
  const auto file =
      folder.write("a.txt",
                   "*** Some program, x, y\n*** Step size: x 35 y "
                   "35\nid,Y,X,V,U,ok\n0,2,1,-0.2,0.1,1\n1,4,3,-0.4,0.3,0\n2,6,5,nan,0.5,1\n3,8,7,-8e-1,7e-1,true\n"
                   "4,10,9,-1,0.9,-1\n5,12,11,-1,0.9,nan\n");
  const auto table = read_points(file, {.x = "X", .y = "Y", .u = "U", .v = "V", .valid = "ok"});
  ASSERT_EQ(table.at.rows(), 2);  // three were lost, one has no displacement
  EXPECT_EQ(table.at(1, 0), 7.0);
  EXPECT_EQ(table.at(1, 1), 8.0);
  EXPECT_EQ(table.displacement(0, 0), 0.1);
  EXPECT_EQ(table.displacement(1, 1), -0.8);
}

TEST(Fields, DecimalCommasAndARowOfUnits) {
  const TemporaryFolder folder;
  const auto table =
      read_points(folder.write("a.txt", "made by;hand\nx;y;u;v\n[mm];[mm];[mm];[mm]\n1,5;2;-3e-1;4,0\n"), {});
  ASSERT_EQ(table.at.rows(), 1);
  EXPECT_EQ(table.at(0, 0), 1.5);
  EXPECT_EQ(table.displacement(0, 1), 4.0);
  const auto curve = read_curve(folder.write("b.csv", "e\ts\n(%)\t(MPa)\n0,0\t0\n0,1\t200\n0.2\t210,5\n"),
                                {.strain = "e", .stress = "s", .time = ""});
  ASSERT_EQ(curve.strain.size(), 3);
  EXPECT_EQ(curve.strain[1], 0.1);
  EXPECT_EQ(curve.stress[2], 210.5);
}

TEST(Fields, MistakesAreNamedWithLineAndColumn) {
  EXPECT_EQ(mistakes_in("x,y,u\n1,2,3\n"), "points.csv:1 column \"v\": not there; allowed: one of \"x\", \"y\", \"u\"");
  EXPECT_EQ(mistakes_in("x,y,u,v\n1,,3,4\n1,2,3\n1,2,a,4\n"),
            "points.csv:2 column \"y\": nothing; allowed: a finite number\n"
            "points.csv:3 column \"v\": nothing; allowed: a number, or nan where it is not known\n"
            "points.csv:4 column \"u\": a; allowed: a number, or nan where it is not known");
  EXPECT_EQ(mistakes_in("x,y,u,v\n1,2,nan,nan\n"), "points.csv: no point with a displacement; allowed: one or more");
  EXPECT_EQ(mistakes_in(""), "points.csv: an empty file; allowed: a table of points with a header row");
}

}  // namespace test_fields
}  // namespace imic3d::io
