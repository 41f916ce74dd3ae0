#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "../../src/io/svg_plot.hpp"
#include "example_run.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/report.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_report {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(SvgPlot, TicksAreRound) {
  EXPECT_THAT(round_ticks(0.0, 1.0), ElementsAre(0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0));
  EXPECT_THAT(round_ticks(-3.0, 27.0, 3), ElementsAre(0.0, 10.0, 20.0));
}

TEST(SvgPlot, NaNBreaksTheLine) {
  const double n = std::nan("");
  const auto text =
      svg({.title = "a < b", .x_label = "x", .y_label = "y", .curves = {{"c", {0, 1, 2, 3}, {0, 1, n, 1}}}});
  EXPECT_THAT(text, HasSubstr("a &lt; b"));
  EXPECT_THAT(text, Not(HasSubstr("nan")));
  EXPECT_EQ(std::count(text.begin(), text.end(), 'M'), 2);
  EXPECT_THAT(svg({.title = "", .x_label = "", .y_label = "", .curves = {{"c", {}, {}}}}), Not(HasSubstr("nan")));
}

TEST(SvgPlot, BandsAndShadesLieBehindTheCurves) {
  const auto text = svg({.title = "",
                         .x_label = "",
                         .y_label = "",
                         .curves = {{"c", {0, 1, 2}, {0, 1, 0}}},
                         .bands = {{"b", {0, 1, 2}, {-4, -4, -4}, {4, std::nan(""), 4}}},
                         .shaded = {{0.5, 1.5}}});
  const auto shade = text.find("class=\"shaded\""), band = text.find("class=\"band\""),
             curve = text.find("fill=\"none\"");
  EXPECT_LT(shade, band);
  EXPECT_LT(band, curve);
  EXPECT_THAT(text, Not(HasSubstr("nan")));
  EXPECT_THAT(text, HasSubstr(">-4</text>"));  // the axis holds the band
  EXPECT_EQ(std::count(text.begin() + static_cast<std::ptrdiff_t>(band),
                       text.begin() + static_cast<std::ptrdiff_t>(text.find("Z", band)), 'L'),
            3);  // two corners above, two below
  EXPECT_THAT(text, HasSubstr(">b</text>"));
}

TEST(Pictures, APartOfTheCellsIsAZoom) {
  const TemporaryFolder folder;
  mesh::Mesh mesh = example_mesh(false);
  std::vector<double> positions, values(static_cast<std::size_t>(mesh.nodes.rows()), 1.0);
  for (const auto& at : mesh.nodes.rowwise()) positions.insert(positions.end(), {at[0], at[1]});
  const auto coloured = [&](const char* name) {
    draw_field(folder.path() / name, mesh, positions, values, {.legend = "", .lower = -2.0, .upper = 2.0});
    const cv::Mat picture = cv::imread((folder.path() / name).string());
    cv::Mat of_colour;
    cv::inRange(picture, picture.at<cv::Vec3b>(40, 30), picture.at<cv::Vec3b>(40, 30), of_colour);
    return cv::countNonZero(of_colour) / (1.0 * picture.total());
  };
  const double all = coloured("all.png");
  mesh.cells.conservativeResize(1, Eigen::NoChange);
  EXPECT_GT(coloured("one.png"), 0.5 * all);  // one cell fills the picture
}

TEST(Pictures, TheMeshIsDrawnWhereItsPixelsAre) {
  const TemporaryFolder folder;
  const auto mesh = example_mesh(false);
  std::vector<double> pixels;
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
    pixels.push_back(40 + 20 * mesh.nodes(i, 0));
    pixels.push_back(180 - 20 * mesh.nodes(i, 1));
  }
  for (int type : {CV_8U, CV_16U}) {
    cv::imwrite((folder.path() / "image.tif").string(), cv::Mat(200, 160, type, cv::Scalar(100)));
    draw_mesh_on_image(folder.path() / "mesh_on_image.png", folder.path() / "image.tif", mesh, pixels);
    const cv::Mat picture = cv::imread((folder.path() / "mesh_on_image.png").string());
    ASSERT_EQ(picture.size(), cv::Size(160, 200));
    const auto plain = picture.at<cv::Vec3b>(5, 5);
    EXPECT_NE(picture.at<cv::Vec3b>(100, 60), plain);   // a node
    EXPECT_EQ(picture.at<cv::Vec3b>(110, 150), plain);  // off the mesh
  }
  EXPECT_THROW(draw_mesh_on_image(folder.path() / "a.png", folder.path() / "none.tif", mesh, pixels), InputError);
  EXPECT_THROW(draw_mesh_on_image("/proc/a.png", folder.path() / "image.tif", mesh, pixels), InputError);
}

TEST(Pictures, ColoursDivergeAboutZero) {
  const TemporaryFolder folder;
  std::vector<double> values(500 * 500, 0.0);
  for (std::size_t i = 0; i < 100000; ++i) values[i] = i < 50000 ? -4.0 : std::nan("");
  draw_map(folder.path() / "map.png", values, 500, 500, {.legend = "residual [sigma]", .lower = -4, .upper = 4});
  const cv::Mat picture = cv::imread((folder.path() / "map.png").string());
  const auto at = [&](int row) { return picture.at<cv::Vec3b>(row + 28, 100); };
  EXPECT_GT(at(50)[0], at(50)[2]);               // blue
  EXPECT_EQ(at(150), cv::Vec3b(255, 255, 255));  // NaN
  EXPECT_EQ(at(400), cv::Vec3b(240, 240, 240));  // zero
}

TEST(Report, IsSelfContained) {
  const TemporaryFolder folder;
  const auto file = example_run(folder.path());
  const auto drawn = draw_pictures(file, folder.path());
  EXPECT_EQ(drawn.size(), 1U);  // DIC displacement
  write_report(folder.path() / "report.html", file, pictures_in(folder.path()));
  std::ifstream stream(folder.path() / "report.html");
  const std::string page((std::istreambuf_iterator<char>(stream)), {});
  EXPECT_THAT(page, HasSubstr("<h1>Strip &lt;of&gt; steel &amp; copper</h1>"));
  EXPECT_THAT(page, HasSubstr("<td>284.00</td><td>0.50</td>"));
  EXPECT_THAT(page, HasSubstr("<td>198000</td><td>200</td>"));
  EXPECT_THAT(page, HasSubstr("fixed"));
  EXPECT_THAT(page, Not(HasSubstr(">nan<")));
  EXPECT_THAT(page, Not(HasSubstr("http:")));
  std::size_t images = 0;
  for (auto at = page.find("data:image/png"); at != std::string::npos; at = page.find("data:image/png", at + 1))
    ++images;
  EXPECT_EQ(images, 1U);
}

TEST(Pictures, ALostFrameIsNotShownAsDisplacement) {
  const TemporaryFolder folder;
  auto file = example_run(folder.path());
  auto u = file.read("dic/displacement", 10);
  std::fill(u.begin(), u.end(), std::nan(""));
  write_dic_frame(file, 10, u, 9.0, file.read("residual/element_dic", 10));
  EXPECT_EQ(draw_pictures(file, folder.path()).front().filename(), "dic_displacement_frame_0018.png");
}

TEST(Report, OfARunThatHasNothingYet) {
  const TemporaryFolder folder;
  Case test;
  test.title = "empty";
  const auto file = create_results(folder.path(), test, {});
  write_report(folder.path() / "report.html", file);
  EXPECT_TRUE(draw_pictures(file, folder.path()).empty());
}

}  // namespace test_report
}  // namespace imic3d::io
