#include "effects.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

namespace imic3d::loop {

double begun(const Scene& scene, int t, double onset) {
  const double since = (scene.clock(t) - onset) * static_cast<double>(scene.time.size());  // [frames]
  return 1.0 / (1.0 + std::exp(-15.0 * since));
}

std::vector<std::vector<double>> moments(const Scene& scene, double last, Eigen::Index most) {
  const Eigen::Index frames = scene.time.size(), each = 1 + (frames - 1) / most;
  std::vector<std::vector<double>> all;
  for (Eigen::Index t = 0; t < frames; t += each)
    if (const double between = 0.5 * (scene.clock(t - 1) + scene.clock(t)); between <= last) all.push_back({between});
  return all;
}

namespace {

/// Gradient of a field [components * n] at the nodes, the mean of the cells about each: du/dX, a row for each
/// component.
std::vector<Eigen::Matrix<double, Eigen::Dynamic, 2>> gradients(const mesh::Mesh& surface, const Eigen::VectorXd& U) {
  const Eigen::Index nodes = surface.nodes.rows(), c = U.size() / nodes;
  std::vector<Eigen::Matrix<double, Eigen::Dynamic, 2>> sum(static_cast<std::size_t>(nodes),
                                                            Eigen::Matrix<double, Eigen::Dynamic, 2>::Zero(c, 2));
  Eigen::VectorXd count = Eigen::VectorXd::Zero(nodes);
  for (const auto cell : surface.cells.rowwise())
    for (int k = 0; k < 4; ++k) {
      const int node = cell[k];
      Eigen::Matrix2d edges;
      Eigen::Matrix<double, Eigen::Dynamic, 2> change(c, 2);
      for (const int side : {0, 1}) {
        const int other = cell[(k + (side == 0 ? 1 : 3)) % 4];
        edges.col(side) = (surface.nodes.row(other) - surface.nodes.row(node)).head<2>().transpose();
        change.col(side) = U.segment(c * other, c) - U.segment(c * node, c);
      }
      sum[static_cast<std::size_t>(node)] += change * edges.inverse();
      count[node] += 1.0;
    }
  for (Eigen::Index i = 0; i < nodes; ++i) sum[static_cast<std::size_t>(i)] /= std::max(1.0, count[i]);
  return sum;
}

}  // namespace

void see_beside(const Points& d, const Scene& scene, const Eigen::VectorXd& U, Eigen::VectorXd& error) {
  if (d.isZero(0.0)) return;
  const auto slope = gradients(*scene.surface, U);
  const Eigen::Index c = U.size() / d.rows();
  for (Eigen::Index i = 0; i < d.rows(); ++i)
    error.segment(c * i, c) -= slope[static_cast<std::size_t>(i)] * d.row(i).transpose();
}

void see_through(const Distortion& D, const Scene& scene, const Eigen::VectorXd& U, Eigen::VectorXd& error) {
  const auto& nodes = scene.surface->nodes;
  Points d(nodes.rows(), 2);
  const auto from_axis = [&](Eigen::Index i) -> Eigen::Vector2d {
    return nodes.row(i).head<2>().transpose() - scene.axis_of_lens;
  };
  for (Eigen::Index i = 0; i < d.rows(); ++i) d.row(i) = D(from_axis(i));
  if (d.isZero(0.0)) return;  // as in all series but those of this effect
  for (Eigen::Index i = 0; i < d.rows(); ++i) {
    Eigen::Vector2d beside = d.row(i);
    for (int k = 0; k < 3; ++k) beside = D(from_axis(i) - beside);
    d.row(i) = beside;
  }
  Eigen::VectorXd own = U;
  see_beside(d, scene, U, own);
  for (Eigen::Index i = 0; i < d.rows(); ++i) {
    const Eigen::Vector2d u = own.segment<2>(2 * i), beside = d.row(i).transpose();
    error.segment<2>(2 * i) += u - U.segment<2>(2 * i) + D(from_axis(i) - beside + u) - beside;
  }
}

std::vector<std::shared_ptr<const Effect>> effects() {
  return {coarse_mesh(),     large_increments(), interpolation_bias(),  force_gain(),
          force_offset(),    force_delay(),      magnification_drift(), parallax(),
          lens_distortion(), placement(),        camera_tilt(),         camera_bump(),
          hole_radius(),     hole_offset(),      thickness(),           taper(),
          preload(),         residual_stress(),  misalignment(),        grip_slip(),
          friction(),        stiff_region(),     strain_gain(),         strain_zero(),
          compliance(),      group_gain()};
}

std::vector<std::shared_ptr<const Effect>> light_effects() {
  return {light_gain(), light_offset(), light_gradient(), saturation(), noise_level(), aliasing(), speckle_debonding()};
}

std::vector<std::shared_ptr<const Effect>> all_effects() {
  auto all = effects();
  for (auto& one : light_effects()) all.push_back(std::move(one));
  return all;
}

double near_hole(const Scene& scene, double distance) {
  const double edge = std::min({scene.hole[0] - scene.low[0], scene.high[0] - scene.hole[0],
                                scene.hole[1] - scene.low[1], scene.high[1] - scene.hole[1]});
  const double s = std::clamp((edge - distance) / (edge - scene.radius), 0.0, 1.0);
  return s * s * (3.0 - 2.0 * s);
}

std::string_view name(Link link) {
  constexpr std::array<std::string_view, 8> names = {"numerics", "record",        "camera",  "light",
                                                     "geometry", "initial state", "loading", "material"};
  return names[static_cast<std::size_t>(link)];
}

}  // namespace imic3d::loop
