// Real images, other programs' results. Skipped where the data are not (IMIC3D_DATA). The fields are written as CSV to
// IMIC3D_TEST_OUTPUT (default: imic3d_measured in the temporary folder) for tools/compare_oht_dic.py and
// tools/compare_pcabs_dic.py.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/imaging/noise.hpp"
#include "speckle.hpp"

namespace imic3d::correlation {
namespace test_measured {

namespace fs = std::filesystem;
using namespace test;

fs::path data_folder(const std::string& name) {
  const char* set = std::getenv("IMIC3D_DATA");
  return (set != nullptr ? fs::path(set) : fs::path(IMIC3D_SOURCE_DIRECTORY) / ".." / "shared" / "data") / name;
}

std::ofstream output(const std::string& name) {
  const char* set = std::getenv("IMIC3D_TEST_OUTPUT");
  const fs::path folder = set != nullptr ? fs::path(set) : fs::temp_directory_path() / "imic3d_measured";
  fs::create_directories(folder);
  std::ofstream file(folder / name);
  file.precision(9);
  return file;
}

/// The elements of a rectangle for which `keep` holds at every corner, with their nodes only.
mesh::Mesh where(const mesh::Mesh& quads, const std::function<bool(double x, double y)>& keep) {
  std::vector<int> number(static_cast<std::size_t>(quads.nodes.rows()), -1), nodes;
  std::vector<Eigen::Index> cells;
  for (Eigen::Index e = 0; e < quads.cells.rows(); ++e) {
    bool all = true;
    for (int i = 0; i < 4; ++i) all = all && keep(quads.nodes(quads.cells(e, i), 0), quads.nodes(quads.cells(e, i), 1));
    if (!all) continue;
    cells.push_back(e);
    for (int i = 0; i < 4; ++i)
      if (int& n = number[static_cast<std::size_t>(quads.cells(e, i))]; n < 0) {
        n = static_cast<int>(nodes.size());
        nodes.push_back(quads.cells(e, i));
      }
  }
  mesh::Mesh kept;
  kept.nodes.resize(static_cast<Eigen::Index>(nodes.size()), 3);
  for (std::size_t n = 0; n < nodes.size(); ++n)
    kept.nodes.row(static_cast<Eigen::Index>(n)) = quads.nodes.row(nodes[n]);
  kept.cells.resize(static_cast<Eigen::Index>(cells.size()), 4);
  for (std::size_t e = 0; e < cells.size(); ++e)
    for (int i = 0; i < 4; ++i)
      kept.cells(static_cast<Eigen::Index>(e), i) = number[static_cast<std::size_t>(quads.cells(cells[e], i))];
  return kept;
}

/// Displacement at a point of a mesh of axis-parallel rectangles; NaN outside.
Eigen::Vector2d at_point(const mesh::Mesh& quads, const Eigen::VectorXd& U, double x, double y) {
  for (Eigen::Index e = 0; e < quads.cells.rows(); ++e) {
    const auto a = quads.nodes.row(quads.cells(e, 0)), c = quads.nodes.row(quads.cells(e, 2));
    if (x < a.x() || y < a.y() || x > c.x() || y > c.y()) continue;
    const double s = (x - a.x()) / (c.x() - a.x()), t = (y - a.y()) / (c.y() - a.y());
    const double N[4] = {(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t};
    Eigen::Vector2d u(0, 0);
    for (int i = 0; i < 4; ++i) u += N[i] * U.segment<2>(2 * quads.cells(e, i));
    return u;
  }
  return {NAN, NAN};
}

struct Point {
  double x, y, ux, uy;  // [px]
};

/// The points of a result file of DICe: comment lines, a header, then x, y, ux, uy, …
std::vector<Point> read_dice(const fs::path& file) {
  std::ifstream stream(file);
  std::vector<Point> points;
  std::string line;
  while (std::getline(stream, line)) {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream values(line);
    Point point{};
    if (values >> point.x >> point.y >> point.ux >> point.uy) points.push_back(point);
  }
  return points;
}

// Open-hole tension: DICe worked on columns 500 … 899 of the images, subsets of 27 pixels.
TEST(Measured, OpenHoleTensionAgreesWithDice) {
  const Communicator world;
  const fs::path folder = data_folder("oht_cfrp");
  if (!fs::exists(folder)) GTEST_SKIP() << "oht_cfrp: no folder " << folder << " (set IMIC3D_DATA)";
  constexpr double crop = 500.0;
  const std::vector<int> numbers{53, 54, 57, 58, 61, 62, 65, 66, 69, 70, 75};
  std::vector<fs::path> files;
  for (const int number : numbers) files.push_back(folder / ("zoom-00" + std::to_string(number) + "_1.tif"));
  const imaging::Image reference = imaging::read_image(folder / "zoom-0050_1.tif");
  const double size = 20.0;
  const mesh::Mesh quads = where(rectangle(547, 30, 547 + 15 * size, 30 + 49 * size, 15, 49),
                                 [](double x, double y) { return std::hypot(x - 693.0, y - 541.0) > 55.0; });
  const GlobalDic dic(quads, *camera(), reference, {.brightness = true}, "mesh");
  const std::vector<DicFrame> frames = dic.run(world, files);
  const Eigen::VectorXd deviation = dic.standard_deviation(1.0, 1);

  std::ofstream csv;
  if (world.is_root()) {
    csv = output("oht_cfrp.csv");
    csv << "order,x_px,y_px,ux_px,uy_px,dice_ux_px,dice_uy_px\n";
  }
  for (std::size_t t = 0; t < frames.size(); ++t) {
    const std::string order = (t + 1 < 10 ? "0" : "") + std::to_string(t + 1);
    double squares_x = 0.0, squares_y = 0.0, count = 0.0;
    std::vector<double> size_of;
    for (const Point& point : read_dice(folder / "DICe_reference_results" / ("DICe_solution_" + order + ".txt"))) {
      const Eigen::Vector2d u = at_point(quads, frames[t].displacement, point.x + crop, point.y);
      csv << t + 1 << ',' << point.x + crop << ',' << point.y << ',' << u.x() << ',' << u.y() << ',' << point.ux << ','
          << point.uy << '\n';
      if (!u.allFinite()) continue;
      squares_x += std::pow(u.x() - point.ux, 2), squares_y += std::pow(u.y() - point.uy, 2), count += 1.0;
      size_of.push_back(std::hypot(u.x() - point.ux, u.y() - point.uy));
    }
    ASSERT_GT(count, 200.0) << order;
    std::nth_element(size_of.begin(), size_of.begin() + static_cast<std::ptrdiff_t>(size_of.size() / 2), size_of.end());
    const double rms = std::sqrt((squares_x + squares_y) / (2.0 * count));
    if (world.is_root())
      std::cout << "[          ] order " << order << ": rms difference x " << std::sqrt(squares_x / count) << " y "
                << std::sqrt(squares_y / count) << " px, median distance " << size_of[size_of.size() / 2] << " px at "
                << count << " points; residual " << frames[t].rms << " grey levels, coefficient "
                << frames[t].coefficient << ", gain " << frames[t].gain << (frames[t].converged ? "" : " NOT CONVERGED")
                << (frames[t].lost ? " LOST" : "") << ", expected noise "
                << frames[t].rms / std::sqrt(2.0) * deviation.norm() / std::sqrt(static_cast<double>(deviation.size()))
                << " px\n";
    EXPECT_FALSE(frames[t].lost) << order;
    EXPECT_LT(rms, 0.01) << order;  // 0.006 px measured: the noise of both
  }
}

// Injection-moulded tensile bar: frame 8 against 0; the laboratory's own result is compared by
// tools/compare_pcabs_dic.py.
TEST(Measured, TensileBarFieldIsWrittenForComparison) {
  const Communicator world;
  const fs::path folder = data_folder("pcabs_tension");
  if (!fs::exists(folder)) GTEST_SKIP() << "pcabs_tension: no folder " << folder << " (set IMIC3D_DATA)";
  std::vector<fs::path> files;
  std::vector<imaging::Image> still;
  for (const int frame : {0, 1, 2})
    still.push_back(imaging::read_image(folder / "images" / ("frame_00" + std::to_string(frame) + ".png")));
  for (const int frame : {1, 2, 8}) files.push_back(folder / "images" / ("frame_00" + std::to_string(frame) + ".png"));
  const mesh::Mesh quads = rectangle(305, 158, 305 + 26 * 20, 158 + 14 * 20, 26, 14);
  const GlobalDic dic(quads, *camera(), still.front(), {}, "mesh");
  const std::vector<DicFrame> frames = dic.run(world, files);
  const imaging::Image mask = footprint(dic.correlation().quadrature(), still[0].width, still[0].height);
  const double noise = imaging::noise_of_static_frames(still, &mask);
  const Eigen::VectorXd deviation = dic.standard_deviation(noise, 1);
  for (const DicFrame& frame : frames) {
    EXPECT_TRUE(frame.converged && !frame.lost);
    if (world.is_root())
      std::cout << "[          ] residual " << frame.rms << " grey levels, noise of a frame " << noise << ", rms |u| "
                << frame.displacement.norm() / std::sqrt(static_cast<double>(frame.displacement.size()))
                << " px, predicted noise " << deviation.norm() / std::sqrt(static_cast<double>(deviation.size()))
                << " px\n";
  }
  if (!world.is_root()) return;
  std::ofstream csv = output("pcabs_tension.csv");
  csv << "frame,x_px,y_px,ux_px,uy_px,deviation_x_px,deviation_y_px\n";
  for (std::size_t t = 0; t < 3; ++t)
    for (int n = 0; n < dic.correlation().nodes(); ++n)
      csv << (t < 2 ? t + 1 : 8) << ',' << quads.nodes(n, 0) << ',' << quads.nodes(n, 1) << ','
          << frames[t].displacement[2 * n] << ',' << frames[t].displacement[2 * n + 1] << ',' << deviation[2 * n] << ','
          << deviation[2 * n + 1] << '\n';
}

}  // namespace test_measured
}  // namespace imic3d::correlation
