#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "imic3d/mesh/connectivity.hpp"
#include "meshes.hpp"

namespace imic3d::mesh {
namespace test_mesh {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;
using ::testing::SizeIs;

TEST(Check, AGoodMeshHasNoMistakes) {
  EXPECT_THAT(check(grid(3, 2), "grid"), SizeIs(0));
  EXPECT_THAT(check(extrude(grid(3, 2), 2.0, 3), "block"), SizeIs(0));
}

TEST(Check, InvertedDegenerateAndFoldedCellsAreNamed) {
  Mesh inverted = grid(3, 2);
  inverted.nodes.row(5) << 2.9, 1.9, 0.0;  // an inner node beyond the opposite corner
  ASSERT_FALSE(check(inverted, "grid").empty());
  EXPECT_THAT(check(inverted, "grid")[0].message(), HasSubstr("cell"));
  EXPECT_THAT(check(inverted, "grid")[0].message(), HasSubstr("inverted"));

  Mesh repeated = grid(3, 2);
  repeated.cells(1, 2) = repeated.cells(1, 1);
  ASSERT_THAT(check(repeated, "grid"), SizeIs(1));
  EXPECT_THAT(check(repeated, "grid")[0].message(), HasSubstr("grid cell 1 at"));
  EXPECT_THAT(check(repeated, "grid")[0].message(), HasSubstr("degenerate"));

  Mesh folded = grid(2, 1);  // the second square is laid over the first
  folded.nodes.row(2) << 0.0, 0.0, 0.0;
  folded.nodes.row(5) << 0.0, 1.0, 0.0;
  folded.cells.row(1) << 1, 4, 5, 2;
  ASSERT_THAT(check(folded, "grid"), SizeIs(1));
  EXPECT_THAT(check(folded, "grid")[0].message(), HasSubstr("overlaps its neighbour 0"));

  Mesh block = extrude(grid(2, 2), 1.0, 1);
  block.nodes(4, 2) -= 1.5;  // the middle of the front beyond the back
  EXPECT_THAT(check(block, "block"), SizeIs(4));

  Mesh bent = grid(2, 2);
  bent.nodes(0, 2) = 0.1;
  ASSERT_THAT(check(bent, "grid"), SizeIs(1));
  EXPECT_THAT(check(bent, "grid")[0].message(), HasSubstr("z = 0 and 0.1"));
}

TEST(Extrude, LayersGoDownFromTheCamerasFace) {
  const Mesh quads = grid(3, 2);
  const Mesh hexes = extrude(quads, 1.5, 3);
  EXPECT_EQ(hexes.nodes_per_layer, 12);
  EXPECT_EQ(hexes.nodes.rows(), 48);
  EXPECT_EQ(hexes.cells.rows(), 18);
  EXPECT_NEAR(measure(hexes), 9.0, 1e-12);
  EXPECT_EQ(hexes.nodes(0, 2), 0.0);
  EXPECT_NEAR(hexes.nodes(36, 2), -1.5, 1e-15);
  EXPECT_TRUE(hexes.front == quads.cells);
  EXPECT_THAT(hexes.node_groups.at("left"), SizeIs(12));
  EXPECT_THAT(hexes.node_groups.at("back"), SizeIs(12));
  EXPECT_EQ(hexes.node_groups.at("back").front(), 36);
  EXPECT_THAT(hexes.cell_groups.at("specimen"), SizeIs(18));

  // Every facet group is a part of the boundary, with its orientation.
  const Facets boundary = boundary_facets(hexes);
  EXPECT_EQ(boundary.nodes.rows(), 2 * 6 + 10 * 3);
  EXPECT_EQ(hexes.facet_groups.at("top").rows(), 9);
  for (const auto& [name, faces] : hexes.facet_groups)
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      const bool found =
          std::any_of(boundary.nodes.rowwise().begin(), boundary.nodes.rowwise().end(), [&](const auto& quad) {
            for (int turn = 0; turn < 4; ++turn) {
              bool same = true;
              for (int k = 0; k < 4; ++k) same = same && quad[k] == faces(f, (k + turn) % 4);
              if (same) return true;
            }
            return false;
          });
      EXPECT_TRUE(found) << name << " " << faces.row(f);
    }
}

TEST(Extrude, BadThicknessAndLayersAreRefused) {
  EXPECT_THROW((void)extrude(grid(1, 1), -8.0, 2), InputError);
  EXPECT_THROW((void)extrude(grid(1, 1), std::nan(""), 2), InputError);
  EXPECT_THROW((void)extrude(grid(1, 1), 1.0, 0), InputError);
  EXPECT_THROW((void)extrude(extrude(grid(1, 1), 1.0, 1), 1.0, 1), InputError);
}

TEST(Refine, QuadsAndHexesKeepMeasureGroupsAndOrder) {
  Mesh coarse = grid(3, 1);  // one cell wide: both ends of the inner edges are in bottom or top
  coarse.nodes(1, 0) += 0.2;
  const Mesh fine = refine(coarse);
  EXPECT_EQ(fine.cells.rows(), 12);
  EXPECT_EQ(fine.nodes.rows(), 21);
  EXPECT_TRUE(fine.nodes.topRows(8) == coarse.nodes);
  EXPECT_NEAR(measure(fine), 3.0, 1e-14);
  EXPECT_THAT(check(fine, "fine"), SizeIs(0));
  EXPECT_THAT(fine.node_groups.at("top"), SizeIs(7));
  EXPECT_THAT(fine.node_groups.at("left"), SizeIs(3));
  EXPECT_EQ(fine.facet_groups.at("top").rows(), 6);
  for (int node : fine.node_groups.at("top")) EXPECT_EQ(fine.nodes(node, 1), 1.0);
  for (int k = 0; k < 4; ++k) EXPECT_EQ(fine.cells(4 + k, k), coarse.cells(1, k));

  Mesh block = extrude(coarse, 2.0, 2);
  block.nodes(5 + 8, 1) += 0.1;
  const Mesh fine_block = refine(block);
  EXPECT_EQ(fine_block.cells.rows(), 48);
  EXPECT_EQ(fine_block.nodes.rows(), 7 * 3 * 5);
  EXPECT_NEAR(measure(fine_block), measure(block), 1e-13);
  EXPECT_THAT(check(fine_block, "fine"), SizeIs(0));
  EXPECT_EQ(fine_block.front.rows(), 12);
  EXPECT_THAT(fine_block.node_groups.at("front"), SizeIs(21));
  EXPECT_THAT(fine_block.node_groups.at("left"), SizeIs(15));
  EXPECT_THAT(fine_block.node_groups.at("top"), SizeIs(35));
  EXPECT_EQ(boundary_facets(fine_block).nodes.rows(), 4 * boundary_facets(block).nodes.rows());
}

TEST(FrontSurface, IsTheMeshThatWasExtruded) {
  const Mesh quads = grid(4, 3);
  const Surface surface = front_surface(extrude(quads, 1.0, 2));
  EXPECT_TRUE(surface.mesh.nodes == quads.nodes);
  EXPECT_TRUE(surface.mesh.cells == quads.cells);
  EXPECT_EQ(surface.weights.rows(), 20);
  EXPECT_EQ(surface.weights.coeff(19, 19), 1.0);
  EXPECT_EQ(surface.weights.sum(), 20.0);
  EXPECT_EQ(surface.mesh.node_groups.at("left"), quads.node_groups.at("left"));
  EXPECT_EQ(surface.mesh.cell_groups.at("specimen"), quads.cell_groups.at("specimen"));
  EXPECT_EQ(surface.mesh.facet_groups.at("top").rows(), 4);
  EXPECT_FALSE(surface.mesh.facet_groups.contains("front"));
}

/// A ring sector of quads: inner radius 2, outer 3, from angle 0 to 1.2, in unequal steps.
Mesh ring_sector() {
  Mesh mesh = grid(6, 2);
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
    const double s = mesh.nodes(i, 0) / 6.0, r = 3.0 - mesh.nodes(i, 1) / 2.0;
    const double angle = 1.2 * s * (0.7 + 0.3 * s);
    mesh.nodes.row(i) << r * std::cos(angle), r * std::sin(angle), 0.0;
  }
  return mesh;
}

bool on_ring(const Eigen::RowVector3d& x) {
  return std::abs(x.head<2>().norm() - 2.0) < 1e-12 || std::abs(x.head<2>().norm() - 3.0) < 1e-12;
}

TEST(Curved, MiddlesOfEdgesLieOnTheContoursCircle) {
  const Mesh ring = ring_sector();
  ASSERT_THAT(check(ring, "ring"), SizeIs(0));
  EXPECT_THAT(bulges(ring), SizeIs(12));  // not the four edges of the straight ends
  const Mesh fine = refine(ring);
  EXPECT_THAT(check(fine, "fine"), SizeIs(0));
  int on = 0;
  for (Eigen::Index i = 0; i < fine.nodes.rows(); ++i) on += on_ring(fine.nodes.row(i)) ? 1 : 0;
  EXPECT_EQ(on, 2 * 13);
  EXPECT_THAT(bulges(grid(5, 3)), SizeIs(0));
}

TEST(Quadratic, GetsMiddlesOfEdgesGroupsAndAFrontOfFourQuadsAFace) {
  const Mesh ring = ring_sector();
  const Mesh hexes = extrude(ring, 1.0, 2), solid = quadratic(hexes);
  EXPECT_EQ(solid.cells.cols(), 20);
  EXPECT_TRUE(solid.nodes.topRows(hexes.nodes.rows()) == hexes.nodes);
  EXPECT_EQ(solid.nodes.rows(), 3 * (21 + 6 * 3 + 7 * 2) + 2 * 21);
  int on = 0;
  for (Eigen::Index i = 0; i < solid.nodes.rows(); ++i) on += on_ring(solid.nodes.row(i)) ? 1 : 0;
  EXPECT_EQ(on, 3 * 2 * 13 + 2 * 2 * 7);
  EXPECT_THAT(solid.node_groups.at("left"), SizeIs(3 * 5 + 2 * 3));
  EXPECT_THAT(solid.node_groups.at("front"), SizeIs(21 + 6 * 3 + 7 * 2));
  const Cells faces = with_middles(solid, solid.front);
  for (Eigen::Index f = 0; f < faces.rows(); ++f)
    for (Eigen::Index k = 0; k < 8; ++k) EXPECT_EQ(solid.nodes(faces(f, k), 2), 0.0);

  const Surface surface = front_surface(solid);
  EXPECT_EQ(surface.mesh.cells.rows(), 4 * 12);
  EXPECT_EQ(surface.mesh.nodes.rows(), 21 + 6 * 3 + 7 * 2 + 12);
  EXPECT_THAT(check(surface.mesh, "surface"), SizeIs(0));
  EXPECT_THAT(surface.mesh.node_groups.at("left"), SizeIs(5));
  EXPECT_EQ(surface.mesh.facet_groups.at("top").rows(), 12);
  // A quadratic field of the volume is the same on the surface, also at the faces' centres, up to the mixed cubic
  // terms.
  const Eigen::VectorXd ones = surface.weights * Eigen::VectorXd::Ones(solid.nodes.rows());
  EXPECT_NEAR((ones.array() - 1.0).abs().maxCoeff(), 0.0, 1e-14);
  const Nodes seen = surface.weights * solid.nodes;
  EXPECT_NEAR((seen - surface.mesh.nodes).norm(), 0.0, 1e-14);
}

TEST(PlaneMesh, IsItsOwnSurface) {
  const Mesh ring = ring_sector();
  const Surface surface = front_surface(ring);
  EXPECT_TRUE(surface.mesh.nodes == ring.nodes);
  EXPECT_TRUE(surface.mesh.cells == ring.cells);
  EXPECT_EQ(surface.mesh.node_groups, ring.node_groups);
  EXPECT_EQ(surface.mesh.cell_groups, ring.cell_groups);
  EXPECT_EQ(surface.mesh.facet_groups.at("top").rows(), ring.facet_groups.at("top").rows());
  EXPECT_EQ(surface.weights.nonZeros(), ring.nodes.rows());
}

/// A strip between y = 0 and y = height(x), x from -8 to 8, of 2 x n quadrilaterals.
Mesh below(const std::function<double(double)>& height, int n) {
  Mesh mesh = grid(n, 2);
  for (Eigen::Index i = 0; i < mesh.nodes.rows(); ++i) {
    mesh.nodes(i, 0) = 16.0 * mesh.nodes(i, 0) / n - 8.0;
    mesh.nodes(i, 1) *= 0.5 * height(mesh.nodes(i, 0));
  }
  return mesh;
}

TEST(PlaneMesh, MiddlesLieOnASmoothContourWhoseCurvatureChanges) {
  const auto waist = [](double x) { return 10.0 * (1.0 - 0.25 * std::exp(-x * x / 36.0)); };
  std::vector<double> worst;
  for (const int n : {8, 16, 32}) {
    const Mesh coarse = below(waist, n);
    worst.push_back(0.0);
    for (const Bulge& bulge : bulges(coarse)) {
      const Eigen::Vector2d middle =
          0.5 * (coarse.nodes.row(bulge.from) + coarse.nodes.row(bulge.to)).head<2>().transpose() + bulge.shift;
      if (std::abs(middle.x()) < 5.0) worst.back() = std::max(worst.back(), std::abs(middle.y() - waist(middle.x())));
    }
  }
  std::cout << "[          ] off the contour: " << worst[0] << ", " << worst[1] << ", " << worst[2] << '\n';
  EXPECT_LT(worst[0], 0.005);            // chords are 0.07 off
  EXPECT_GT(worst[0] / worst[1], 32.0);  // of sixth order
  EXPECT_GT(worst[1] / worst[2], 32.0);
}

TEST(PlaneMesh, AnArcBetweenStraightPartsIsOneToItsEnds) {
  constexpr double radius = 6.0;  // tangent to y = 3 at x = 0
  const auto fillet = [](double x) {
    return x <= 0.0 ? 3.0 : 3.0 + radius - std::sqrt(radius * radius - std::min(x, 5.0) * std::min(x, 5.0));
  };
  const Mesh coarse = below(fillet, 16);
  int bent = 0;
  for (const Bulge& bulge : bulges(coarse)) {
    const Eigen::Vector2d middle =
        0.5 * (coarse.nodes.row(bulge.from) + coarse.nodes.row(bulge.to)).head<2>().transpose() + bulge.shift;
    if (middle.y() < 2.0 || middle.x() > 4.0) continue;
    EXPECT_GT(middle.x(), 0.0);
    EXPECT_NEAR((middle - Eigen::Vector2d(0.0, 3.0 + radius)).norm(), radius, 0.002) << middle.x();
    ++bent;
  }
  EXPECT_EQ(bent, 4);
}

TEST(PlaneMesh, QuadraticHasItsMiddlesOnTheContourAndIsSeenAsFourQuadsEach) {
  const Mesh ring = ring_sector(), curved = quadratic(ring);
  EXPECT_EQ(name(curved.type), "quad8");
  EXPECT_EQ(curved.nodes.rows(), 21 + 6 * 3 + 7 * 2);
  EXPECT_TRUE(curved.nodes.topRows(21) == ring.nodes);
  int on = 0;
  for (Eigen::Index i = 0; i < curved.nodes.rows(); ++i) on += on_ring(curved.nodes.row(i)) ? 1 : 0;
  EXPECT_EQ(on, 2 * 13);
  EXPECT_THAT(curved.node_groups.at("left"), SizeIs(5));
  const Cells edges = with_middles(curved, boundary_facets(curved).nodes);
  ASSERT_EQ(edges.cols(), 3);
  for (Eigen::Index e = 0; e < edges.rows(); ++e) {  // the middle of an edge has the same distance to its ends
    const auto a = curved.nodes.row(edges(e, 0)), b = curved.nodes.row(edges(e, 1)), m = curved.nodes.row(edges(e, 2));
    EXPECT_NEAR((m - a).norm(), (m - b).norm(), 1e-12);
    EXPECT_LT((m - 0.5 * (a + b)).norm(), 0.1 * (a - b).norm());
  }
  const Surface surface = front_surface(curved);
  EXPECT_EQ(surface.mesh.cells.rows(), 4 * 12);
  EXPECT_EQ(surface.mesh.nodes.rows(), 21 + 6 * 3 + 7 * 2 + 12);
  EXPECT_THAT(check(surface.mesh, "surface"), SizeIs(0));
  EXPECT_THAT(surface.mesh.node_groups.at("left"), SizeIs(5));
  EXPECT_EQ(surface.mesh.facet_groups.at("top").rows(), 12);
  EXPECT_NEAR(
      (surface.weights * Eigen::VectorXd::Ones(curved.nodes.rows()) - Eigen::VectorXd::Ones(surface.mesh.nodes.rows()))
          .norm(),
      0.0, 1e-13);
  EXPECT_THROW((void)quadratic(curved), InputError);
  EXPECT_THROW((void)refine(curved), InputError);
}

TEST(Contours, OuterCounterClockwiseThenHoles) {
  Mesh mesh = grid(5, 5);
  Cells kept(24, 4);
  kept << mesh.cells.topRows(12), mesh.cells.bottomRows(12);  // the middle cell is the hole
  mesh.cells = kept;
  const auto found = contours(mesh);
  ASSERT_THAT(found, SizeIs(2));
  EXPECT_THAT(found[0], SizeIs(20));
  EXPECT_EQ(found[0][0], 0);
  EXPECT_EQ(found[0][1], 1);
  EXPECT_THAT(found[1], SizeIs(4));
  EXPECT_THAT(found[1], ElementsAre(14, 20, 21, 15));
}

TEST(Connectivity, NodesAtOnePlaceAndPartsAreFound) {
  Mesh mesh = grid(3, 2);
  EXPECT_TRUE(nodes_at_one_place(mesh).empty());
  EXPECT_THAT(parts_of(mesh), ElementsAre(0, 0, 0, 0, 0, 0));
  mesh.nodes.conservativeResize(16, 3);
  for (int k = 0; k < 4; ++k) {  // the upper row has nodes of its own
    mesh.nodes.row(12 + k) = mesh.nodes.row(4 + k);
    for (int cell = 3; cell < 6; ++cell)
      for (int& node : mesh.cells.row(cell))
        if (node == 4 + k) node = 12 + k;
  }
  EXPECT_THAT(nodes_at_one_place(mesh), ElementsAre(Pair(4, 12), Pair(5, 13), Pair(6, 14), Pair(7, 15)));
  EXPECT_THAT(parts_of(mesh), ElementsAre(0, 0, 0, 1, 1, 1));
}

/// Of each quadrilateral without its sign: a surface seen from behind has as much.
TEST(Surface, AreaIsThatOfItsQuadrilaterals) {
  Mesh quads;
  quads.nodes.resize(6, 3);
  quads.nodes << 0, 0, 5, 2, 0, 5, 3, 1, 5, 0, 1, 5, 4, 3, 5, 0, 3, 5;
  quads.cells.resize(2, 4);
  quads.cells << 0, 1, 2, 3, 3, 2, 4, 5;
  EXPECT_DOUBLE_EQ(plane_area(quads), 2.5 + 7.0);
  quads.nodes.col(0) *= -1.0;
  EXPECT_DOUBLE_EQ(plane_area(quads), 2.5 + 7.0);
}

}  // namespace test_mesh
}  // namespace imic3d::mesh
