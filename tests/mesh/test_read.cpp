#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "meshes.hpp"

namespace imic3d::mesh {
namespace test_read {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

/// Two squares side by side, the second clockwise, an unused node, a line in two groups (twice in the file).
constexpr const char* gmsh_22 = R"($MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
4
0 9 "corner"
1 1 "left"
1 2 "held"
2 3 "specimen"
$EndPhysicalNames
$Nodes
7
10 0 0 0
20 1 0 0
30 1 1 0
40 0 1 0
99 5 5 5
50 2 0 0
60 2 1 0
$EndNodes
$Elements
6
1 15 2 9 1 60
2 1 2 1 1 10 40
2 1 2 2 1 10 40
3 3 2 3 1 10 20 30 40
4 3 2 3 2 20 30 60 50
5 8 2 1 1 10 40 99
$EndElements
)";

constexpr const char* gmsh_41 = R"($MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
4
0 9 "corner"
1 1 "left"
1 2 "held"
2 3 "specimen"
$EndPhysicalNames
$Entities
1 1 2 0
4 2 1 0 1 9
1 0 0 0 0 1 0 2 -1 2 2 1 -2
1 0 0 0 1 1 0 1 3 0
2 1 0 0 2 1 0 1 3 0
$EndEntities
$Nodes
2 7 10 99
1 1 1 2
10
40
0 0 0 0
0 1 0 1
2 1 0 5
20
30
99
50
60
1 0 0
1 1 0
5 5 5
2 0 0
2 1 0
$EndNodes
$Elements
4 4 1 4
0 4 15 1
1 60
1 1 1 1
2 10 40
2 1 3 1
3 10 20 30 40
2 2 3 1
4 20 30 60 50
$EndElements
)";

constexpr const char* abaqus = R"(*HEADING
two squares
** a comment
*PART, NAME=Part-1
*Node, nset=all
10, 0., 0.
20, 1.0E+0, 0.,
30, +1.0, 1.0D0, 0.
40, 0, 1, 0
99, 5, 5, 5
50, 2, 0, 0
60, 2, 1, 0
*ELEMENT, TYPE=CPS4R,
 ELSET=specimen
3, 10, 20,
30, 40
4, 20, 30, 60, 50
*ELEMENT, TYPE=MASS, ELSET=point
5, 99
*NSET, NSET=left
10, 40, 99
*NSET, NSET=held, GENERATE
10, 40, 30
*NSET, NSET=corner
60
*NSET, NSET=both
left, Corner
*ELSET, ELSET=second
4
*SURFACE, NAME=end, TYPE=ELEMENT
second, S3
*END PART
*ASSEMBLY, NAME=A
*INSTANCE, NAME=Part-1-1, PART=Part-1
*END INSTANCE
*END ASSEMBLY
)";

void expect_two_squares(const Mesh& mesh, const std::vector<double>& x) {
  ASSERT_EQ(mesh.type, CellType::quad4);
  ASSERT_EQ(mesh.nodes.rows(), 6);
  ASSERT_EQ(mesh.cells.rows(), 2);
  for (Eigen::Index i = 0; i < 6; ++i) EXPECT_EQ(mesh.nodes(i, 0), x[static_cast<std::size_t>(i)]);
  EXPECT_NEAR(measure(mesh), 2.0, 1e-15);
  EXPECT_THAT(check(mesh, "squares"), SizeIs(0));
  EXPECT_THAT(mesh.cell_groups.at("specimen"), ElementsAre(0, 1));
  EXPECT_THAT(mesh.node_groups.at("left"), SizeIs(2));
  EXPECT_EQ(mesh.node_groups.at("held"), mesh.node_groups.at("left"));
  EXPECT_THAT(mesh.node_groups.at("corner"), ElementsAre(5));
}

TEST(Read, Gmsh22) {
  const TemporaryFile file("a.msh", gmsh_22);
  const Mesh mesh = read(file.path);
  expect_two_squares(mesh, {0, 1, 1, 0, 2, 2});
  ASSERT_EQ(mesh.facet_groups.at("left").rows(), 1);
  EXPECT_EQ(mesh.facet_groups.at("left")(0, 0), 3);  // downwards: counter-clockwise around the mesh
  EXPECT_EQ(mesh.facet_groups.at("held").rows(), 1);
}

TEST(Read, Gmsh41) {
  const TemporaryFile file("b.msh", gmsh_41);
  const Mesh mesh = read(file.path);
  expect_two_squares(mesh, {0, 0, 1, 1, 2, 2});
  EXPECT_EQ(mesh.facet_groups.at("held").rows(), 1);
}

TEST(Read, Abaqus) {
  const TemporaryFile file("c.inp", abaqus);
  const Mesh mesh = read(file.path);
  expect_two_squares(mesh, {0, 1, 1, 0, 2, 2});
  EXPECT_THAT(mesh.node_groups.at("both"), SizeIs(3));
  ASSERT_EQ(mesh.facet_groups.at("end").rows(), 1);  // nodes 60 and 50, x = 2
  EXPECT_THAT(mesh.node_groups.at("end"), ElementsAre(4, 5));
  EXPECT_EQ(mesh.facet_groups.at("end")(0, 0), 4);
}

std::string hexahedron_22(bool reversed) {
  const std::string cell = reversed ? "5 6 7 8 1 2 3 4" : "1 2 3 4 5 6 7 8";
  return "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 7 \"side\"\n3 1 \"body\"\n$EndPhysicalNames\n"
         "$Nodes\n8\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n5 0 0 1\n6 1 0 1\n7 1 1 1\n8 0 1 1\n$EndNodes\n"
         "$Elements\n2\n1 3 2 7 1 1 2 6 5\n2 5 2 1 1 " +
         cell + "\n$EndElements\n";
}

TEST(Read, HexahedraWithTheirFront) {
  for (bool reversed : {false, true}) {
    const TemporaryFile file("d.msh", hexahedron_22(reversed));
    Mesh mesh = read(file.path);
    EXPECT_NEAR(measure(mesh), 1.0, 1e-14);
    ASSERT_EQ(mesh.front.rows(), 1);
    for (int node : mesh.front.row(0)) EXPECT_EQ(mesh.nodes(node, 2), 1.0);
    choose_front(mesh, "side");
    ASSERT_EQ(mesh.front.rows(), 1);
    for (int node : mesh.front.row(0)) EXPECT_EQ(mesh.nodes(node, 1), 0.0);
    EXPECT_THROW(choose_front(mesh, "nothing"), InputError);
    const auto weights = front_surface(mesh).weights;
    ASSERT_EQ(weights.rows(), 4);
    const std::vector<int> expected = {0, 1, 4, 5};
    for (int i = 0; i < 4; ++i) EXPECT_EQ(weights.coeff(i, expected[static_cast<std::size_t>(i)]), 1.0);
  }
}

TEST(Read, HexahedraFromAbaqus) {
  const TemporaryFile file("e.inp", R"(*NODE
1,0,0,0
2,1,0,0
3,1,1,0
4,0,1,0
5,0,0,1
6,1,0,1
7,1,1,1
8,0,1,1
*ELEMENT, TYPE=C3D8R, ELSET=body
1, 1,2,3,4,5,6,7,8
*NSET, NSET=seen
5,6,7,8
*SURFACE, NAME=right
body, S4
)");
  Mesh mesh = read(file.path);
  choose_front(mesh, "seen");
  for (int node : mesh.front.row(0)) EXPECT_EQ(mesh.nodes(node, 2), 1.0);
  choose_front(mesh, "right");
  for (int node : mesh.front.row(0)) EXPECT_EQ(mesh.nodes(node, 0), 1.0);
}

std::string message_of(const std::string& name, const std::string& text) {
  const TemporaryFile file(name, text);
  try {
    (void)read(file.path);
  } catch (const InputError& error) {
    return error.what();
  }
  return "no error";
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos);
  return text.replace(at, from.size(), to);
}

TEST(Read, MistakesAreSaidWithTheirPlace) {
  EXPECT_THROW((void)read("nowhere.msh"), InputError);
  EXPECT_THROW((void)read("mesh.vtk"), InputError);
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "3 3 2 3 1 10 20 30 40", "3 2 2 3 1 10 20 30")),
              HasSubstr("1 3-node triangles; allowed: 4-node quadrilaterals"));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "2.2 0 8", "4 0 8")),
              HasSubstr("f.msh:2: Gmsh format 4; allowed: 2.2"));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "2.2 0 8", "2.2 1 8")), HasSubstr("binary"));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "30 1 1 0", "30 1 one 0")), HasSubstr("f.msh:15: \"one\""));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "30 1 1 0", "30 1 nan 0")), HasSubstr("f.msh:15: \"nan\""));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "30 1 1 0", "30 0.1 0.1 0")),
              HasSubstr("element 3 at (0.275, 0.275, 0): inverted"));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "10 20 30 40", "10 20 31 40")), HasSubstr("element 3: node 31"));
  EXPECT_THAT(message_of("f.msh", replaced(gmsh_22, "30 1 1 0", "10 1 1 0")), HasSubstr("node 10 is there twice"));
  EXPECT_THAT(message_of("f.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n2\n1 0 0 0\n"),
              HasSubstr("the file ends"));
  EXPECT_THAT(message_of("f.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"),
              testing::AllOf(HasSubstr("no quadrilaterals"), HasSubstr("there must be a Physical Surface")));
  EXPECT_THAT(message_of("f.msh", ""), HasSubstr("no $MeshFormat"));
  EXPECT_THAT(message_of("f.inp", "*INCLUDE, INPUT=other.inp\n"), HasSubstr("f.inp:1: *INCLUDE"));
  EXPECT_THAT(message_of("f.inp", replaced(abaqus, "CPS4R", "C3D10")), HasSubstr("tetrahedra"));
  EXPECT_THAT(message_of("f.inp", replaced(abaqus, "10, 0., 0.", "10, , 0.")), HasSubstr("empty coordinate"));
  EXPECT_THAT(message_of("f.inp", replaced(abaqus, "left, Corner", "left, Corners")), HasSubstr("set Corners"));
}

/// The folder of measured data, or an empty path.
std::filesystem::path data_directory() {
  const char* variable = std::getenv("IMIC3D_DATA");
  const std::filesystem::path path = variable != nullptr
                                         ? std::filesystem::path(variable)
                                         : std::filesystem::path(IMIC3D_SOURCE_DIRECTORY) / "../shared/data";
  return std::filesystem::is_directory(path) ? path : std::filesystem::path();
}

TEST(Read, MeasuredDataPlateIndependent) {
  if (data_directory().empty()) GTEST_SKIP() << "measured data not found (IMIC3D_DATA)";
  const Mesh mesh = read(data_directory() / "plate_independent" / "mesh.msh");
  EXPECT_EQ(mesh.nodes.rows(), 240);
  EXPECT_NEAR(measure(mesh), 20.0 * 24.0 - std::acos(-1.0) * 6.25, 0.15);
  EXPECT_THAT(contours(mesh), SizeIs(2));
  EXPECT_TRUE(mesh.facet_groups.contains("hole"));
}

TEST(Read, MeasuredDataOpenHoleTension) {
  if (data_directory().empty()) GTEST_SKIP() << "measured data not found (IMIC3D_DATA)";
  const Mesh mesh = read(data_directory() / "oht_cfrp" / "abaqus_q4_m.inp");
  EXPECT_EQ(mesh.type, CellType::quad4);
  EXPECT_THAT(contours(mesh), SizeIs(2));
  try {
    (void)read(data_directory() / "oht_cfrp" / "gmsh_t3_mm.msh");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("triangles"));
  }
}

}  // namespace test_read
}  // namespace imic3d::mesh
