#include "patch_search.hpp"

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "imic3d/core/linear.hpp"
#include "imic3d/imaging/patch_match.hpp"

namespace imic3d::correlation {
namespace {

struct Found {
  Eigen::Vector2d reference;  // centre in the reference, from the mesh's middle [px]
  Eigen::Vector2d miss;       // where the patch was found less where U puts it [px]
};

/// Rows a, b, c of miss = a + b x + c y.
using Affine = Eigen::Matrix<double, 3, 2>;

Affine fit(const std::vector<Found>& found, const std::vector<std::size_t>& chosen) {
  Eigen::MatrixXd places(chosen.size(), 3), misses(chosen.size(), 2);
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    const Found& f = found[chosen[i]];
    places.row(static_cast<Eigen::Index>(i)) << 1.0, f.reference.x(), f.reference.y();
    misses.row(static_cast<Eigen::Index>(i)) = f.miss.transpose();
  }
  return least_squares(places, misses);
}

Eigen::Vector2d at(const Affine& affine, const Eigen::Vector2d& place) {
  return affine.transpose() * Eigen::Vector3d(1.0, place.x(), place.y());
}

/// The same with squares, for a field that bends.
using Quadratic = Eigen::Matrix<double, 6, 2>;

Eigen::Matrix<double, 1, 6> squares(const Eigen::Vector2d& place) {
  const double x = place.x() / 100.0, y = place.y() / 100.0;
  return Eigen::Matrix<double, 1, 6>(1.0, x, y, x * x, x * y, y * y);
}
Eigen::Vector2d at(const Quadratic& field, const Eigen::Vector2d& place) {
  return (squares(place) * field).transpose();
}

Quadratic fit_squares(const std::vector<Found>& found, const std::vector<std::size_t>& chosen) {
  Eigen::MatrixXd places(chosen.size(), 6), misses(chosen.size(), 2);
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    places.row(static_cast<Eigen::Index>(i)) = squares(found[chosen[i]].reference);
    misses.row(static_cast<Eigen::Index>(i)) = found[chosen[i]].miss.transpose();
  }
  return least_squares(places, misses);
}

}  // namespace

std::optional<InImage> search_patches(const Correlation& correlation, const imaging::BSpline& reference,
                                      const imaging::Image& image, const Eigen::VectorXd& U, double reach) {
  constexpr int most_patches = 80;
  constexpr double least_score = 0.5;
  const InImage shift = correlation.pixel_displacement(U);
  const auto F = correlation.deformation_gradient(U);
  const InImage& positions = correlation.positions();
  const Eigen::Vector2d middle = positions.colwise().mean().transpose();
  const Eigen::Vector2d extent = (positions.colwise().maxCoeff() - positions.colwise().minCoeff()).transpose();
  const int half = std::clamp(static_cast<int>(std::lround(extent.minCoeff() / 10.0)), 6, 15);

  std::vector<Found> found;
  const int step = std::max(1, correlation.elements() / most_patches);
  int looked_for = 0;
  for (int e = step / 2; e < correlation.elements(); e += step) {
    Eigen::Vector2d centre(0.0, 0.0), moved(0.0, 0.0);
    for (int i = 0; i < 4; ++i) {
      const int node = correlation.surface().cells(e, i);
      centre += 0.25 * positions.row(node).transpose();
      moved += 0.25 * shift.row(node).transpose();
    }
    moved += centre;
    if (F[static_cast<std::size_t>(e)].determinant() < 0.1) continue;
    const Eigen::Matrix2d back = F[static_cast<std::size_t>(e)].inverse();
    // The patch's middle pixel is put on a whole pixel's fraction of its own: only its centre's position matters.
    imaging::Image patch(2 * half + 1, 2 * half + 1);
    bool inside = true;
    for (int j = -half; j <= half && inside; ++j)
      for (int i = -half; i <= half && inside; ++i) {
        const Eigen::Vector2d place = centre + back * Eigen::Vector2d(i, j);
        inside = reference.contains(place.x(), place.y());
        if (inside) patch(i + half, j + half) = reference.value(place.x(), place.y());
      }
    if (!inside) continue;
    ++looked_for;
    const imaging::PatchMatch match = imaging::match_patch(patch, image, moved.x(), moved.y(), reach);
    if (match.score > least_score) found.push_back({centre - middle, Eigen::Vector2d(match.x, match.y) - moved});
  }
  if (found.size() < 3 || 3 * found.size() < static_cast<std::size_t>(looked_for)) return {};

  // Random samples of three patches; the motion that most patches share wins. A few pixels are left for what is not
  // affine.
  std::mt19937 generator(1);
  std::uniform_int_distribution<std::size_t> any(0, found.size() - 1);
  std::vector<std::size_t> best;
  const auto agreeing = [&](const auto& affine) {
    std::vector<std::size_t> agree;
    for (std::size_t i = 0; i < found.size(); ++i)
      if ((at(affine, found[i].reference) - found[i].miss).norm() < 2.0) agree.push_back(i);
    return agree;
  };
  for (int trial = 0; trial < 300; ++trial) {
    const std::vector<std::size_t> three{any(generator), any(generator), any(generator)};
    if (three[0] == three[1] || three[1] == three[2] || three[0] == three[2]) continue;
    const Affine affine = fit(found, three);
    if (!affine.allFinite() || affine.bottomRows<2>().cwiseAbs().maxCoeff() > 0.5) continue;
    if (auto agree = agreeing(affine); agree.size() > best.size()) best = std::move(agree);
  }
  if (best.size() < 3 || 3 * best.size() < static_cast<std::size_t>(looked_for)) return {};
  best = agreeing(fit(found, best));
  if (best.size() < 3) return {};
  const Affine affine = fit(found, best);
  // A field that bends: patches further off agree with the squares of those that agree so far.
  std::vector<std::size_t> more = best;
  Quadratic field = Quadratic::Zero();
  for (int round = 0; round < 4 && more.size() >= 12; ++round) {
    field = fit_squares(found, more);
    more = agreeing(field);
  }
  const bool bends = more.size() > best.size() + 3 && field.allFinite();

  InImage moved = shift;
  for (int node = 0; node < correlation.nodes(); ++node)
    moved.row(node) += (bends ? at(field, positions.row(node).transpose() - middle)
                              : at(affine, positions.row(node).transpose() - middle))
                           .transpose();
  return moved;
}

}  // namespace imic3d::correlation
