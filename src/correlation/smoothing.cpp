#include "imic3d/correlation/smoothing.hpp"

#include <Eigen/LU>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include "bilinear.hpp"
#include "imic3d/correlation/covariance.hpp"

namespace imic3d::correlation {
namespace {

/// A linear form of a nodal field: sum of weight * u[node].
using Form = std::vector<std::pair<int, double>>;

void add_square(const Form& form, double weight, int dofs, std::vector<Eigen::Triplet<double>>& entries) {
  for (const auto& [i, a] : form)
    for (const auto& [j, b] : form)
      for (int component = 0; component < dofs; ++component)
        entries.emplace_back(i * dofs + component, j * dofs + component, weight * a * b);
}

using Factor = Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>;

/// Frames on either side whose errors are judged together.
constexpr Eigen::Index beside = 2;

}  // namespace

Eigen::SparseMatrix<double> curvature_energy(const mesh::Mesh& surface, int dofs_per_node,
                                             const std::vector<char>& only) {
  const auto takes_part = [&only](int e) { return only.empty() || only[static_cast<std::size_t>(e)] != 0; };
  struct Element {
    Corners corners, slopes;  // dN/d(x, y) at the centre
  };
  std::vector<Element> elements(static_cast<std::size_t>(surface.cells.rows()));
  std::vector<Eigen::Triplet<double>> entries;
  std::map<std::pair<int, int>, int> owner;  // edge -> the first element that has it
  const Eigen::Vector4d hourglass = corner_xi.cwiseProduct(corner_eta);
  for (int e = 0; e < static_cast<int>(elements.size()); ++e) {
    Element& element = elements[static_cast<std::size_t>(e)];
    for (int i = 0; i < 4; ++i) element.corners.row(i) = surface.nodes.row(surface.cells(e, i)).head<2>();
    const Eigen::Matrix2d jacobian = element.corners.transpose() * central_slopes();
    element.slopes = central_slopes() * jacobian.inverse();
    // Hourglass mode without its affine part (Flanagan and Belytschko 1981).
    const Eigen::Vector4d mode = hourglass - element.slopes * (element.corners.transpose() * hourglass);
    Form form;
    for (int i = 0; i < 4; ++i) form.emplace_back(surface.cells(e, i), 0.25 * mode[i]);
    if (takes_part(e)) add_square(form, 16.0 / (4.0 * std::abs(jacobian.determinant())), dofs_per_node, entries);
    for (int i = 0; i < 4; ++i) {
      const int a = surface.cells(e, i), b = surface.cells(e, (i + 1) % 4);
      const auto [place, is_new] = owner.try_emplace({std::min(a, b), std::max(a, b)}, e);
      if (is_new || !(takes_part(e) || takes_part(place->second))) continue;
      const Element& other = elements[static_cast<std::size_t>(place->second)];
      const double length = (surface.nodes.row(a) - surface.nodes.row(b)).norm();
      const double distance = (element.corners.colwise().mean() - other.corners.colwise().mean()).norm();
      for (int direction = 0; direction < 2; ++direction) {
        Form jump;
        for (int k = 0; k < 4; ++k) {
          jump.emplace_back(surface.cells(e, k), element.slopes(k, direction));
          jump.emplace_back(surface.cells(place->second, k), -other.slopes(k, direction));
        }
        add_square(jump, length / distance, dofs_per_node, entries);
      }
    }
  }
  const Eigen::Index size = surface.nodes.rows() * dofs_per_node;
  Eigen::SparseMatrix<double> energy(size, size);
  energy.setFromTriplets(entries.begin(), entries.end());
  return energy;
}

double smoothing_weight(const Correlation& correlation, double cut_off) {
  const double scale = std::abs(correlation.pixels_per_length().determinant());  // [px^2/length^2]
  return correlation.mean_square_gradient() * scale * scale * std::pow(cut_off / (2.0 * M_PI), 4);
}

Measure measured_by(const Cameras& cameras, const Eigen::SparseMatrix<double>& held) {
  Measure measure{.surface = cameras.surface(),
                  .dofs_per_node = cameras.dofs_per_node(),
                  .M = cameras.M(),
                  .smoothing_weight = [&cameras](double cut_off) { return cameras.smoothing_weight(cut_off); }};
  if (held.size() > 0) measure.M += held;
  return measure;
}

Eigen::MatrixXd smooth(const Measure& measure, const Eigen::MatrixXd& U, double cut_off) {
  return smooth(measure, U, std::vector<double>(static_cast<std::size_t>(U.cols()), cut_off));
}

Eigen::MatrixXd smooth(const Measure& measure, Eigen::MatrixXd U, const std::vector<double>& cut_offs) {
  std::map<double, std::vector<Eigen::Index>> frames_of;
  for (std::size_t t = 0; t < cut_offs.size() && static_cast<Eigen::Index>(t) < U.cols(); ++t)
    if (cut_offs[t] > 0.0) frames_of[cut_offs[t]].push_back(static_cast<Eigen::Index>(t));
  if (frames_of.empty()) return U;
  const Eigen::SparseMatrix<double> energy = curvature_energy(measure.surface, measure.dofs_per_node);
  Factor factor;
  factor.analyzePattern(measure.M + energy);
  for (const auto& [cut_off, frames] : frames_of) {
    const Eigen::SparseMatrix<double> bent = measure.smoothing_weight(cut_off) * energy;
    factor.factorize(measure.M + bent);
    const Columns own = U(Eigen::all, frames);
    U(Eigen::all, frames) = own - inverse_times(factor, bent * inverse_times(factor, bent * own));
  }
  return U;
}

Eigen::MatrixXd noise_draws(const Measure& measure, double sigma, int draws) {
  const Factor factor(measure.M);  // P M P^T = L D L^T
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd noise(measure.M.rows(), draws);
  for (double& value : noise.reshaped()) value = normal(random);
  noise = sigma * factor.vectorD().cwiseMax(1e-300).cwiseSqrt().cwiseInverse().asDiagonal() * noise;
  return factor.permutationPinv() * Eigen::MatrixXd(factor.matrixU().solve(noise));
}

std::vector<double> cut_offs_of_least_error(const Measure& measure, const Eigen::MatrixXd& U,
                                            const std::vector<int>& nodes, const Eigen::VectorXd& sigma,
                                            double longest) {
  std::vector<int> unknowns;
  for (int node : nodes)
    for (int component = 0; component < measure.dofs_per_node; ++component)
      unknowns.push_back(measure.dofs_per_node * node + component);
  const auto count = static_cast<Eigen::Index>(unknowns.size()), frames = U.cols();
  const Columns measured = U;
  Columns at = Columns::Zero(U.rows(), count);
  for (Eigen::Index i = 0; i < count; ++i) at(unknowns[static_cast<std::size_t>(i)], i) = 1.0;
  const auto diagonal = [&](const Columns& columns) {
    return Eigen::ArrayXd(columns(unknowns, Eigen::all).diagonal().array());
  };
  const Eigen::SparseMatrix<double> energy = curvature_energy(measure.surface, measure.dofs_per_node);
  // Each unknown in units of its own noise: a node that is hardly seen would outweigh all others.
  const Eigen::ArrayXd variance = diagonal(inverse_times(Factor(measure.M), at)).cwiseMax(1e-300);
  std::vector<double> cut_offs{0.0};
  for (double cut_off = longest; cut_off > 0.99 * longest / 128.0; cut_off /= std::sqrt(2.0))
    cut_offs.push_back(cut_off);
  Eigen::MatrixXd error(static_cast<Eigen::Index>(cut_offs.size()), frames);
  error.row(0).setConstant(2.0 * static_cast<double>(count));
  Factor factor;
  factor.analyzePattern(measure.M + energy);
  for (std::size_t k = 1; k < cut_offs.size(); ++k) {
    const Eigen::SparseMatrix<double> bent = measure.smoothing_weight(cut_offs[k]) * energy;
    factor.factorize(measure.M + bent);
    const Columns lost = inverse_times(factor, bent * inverse_times(factor, bent * measured)),
                  once = inverse_times(factor, at);
    // of the noise: its covariance with what smoothing leaves of it, over sigma^2
    const Eigen::ArrayXd kept =
        2.0 * diagonal(once) - once.cwiseProduct(Columns(measure.M * once)).colwise().sum().transpose().array();
    error.row(static_cast<Eigen::Index>(k)) =
        (lost(unknowns, Eigen::all).array().square().colwise() / variance).colwise().sum() /
            sigma.transpose().array().square() +
        2.0 * (kept / variance).sum();
  }
  std::vector<double> chosen(static_cast<std::size_t>(frames));
  for (Eigen::Index t = 0; t < frames; ++t) {
    const Eigen::Index from = std::max<Eigen::Index>(0, t - beside), to = std::min(frames, t + beside + 1);
    Eigen::Index best = 0;
    error.middleCols(from, to - from).rowwise().sum().minCoeff(&best);
    chosen[static_cast<std::size_t>(t)] = cut_offs[static_cast<std::size_t>(best)];
  }
  return chosen;
}

std::vector<double> undersmoothed(std::vector<double> cut_offs, double longest) {
  for (double& cut_off : cut_offs)
    if (cut_off < 0.99 * longest) cut_off /= std::sqrt(2.0);
  return cut_offs;
}

}  // namespace imic3d::correlation
