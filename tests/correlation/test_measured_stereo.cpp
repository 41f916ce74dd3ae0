// gt4_stereo: two cameras together against each camera alone. Skipped where the data are not (IMIC3D_DATA).
#include <gtest/gtest.h>

#include <cstdlib>

#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/correlation/specimen_pose.hpp"
#include "imic3d/imaging/calibration.hpp"
#include "speckle.hpp"

namespace imic3d::correlation {
namespace test_measured_stereo {

namespace fs = std::filesystem;
using namespace test;

const Communicator alone{MPI_COMM_SELF};

fs::path data() {
  const char* set = std::getenv("IMIC3D_DATA");
  return (set != nullptr ? fs::path(set) : fs::path(IMIC3D_SOURCE_DIRECTORY) / ".." / "shared" / "data") / "gt4_stereo";
}

/// The web below the slot [mm].
mesh::Mesh web() {
  const mesh::Mesh all = rectangle(-44.0, -18.0, 44.0, 8.0, 44, 13);
  mesh::Mesh kept = all;
  Eigen::Index count = 0;
  for (Eigen::Index e = 0; e < all.cells.rows(); ++e) {
    bool inside = true;
    for (int i = 0; i < 4; ++i) {
      const double x = all.nodes(all.cells(e, i), 0), y = all.nodes(all.cells(e, i), 1);
      inside = inside && y >= -18.5 + 0.009 * (x + 2.0) * (x + 2.0);
    }
    if (inside) kept.cells.row(count++) = all.cells.row(e);
  }
  kept.cells.conservativeResize(count, 4);
  std::vector<int> number(static_cast<std::size_t>(all.nodes.rows()), -1);
  Eigen::Index nodes = 0;
  for (Eigen::Index e = 0; e < count; ++e)
    for (int i = 0; i < 4; ++i) {
      int& n = number[static_cast<std::size_t>(kept.cells(e, i))];
      if (n < 0) n = static_cast<int>(nodes), kept.nodes.row(nodes++) = all.nodes.row(kept.cells(e, i));
      kept.cells(e, i) = n;
    }
  kept.nodes.conservativeResize(nodes, 3);
  return kept;
}

TEST(MeasuredStereo, TriangulationOfEachCameraAloneAgrees) {
  if (!fs::exists(data())) GTEST_SKIP() << "no data folder gt4_stereo (IMIC3D_DATA)";
  mesh::Mesh quads = web();
  std::vector<RigView> rig;
  const auto calibrated = imaging::read_calibration(data() / "cal.xml");
  for (int c = 0; c < 2; ++c)
    rig.push_back({calibrated.at(static_cast<std::size_t>(c)).camera(),
                   imaging::read_image(data() / ("GT4-0000_" + std::to_string(c) + ".tif"))});
  const std::vector<PlacedPoint> points = {{-48.444, 17.787, 150, 300},
                                           {42.534, 16.87, 1700, 300},
                                           {42.506, -2.921, 1700, 650},
                                           {-45.458, -2.846, 200, 650},
                                           {-0.04, -17.313, 960, 900}};
  const SpecimenPose pose = find_pose(quads, rig, points, {.shape = 15.0});
  EXPECT_LT(pose.rms_shape, 0.25);
  EXPECT_EQ(pose.matched, pose.patches);
  quads.nodes.col(2) += pose.shape;

  const DicOptions options{.low_pass = 1.0, .border = 3.0, .local_brightness = true};
  std::vector<View> views;
  std::vector<std::vector<fs::path>> images(2);
  for (std::size_t c = 0; c < 2; ++c) {
    views.push_back(
        {.camera = std::make_shared<imaging::PinholeCamera>(pose.cameras[c]), .reference = rig[c].reference});
    for (const char* frame : {"0001", "0003", "0005", "0273"})
      images[c].push_back(data() / ("GT4-" + std::string(frame) + "_" + std::to_string(c) + ".tif"));
  }
  const GlobalDic together(quads, views, 3, options);
  EXPECT_TRUE(together.cameras().hardly_seen(together.cameras().M()).empty());
  const auto stereo = together.run(alone, images);
  std::vector<std::vector<InImage>> own(2);  // [camera][frame]
  for (std::size_t c = 0; c < 2; ++c) {
    const GlobalDic dic(quads, views[c].camera, rig[c].reference, options, "camera");
    for (const DicFrame& frame : dic.run(alone, images[c]))
      own[c].push_back(dic.correlation().pixel_displacement(frame.displacement));
  }
  double noise = 0.0;
  for (std::size_t t = 0; t < 4; ++t) {
    EXPECT_TRUE(stereo[t].converged && !stereo[t].lost);
    double in_plane = 0.0, through = 0.0, largest_gap = 0.0;
    const auto n = static_cast<double>(quads.nodes.rows());
    for (Eigen::Index i = 0; i < quads.nodes.rows(); ++i) {
      const Eigen::Vector3d X = quads.nodes.row(i).transpose();
      std::vector<Eigen::Vector2d> pixels;
      for (std::size_t c = 0; c < 2; ++c)
        pixels.emplace_back(pose.cameras[c].project(X) + own[c][t].row(i).transpose());
      const Triangulated found = triangulate(pose.cameras, pixels);
      const Eigen::Vector3d difference = found.point - X - stereo[t].displacement.segment<3>(3 * i);
      in_plane += difference.head<2>().squaredNorm() / (2.0 * n), through += difference[2] * difference[2] / n;
      largest_gap = std::max(largest_gap, found.gap);
    }
    if (t == 0) {
      const double sigma = stereo[0].rms / (together.noise_response().level * std::sqrt(2.0));
      noise = together.standard_deviation(sigma, 1).norm() / std::sqrt(n);
    }
    std::cout << "[          ] frame " << images[0][t].filename().string()
              << ": cameras together against each alone, rms " << 1000 * std::sqrt(in_plane) << " um in the plane, "
              << 1000 * std::sqrt(through) << " um through it; rays miss each other by at most " << 1000 * largest_gap
              << " um; noise of a node " << 1000 * noise << " um; residuals " << stereo[t].cameras[0].rms << ", "
              << stereo[t].cameras[1].rms << "; mean u_z "
              << 1000 * stereo[t].displacement.reshaped(3, quads.nodes.rows()).row(2).mean() << " um\n";
    EXPECT_LT(std::sqrt(in_plane), 0.1 * noise);
    EXPECT_LT(std::sqrt(through), 0.5 * noise);
  }
}

}  // namespace test_measured_stereo
}  // namespace imic3d::correlation
