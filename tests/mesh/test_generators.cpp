// The mesh generators in tools/meshes, run with various parameters.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "imic3d/core/parallel.hpp"
#include "meshes.hpp"

namespace imic3d::mesh {
namespace test_generators {

using ::testing::SizeIs;

/// The smallest sine of a corner's angle.
double smallest_sine(const Mesh& mesh) {
  double smallest = 1.0;
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector3d at = mesh.nodes.row(mesh.cells(c, k));
      const Eigen::Vector3d a = mesh.nodes.row(mesh.cells(c, (k + 1) % 4)).transpose() - at;
      const Eigen::Vector3d b = mesh.nodes.row(mesh.cells(c, (k + 3) % 4)).transpose() - at;
      smallest = std::min(smallest, a.cross(b).z() / (a.norm() * b.norm()));
    }
  return smallest;
}

class Generator : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!Communicator{}.is_root()) GTEST_SKIP() << "on rank 0 only";
    if (std::system("command -v gmsh >/dev/null") != 0) GTEST_SKIP() << "gmsh is not installed";
  }

  static Mesh generate(const std::string& script, const std::string& parameters) {
    const auto file =
        std::filesystem::temp_directory_path() / ("imic3d_" + std::to_string(getpid()) + "_generated.msh");
    const std::string command = "gmsh -2 -v 1 -format msh41 " + parameters +
                                " " IMIC3D_SOURCE_DIRECTORY "/tools/meshes/" + script + " -o " + file.string() +
                                " 2>&1";
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    Mesh mesh = read(file);
    std::filesystem::remove(file);
    return mesh;
  }
};

TEST_F(Generator, PlateWithAHole) {
  struct {
    const char* parameters;
    double width, length, diameter;
  } const cases[] = {{"", 20, 24, 5},
                     {"-setnumber length 60 -setnumber size_hole 0.2 -setnumber size_far 0.5", 20, 60, 5},
                     {"-setnumber size_far 2", 20, 24, 5},
                     {"-setnumber length 20 -setnumber size_hole 0.8", 20, 20, 5},
                     {"-setnumber width 30 -setnumber diameter 15", 30, 24, 15}};
  for (const auto& plate : cases) {
    const Mesh mesh = generate("plate_with_hole.geo", plate.parameters);
    EXPECT_NEAR(measure(mesh), plate.width * plate.length - std::acos(-1.0) * plate.diameter * plate.diameter / 4,
                0.03 * plate.diameter * plate.diameter);
    EXPECT_GT(smallest_sine(mesh), 0.6) << plate.parameters;
    EXPECT_THAT(contours(mesh), SizeIs(2));
    EXPECT_THAT(mesh.cell_groups.at("specimen"), SizeIs(mesh.cells.rows()));
    for (int node : mesh.node_groups.at("top")) EXPECT_EQ(mesh.nodes(node, 1), plate.length / 2);
    for (int node : mesh.node_groups.at("bottom")) EXPECT_EQ(mesh.nodes(node, 1), -plate.length / 2);
    for (int node : mesh.node_groups.at("sides")) EXPECT_EQ(std::abs(mesh.nodes(node, 0)), plate.width / 2);
    for (int node : mesh.node_groups.at("hole")) EXPECT_NEAR(mesh.nodes.row(node).norm(), plate.diameter / 2, 1e-6);
    Eigen::Index edges = 0;
    for (const auto& [name, facets] : mesh.facet_groups) edges += facets.rows();
    EXPECT_EQ(edges, boundary_facets(mesh).nodes.rows());
  }
}

TEST_F(Generator, Dumbbell) {
  for (const double region : {10.0, 34.0, 36.0, 80.0}) {
    const Mesh mesh = generate("dumbbell.geo", "-setnumber region " + std::to_string(region));
    EXPECT_GT(smallest_sine(mesh), 0.6) << region;
    EXPECT_THAT(contours(mesh), SizeIs(1));
    for (int node : mesh.node_groups.at("left")) EXPECT_NEAR(mesh.nodes(node, 0), -region / 2, 1e-12);
    for (int node : mesh.node_groups.at("right")) EXPECT_NEAR(mesh.nodes(node, 0), region / 2, 1e-12);
    for (int node : mesh.node_groups.at("sides")) {
      const double x = std::abs(mesh.nodes(node, 0)), y = std::abs(mesh.nodes(node, 1));
      const double outline = x <= 6.0 ? 6.0 : x <= 18.0 ? 26.0 - std::sqrt(400.0 - (x - 6.0) * (x - 6.0)) : 10.0;
      EXPECT_NEAR(y, outline, 1e-6) << x;
    }
    Eigen::Index edges = 0;
    for (const auto& [name, facets] : mesh.facet_groups) edges += facets.rows();
    EXPECT_EQ(edges, boundary_facets(mesh).nodes.rows());
  }
}

}  // namespace test_generators
}  // namespace imic3d::mesh
