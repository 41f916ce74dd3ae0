#include "synthetic_images.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "imic3d/core/error.hpp"
#include "imic3d/imaging/synthesis.hpp"

namespace imic3d::app {

namespace {

/// The surface and what moves with it. Beyond both ends, where the mesh stops and the specimen goes on, a strip that moves on as the specimen
/// stretches on average; along all other edges a narrow rim: the mesh may end a few pixels inside the specimen, or in the midst of it.
class Continued {
 public:
  Continued(const mesh::Mesh& cut, const io::Case& test, double strip, double rim) : surface_(cut), axis_(test.specimen.axis == "x" ? 0 : 1) {
    const double middle = 0.5 * (cut.nodes.col(axis_).maxCoeff() + cut.nodes.col(axis_).minCoeff());
    for (const auto& name : {test.specimen.held, test.specimen.loaded})
      if (const auto found = cut.node_groups.find(name); found != cut.node_groups.end()) ends_.push_back(found->second);
    for (const auto& contour : mesh::contours(cut)) {  // the specimen lies to the left of an edge a-b
      const auto n = contour.size();
      const auto end_of = [&](std::size_t i) {
        for (std::size_t k = 0; k < ends_.size(); ++k)
          if (std::binary_search(ends_[k].begin(), ends_[k].end(), contour[i % n]) && std::binary_search(ends_[k].begin(), ends_[k].end(), contour[(i + 1) % n])) return static_cast<int>(k);
        return -1;
      };
      std::map<int, int> beyond;  // new node of an end's node
      std::vector<Eigen::Vector2d> outwards(n, Eigen::Vector2d::Zero());
      for (std::size_t i = 0; i < n; ++i) {
        if (end_of(i) >= 0) continue;
        const Eigen::Vector2d along = (cut.nodes.row(contour[(i + 1) % n]) - cut.nodes.row(contour[i])).head<2>().transpose();
        const Eigen::Vector2d normal = Eigen::Vector2d(along.y(), -along.x()).normalized();
        outwards[i] += normal, outwards[(i + 1) % n] += normal;
      }
      std::vector<int> rims(n, -1);
      const auto rim_of = [&](std::size_t i) {
        if (rims[i] < 0) rims[i] = add(contour[i], rim * outwards[i].normalized(), 0.0);
        return rims[i];
      };
      for (std::size_t i = 0; i < n; ++i) {
        const int a = contour[i], b = contour[(i + 1) % n];
        if (end_of(i) < 0) {
          cells_.push_back({b, a, rim_of(i), rim_of((i + 1) % n)});
          continue;
        }
        const auto next = [&](int node) {
          const auto [place, is_new] = beyond.try_emplace(node, -1);
          const double way = cut.nodes(node, axis_) > middle ? strip : -strip;
          if (is_new) place->second = add(node, way * Eigen::Vector2d::Unit(axis_), way);
          return place->second;
        };
        cells_.push_back({b, a, next(a), next(b)});
      }
    }
    surface_.nodes.conservativeResize(cut.nodes.rows() + static_cast<Eigen::Index>(nodes_.size()), 3);
    for (std::size_t i = 0; i < nodes_.size(); ++i) surface_.nodes.row(cut.nodes.rows() + static_cast<Eigen::Index>(i)) = nodes_[i].place.transpose();
    surface_.cells.conservativeResize(cut.cells.rows() + static_cast<Eigen::Index>(cells_.size()), 4);
    for (std::size_t i = 0; i < cells_.size(); ++i)
      for (int k = 0; k < 4; ++k) surface_.cells(cut.cells.rows() + static_cast<Eigen::Index>(i), k) = cells_[i][static_cast<std::size_t>(k)];
  }

  [[nodiscard]] const mesh::Mesh& surface() const { return surface_; }

  /// [2 nodes of the cut surface] -> [2 nodes].
  [[nodiscard]] Eigen::VectorXd operator()(const Eigen::VectorXd& U) const {
    Eigen::VectorXd all(2 * surface_.nodes.rows());
    all.head(U.size()) = U;
    double strain = 0.0;
    if (ends_.size() == 2) {
      double way[2] = {0.0, 0.0}, place[2] = {0.0, 0.0};
      for (std::size_t k = 0; k < 2; ++k)
        for (int node : ends_[k]) {
          way[k] += U[2 * node + axis_] / static_cast<double>(ends_[k].size());
          place[k] += surface_.nodes(node, axis_) / static_cast<double>(ends_[k].size());
        }
      strain = (way[1] - way[0]) / (place[1] - place[0]);
    }
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      const Eigen::Index row = U.size() + 2 * static_cast<Eigen::Index>(i);
      all.segment<2>(row) = U.segment<2>(2 * nodes_[i].from);
      all[row + axis_] += strain * nodes_[i].distance;
    }
    return all;
  }

 private:
  struct New {
    Eigen::Vector3d place;
    int from;         // node of the edge that it moves with
    double distance;  // along the axis
  };
  int add(int from, const Eigen::Vector2d& way, double distance) {
    nodes_.push_back({surface_.nodes.row(from).transpose() + Eigen::Vector3d(way.x(), way.y(), 0.0), from, distance});
    return static_cast<int>(surface_.nodes.rows() + static_cast<Eigen::Index>(nodes_.size()) - 1);
  }

  mesh::Mesh surface_;
  int axis_;
  std::vector<std::vector<int>> ends_;
  std::vector<New> nodes_;
  std::vector<std::array<int, 4>> cells_;
};

}  // namespace

Eigen::MatrixXd correlated_images(const Observation& seen, const io::Case& test, const Communicator& world, const imaging::TelecentricCamera& camera,
                                  const mesh::Mesh& cut, const Eigen::MatrixXd& U, const ImageShown& shown) {
  constexpr double strip = 30.0, rim = 6.0;  // [px]
  const double scale = std::sqrt(std::abs(camera.linear.leftCols<2>().determinant()));
  const Continued whole(cut, test, strip / scale, rim / scale);
  const mesh::Mesh& surface = whole.surface();
  const auto& declared = test.cameras.front();
  std::vector<imaging::Image> references;
  for (int number : declared.reference) references.push_back(imaging::read_image(declared.images[static_cast<std::size_t>(test.index_of(number))]));
  const imaging::Image reference = imaging::average(references);
  imaging::SynthesisOptions options;
  options.width = reference.width, options.height = reference.height;
  options.depth = reference.depth, options.supersampling = 1;
  const auto pixels = [&](const Eigen::VectorXd& displacement) {
    imaging::PixelPoints points(surface.nodes.rows(), 2);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
      points.row(i) = camera.project(surface.nodes.row(i).transpose() + Eigen::Vector3d(displacement[2 * i], displacement[2 * i + 1], 0.0)).transpose();
    return points;
  };
  const imaging::PixelPoints at_rest = pixels(Eigen::VectorXd::Zero(2 * surface.nodes.rows()));
  const imaging::ImageTexture texture(reference);
  const imaging::ImageTexture surroundings(imaging::without(reference, imaging::InverseMapping(at_rest, at_rest, surface.cells), static_cast<int>(rim)));
  const auto source = [&](int t) {
    return imaging::render(imaging::InverseMapping(at_rest, pixels(whole(U.col(t))), surface.cells), texture, surroundings, options);
  };
  const auto frames = seen.faces.front().dic->run(world, static_cast<int>(U.cols()), source);
  Eigen::MatrixXd measured(frames.front().displacement.size(), U.cols());
  for (Eigen::Index t = 0; t < U.cols(); ++t) {
    if (frames[static_cast<std::size_t>(t)].lost) throw ConvergenceError("the images of a synthetic test could not be correlated");
    measured.col(t) = frames[static_cast<std::size_t>(t)].displacement;
    if (shown) shown(0, 0, static_cast<int>(t), source(static_cast<int>(t)), measured.col(t));
  }
  return measured;
}

}  // namespace imic3d::app
