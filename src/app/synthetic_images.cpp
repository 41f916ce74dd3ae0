#include "synthetic_images.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "imic3d/core/error.hpp"
#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/synthesis.hpp"
#include "rig.hpp"

namespace imic3d::app {

namespace {

/// The surface and what moves with it. Beyond both ends, where the mesh stops and the specimen goes on, a strip that
/// moves on as the specimen stretches on average; along all other edges a narrow rim: the mesh may end a few pixels
/// inside the specimen, or in the midst of it.
class Continued {
 public:
  Continued(const mesh::Mesh& cut, const io::Case& test, double strip, double rim)
      : surface_(cut), axis_(test.specimen.axis == "x" ? 0 : 1) {
    const double middle = 0.5 * (cut.nodes.col(axis_).maxCoeff() + cut.nodes.col(axis_).minCoeff());
    for (const auto& name : {test.specimen.held, test.specimen.loaded})
      if (const auto found = cut.node_groups.find(name); found != cut.node_groups.end()) ends_.push_back(found->second);
    for (const auto& contour : mesh::contours(cut)) {  // the specimen lies to the left of an edge a-b
      const auto n = contour.size();
      const auto end_of = [&](std::size_t i) {
        for (std::size_t k = 0; k < ends_.size(); ++k)
          if (std::binary_search(ends_[k].begin(), ends_[k].end(), contour[i % n]) &&
              std::binary_search(ends_[k].begin(), ends_[k].end(), contour[(i + 1) % n]))
            return static_cast<int>(k);
        return -1;
      };
      std::map<int, int> beyond;  // new node of an end's node
      std::vector<Eigen::Vector2d> outwards(n, Eigen::Vector2d::Zero());
      for (std::size_t i = 0; i < n; ++i) {
        if (end_of(i) >= 0) continue;
        const Eigen::Vector2d along =
            (cut.nodes.row(contour[(i + 1) % n]) - cut.nodes.row(contour[i])).head<2>().transpose();
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
    for (std::size_t i = 0; i < nodes_.size(); ++i)
      surface_.nodes.row(cut.nodes.rows() + static_cast<Eigen::Index>(i)) = nodes_[i].place.transpose();
    surface_.cells.conservativeResize(cut.cells.rows() + static_cast<Eigen::Index>(cells_.size()), 4);
    for (std::size_t i = 0; i < cells_.size(); ++i)
      for (int k = 0; k < 4; ++k)
        surface_.cells(cut.cells.rows() + static_cast<Eigen::Index>(i), k) = cells_[i][static_cast<std::size_t>(k)];
  }

  [[nodiscard]] const mesh::Mesh& surface() const { return surface_; }

  /// [components * nodes of the cut surface] -> [components * nodes].
  [[nodiscard]] Eigen::VectorXd operator()(const Eigen::VectorXd& U) const {
    const Eigen::Index c = U.size() / (surface_.nodes.rows() - static_cast<Eigen::Index>(nodes_.size()));
    Eigen::VectorXd all(c * surface_.nodes.rows());
    all.head(U.size()) = U;
    double strain = 0.0;
    if (ends_.size() == 2) {
      double way[2] = {0.0, 0.0}, place[2] = {0.0, 0.0};
      for (std::size_t k = 0; k < 2; ++k)
        for (int node : ends_[k]) {
          way[k] += U[c * node + axis_] / static_cast<double>(ends_[k].size());
          place[k] += surface_.nodes(node, axis_) / static_cast<double>(ends_[k].size());
        }
      strain = (way[1] - way[0]) / (place[1] - place[0]);
    }
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      const Eigen::Index row = U.size() + c * static_cast<Eigen::Index>(i);
      all.segment(row, c) = U.segment(c * nodes_[i].from, c);
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

/// What a camera sees of a face: its reference with the face, and what moves with it, elsewhere.
class Photographer {
 public:
  Photographer(const correlation::View& view, const mesh::Mesh& cut, const io::Case& test)
      : camera_(view.camera),
        whole_(cut, test, strip / scale(view, cut), rim / scale(view, cut)),
        at_rest_(pixels(Eigen::VectorXd::Zero(2 * whole_.surface().nodes.rows()))),
        texture_(view.reference),
        surroundings_(imaging::without(view.reference,
                                       imaging::InverseMapping(at_rest_, at_rest_, whole_.surface().cells),
                                       static_cast<int>(rim))) {
    options_.width = view.reference.width, options_.height = view.reference.height;
    options_.depth = view.reference.depth, options_.supersampling = 1;
  }
  /// The face has moved by U [components * nodes of the cut surface].
  [[nodiscard]] imaging::Image operator()(const Eigen::VectorXd& U) const {
    return imaging::render(imaging::InverseMapping(at_rest_, pixels(whole_(U)), whole_.surface().cells), texture_,
                           surroundings_, options_);
  }

 private:
  static constexpr double strip = 30.0, rim = 6.0;  // [px]
  static double scale(const correlation::View& view, const mesh::Mesh& cut) {
    return std::sqrt(
        std::abs(view.camera->jacobian(cut.nodes.colwise().mean().transpose()).leftCols<2>().determinant()));
  }
  [[nodiscard]] imaging::PixelPoints pixels(const Eigen::VectorXd& displacement) const {
    const auto& nodes = whole_.surface().nodes;
    const Eigen::Index c = displacement.size() / nodes.rows();
    imaging::PixelPoints points(nodes.rows(), 2);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
      points.row(i) =
          camera_
              ->project(nodes.row(i).transpose() + Eigen::Vector3d(displacement[c * i], displacement[c * i + 1],
                                                                   c == 3 ? displacement[c * i + 2] : 0.0))
              .transpose();
    return points;
  }

  std::shared_ptr<const imaging::Camera> camera_;
  Continued whole_;
  imaging::PixelPoints at_rest_;
  imaging::ImageTexture texture_, surroundings_;
  imaging::SynthesisOptions options_;
};

constexpr double most_kept = 512e6;  // bytes of images

double pixels_of(const std::vector<correlation::View>& views) {
  double all = 0.0;
  for (const auto& view : views) all += static_cast<double>(view.reference.width) * view.reference.height;
  return all;
}

}  // namespace

Eigen::MatrixXd correlated_images(const Observation& seen, const io::Case& test, const Communicator& world,
                                  const identification::Specimen& specimen, const Eigen::MatrixXd& U,
                                  const ImageShown& shown) {
  Eigen::MatrixXd measured(0, U.cols());
  for (std::size_t k = 0; k < seen.faces.size(); ++k) {
    const auto& face = seen.faces[k];
    const auto& made = specimen.faces[k];
    std::vector<Photographer> cameras;
    mesh::Mesh cut = made.surface.mesh;
    if (face.rig->placed)
      cut.nodes.col(2) = identification::interpolation(face.rig->surface, cut.nodes.leftCols<2>()) *
                         face.rig->surface.nodes.col(2);  // its measured shape
    for (const auto& view : face.rig->views) cameras.emplace_back(view, cut, test);
    // Taken once where they may be kept: they are shown again.
    const bool kept = shown && static_cast<double>(U.cols()) * pixels_of(face.rig->views) * sizeof(float) < most_kept;
    std::vector<std::vector<imaging::Image>> taken(kept ? static_cast<std::size_t>(U.cols()) : 0,
                                                   std::vector<imaging::Image>(cameras.size()));
    const auto photograph = [&](int t, int camera) {
      const auto c = static_cast<std::size_t>(camera);
      if (kept && taken[static_cast<std::size_t>(t)][c].width > 0) return taken[static_cast<std::size_t>(t)][c];
      imaging::Image image = cameras[c](U.col(t).segment(made.first_unknown, made.unknowns()));
      if (kept) taken[static_cast<std::size_t>(t)][c] = image;
      return image;
    };
    // The motion is known: no coarse images have to find it.
    const Eigen::SparseMatrix<double> onto =
        identification::between(made.surface.mesh, face.dic->cameras().surface(), face.dic->cameras().dofs_per_node());
    correlation::DicSeries known;
    for (Eigen::Index t = 0; t < U.cols(); ++t)
      known.starts.emplace_back(onto * U.col(t).segment(made.first_unknown, made.unknowns())), known.lost.push_back(0);
    const auto frames = face.dic->run(world, static_cast<int>(U.cols()),
                                      correlation::GlobalDic::SourceOfAll(photograph), {}, std::move(known));
    const auto before = measured.rows(), own = frames.front().displacement.size();
    measured.conservativeResize(before + own, U.cols());
    for (Eigen::Index t = 0; t < U.cols(); ++t) {
      if (frames[static_cast<std::size_t>(t)].lost)
        throw ConvergenceError("the images of a synthetic test could not be correlated");
      measured.col(t).tail(own) = frames[static_cast<std::size_t>(t)].displacement;
      for (std::size_t c = 0; shown && c < cameras.size(); ++c)
        shown(k, static_cast<int>(c), static_cast<int>(t), photograph(static_cast<int>(t), static_cast<int>(c)),
              frames[static_cast<std::size_t>(t)].displacement);
    }
  }
  return measured;
}

}  // namespace imic3d::app
