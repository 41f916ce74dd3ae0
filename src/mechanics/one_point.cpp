#include "imic3d/mechanics/one_point.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::mechanics {

namespace {

using Gradient = Eigen::Matrix<double, 8, 3>;
using Modes = Eigen::Matrix<double, 8, 4>;  // of the nodes
using Amplitudes = Eigen::Matrix<double, 3, 4>;
using Stiffness = Eigen::Matrix<double, 12, 12>;  // between amplitudes, by columns

/// Natural coordinates of the corners.
Gradient corners() {
  Gradient xi;
  xi << -1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1, -1, -1, -1, 1, 1, -1, 1, 1, 1, 1, -1, 1, 1;
  return xi;
}
const Gradient corner = corners();

/// h_alpha: eta zeta, zeta xi, xi eta, xi eta zeta at the corners.
Modes hourglass_vectors() {
  Modes h;
  for (int i = 0; i < 3; ++i) h.col(i) = corner.col((i + 1) % 3).cwiseProduct(corner.col((i + 2) % 3));
  h.col(3) = h.col(0).cwiseProduct(corner.col(0));
  return h;
}
const Modes h = hourglass_vectors();

/// dN/dxi of the trilinear shape functions at the points of the 2 x 2 x 2 rule.
std::array<Gradient, 8> natural_gradients() {
  std::array<Gradient, 8> gradients;
  for (int point = 0; point < 8; ++point)
    for (int a = 0; a < 8; ++a) {
      const Eigen::RowVector3d factor = 1.0 + (corner.row(a).array() * corner.row(point).array()) / std::sqrt(3.0);
      for (int i = 0; i < 3; ++i)
        gradients[static_cast<std::size_t>(point)](a, i) =
            0.125 * corner(a, i) * factor[(i + 1) % 3] * factor[(i + 2) % 3];
    }
  return gradients;
}
const std::array<Gradient, 8> dN_dxi = natural_gradients();

/// V_0 b, exact with 2 x 2 x 2 points: dN/dxi times the cofactors of dX/dxi. False where the element is inverted.
bool mean_gradient(const ElementNodes<8>& nodes, Gradient& b, double& volume) {
  b.setZero();
  volume = 0.0;
  for (const Gradient& dN : dN_dxi) {
    const Eigen::Matrix3d A = nodes.transpose() * dN;
    Eigen::Matrix3d cofactors;
    cofactors << A.col(1).cross(A.col(2)), A.col(2).cross(A.col(0)), A.col(0).cross(A.col(1));
    const double dV = A.col(0).dot(cofactors.col(0));
    if (!(dV > 0.0)) return false;
    b.noalias() += dN * cofactors.transpose();
    volume += dV;
  }
  b /= volume;
  return true;
}

Eigen::Matrix<double, 6, 1> components(const Eigen::Matrix3d& t) {
  return (Eigen::Matrix<double, 6, 1>() << t(0, 0), t(1, 1), t(2, 2), t(0, 1), t(1, 2), t(0, 2)).finished();
}

/// Moduli of the hourglass modes on the convected axes: secant across and tangent along the flow direction n.
struct HourglassModuli {
  double bulk, across, along;
  Eigen::Matrix3d metric, n;  // g_i . g_j and g_i . n g_j
};

/// D: from hourglass strains to stresses, through the compliance 1/(9K) 1 x 1 + 1/(2 G_s) (I_dev - n x n) + 1/(2 G_t) n
/// x n.
Stiffness hourglass_stiffness(const HourglassModuli& m, double volume) {
  const auto& g = m.metric;
  Stiffness D = Stiffness::Zero();
  for (int s = 0; s < 3; ++s) {
    const int i = (s + 1) % 3, j = (s + 2) % 3;
    // Stresses g_i g_i, g_j g_j and g_i g_j + g_j g_i: their traces, shares along n and products with each other.
    const Eigen::Vector3d trace(g(i, i), g(j, j), 2.0 * g(i, j)), share(m.n(i, i), m.n(j, j), 2.0 * m.n(i, j));
    const double a = g(i, i), b = g(j, j), c = g(i, j);
    Eigen::Matrix3d product;
    product << a * a, c * c, 2.0 * a * c, c * c, b * b, 2.0 * b * c, 2.0 * a * c, 2.0 * b * c, 2.0 * (a * b + c * c);
    const Eigen::Matrix3d compliance = trace * trace.transpose() / (9.0 * m.bulk) +
                                       (product - trace * trace.transpose() / 3.0) / (2.0 * m.across) +
                                       share * share.transpose() * (0.5 / m.along - 0.5 / m.across);
    const Eigen::Matrix3d plane = volume / 3.0 * compliance.inverse();
    // E_ii = Q_ij, E_jj = Q_ji, 2 E_ij = Q_ii + Q_jj
    const std::array<std::array<int, 2>, 4> place = {{{3 * j + i, 0}, {3 * i + j, 1}, {3 * i + i, 2}, {3 * j + j, 2}}};
    for (const auto& [row, k] : place)
      for (const auto& [column, l] : place) D(row, column) += plane(k, l);
    D(9 + i, 9 + i) += volume / 9.0 / compliance(0, 0);
  }
  return D;
}

/// G_t/G: the stiffness of the corotated Kirchhoff stress along its deviator's direction, n : (c + tau 1 + 1 tau) : n /
/// (2 G).
double tangent_ratio(const Eigen::Matrix3d& tau, const Eigen::Matrix3d& n, const material::Matrix6& c, double shear) {
  material::Vector6 rate = components(n);
  rate.tail<3>() *= 2.0;  // engineering shears
  return (rate.dot(c * rate) + 2.0 * (tau * n * n).trace()) / (2.0 * shear);
}

}  // namespace

ElasticModuli elastic_moduli(const material::FiniteStrainLaw& law, std::span<const double> parameters) {
  std::vector<double> history(static_cast<std::size_t>(law.history_size())), after(history.size());
  law.initialise(history);
  material::Response rest;
  if (!law.update(Eigen::Matrix3d::Identity(), 1.0, parameters, history, after, rest, true))
    throw ConvergenceError("the law " + law.name() + " has no tangent at rest");
  const auto& c = rest.tangent;
  const double shear = (c(3, 3) + c(4, 4) + c(5, 5)) / 3.0;
  return {.shear = shear, .bulk = c.topLeftCorner<3, 3>().sum() / 9.0};
}

bool evaluate_one_point(const material::FiniteStrainLaw& law, std::span<const double> parameters, double time_increment,
                        const ElementNodes<8>& nodes, const ElementVector<8>& displacement,
                        std::span<const double> history_old, std::span<double> history_new, ElementResult<8>& result,
                        bool with_tangent, const ElasticModuli* elastic) noexcept {
  const Eigen::Map<const Eigen::Matrix<double, 8, 3, Eigen::RowMajor>> u(displacement.data());
  Gradient b;
  double volume = 0.0;
  if (!mean_gradient(nodes, b, volume)) return false;
  const Eigen::Matrix3d F = Eigen::Matrix3d::Identity() + u.transpose() * b;
  const double J = F.determinant();
  if (!(J > 0.0)) return false;
  const auto size = static_cast<std::size_t>(law.history_size());
  material::Response response;
  if (!law.update(F, time_increment, parameters, history_old.first(size), history_new.first(size), response,
                  with_tangent || elastic != nullptr))
    return false;
  const auto plastic_strain = [&](std::span<const double> history) {
    return law.plastic_strain_index() >= 0 ? history[static_cast<std::size_t>(law.plastic_strain_index())] : 0.0;
  };

  const Eigen::Matrix3d tau = tensor(response.kirchhoff);
  const Gradient dN = b * F.inverse(), traction = volume * dN * tau;
  Gradient force = traction;
  result.cauchy_stress = response.kirchhoff / J;
  result.plastic_strain = plastic_strain(history_new);
  Eigen::Matrix<double, 8, 8> stiffening;  // geometric stiffness, the same along every axis
  if (with_tangent) {
    Eigen::Matrix<double, 6, 24> B;
    for (int a = 0; a < 8; ++a) {
      const auto n = dN.row(a);
      B.block<6, 3>(0, 3 * a) << n[0], 0, 0, 0, n[1], 0, 0, 0, n[2], n[1], n[0], 0, 0, n[2], n[1], n[2], 0, n[0];
    }
    const Eigen::Matrix<double, 6, 24> cB = (volume * response.tangent).lazyProduct(B);
    result.tangent = B.transpose().lazyProduct(cB);
    stiffening = traction.lazyProduct(dN.transpose());
  }

  if (elastic != nullptr) {
    using State = Eigen::Map<const Eigen::Matrix<double, hourglass_state, 1>>;
    const State old(history_old.data() + size);
    Eigen::Map<Eigen::Matrix<double, hourglass_state, 1>> state(history_new.data() + size);
    const Eigen::Matrix3d dX_dxi = 0.125 * nodes.transpose() * corner, g = F * dX_dxi;
    const Gradient b_xi = b * dX_dxi;
    const Modes gamma = 0.125 * (h - b * (nodes.transpose() * h));
    const Amplitudes q = u.transpose() * gamma, Q = g.transpose() * q;

    const Eigen::Matrix3d s = tau - tau.trace() / 3.0 * Eigen::Matrix3d::Identity();
    const double mises = std::sqrt(1.5) * s.norm(), dep = result.plastic_strain - plastic_strain(history_old);

    // (i) the moduli, the metric and the regime of the last step
    const Eigen::Matrix3d metric = dX_dxi.transpose() * dX_dxi + tensor(old.segment<6>(2));
    const auto stress = [&](double along, double across, const Eigen::Matrix3d& n,
                            Stiffness& D) -> Eigen::Matrix<double, 12, 1> {
      D = hourglass_stiffness({elastic->bulk, across * elastic->shear, along * elastic->shear, metric, n}, volume);
      if (along < 1.0) return D * Q.reshaped();
      return old.segment<12>(26) + D * (Q.reshaped() - old.segment<12>(14));
    };
    Stiffness D;
    Amplitudes T;
    T.reshaped() = stress(1.0 - old[0], 1.0 - old[1], tensor(old.segment<6>(8)), D);

    // (ii) force and tangent: dQ_i = dg_i . q + g_i . dq
    force.noalias() += b_xi * T * q.transpose() + gamma * T.transpose() * g.transpose();
    if (with_tangent) {
      Eigen::Matrix<double, 12, 24> B;
      for (int a = 0; a < 8; ++a)
        for (int alpha = 0; alpha < 4; ++alpha)
          B.block<3, 3>(3 * alpha, 3 * a) =
              b_xi.row(a).transpose() * q.col(alpha).transpose() + gamma(a, alpha) * g.transpose();
      if (elastic->begins) {
        const double G = elastic->shear * (dep > 0.0 ? mises / (mises + 3.0 * elastic->shear * dep) : 1.0);
        D = hourglass_stiffness({elastic->bulk, G, G, metric, Eigen::Matrix3d::Zero()}, volume);
      }
      const Eigen::Matrix<double, 12, 24> DB = D.lazyProduct(B);
      result.tangent += B.transpose().lazyProduct(DB);
      const Eigen::Matrix<double, 8, 8> cross = b_xi * T * gamma.transpose();
      stiffening += cross + cross.transpose();
    }

    // (iii) what the next step sees
    double along = 1.0, across = 1.0;
    Eigen::Matrix3d n = Eigen::Matrix3d::Zero();
    if (dep > 0.0) {
      n = s / std::max(s.norm(), 1e-12 * elastic->shear);
      across = std::clamp(mises / (mises + 3.0 * elastic->shear * result.plastic_strain), least_hourglass_modulus,
                          most_flowing_modulus);
      along = std::clamp(tangent_ratio(tau, n, response.tangent, elastic->shear), least_hourglass_modulus, across);
      n = g.transpose() * n * g;
    }
    Stiffness next;
    state[0] = 1.0 - along;
    state[1] = 1.0 - across;
    state.segment<6>(2) = components(g.transpose() * g - dX_dxi.transpose() * dX_dxi);
    state.segment<6>(8) = components(n);
    state.segment<12>(14) = Q.reshaped();
    state.segment<12>(26) = stress(along, across, n, next);
  }

  for (int a = 0; a < 8; ++a) result.force.segment<3>(3 * a) = force.row(a).transpose();
  if (with_tangent)
    for (int a = 0; a < 8; ++a)
      for (int c = 0; c < 8; ++c) result.tangent.block<3, 3>(3 * a, 3 * c).diagonal().array() += stiffening(a, c);
  return result.force.allFinite();
}

bool differentiate_one_point(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                             double time_increment, const ElementNodes<8>& nodes, const ElementVector<8>& displacement,
                             std::span<const double> history_old, const ElementColumns<8>& d_displacement,
                             const ElementDirections& along, ElementColumns<8>& d_force) noexcept {
  using ByNode = Eigen::Map<const Eigen::Matrix<double, 8, 3, Eigen::RowMajor>>;
  Gradient b;
  double volume = 0.0;
  if (!mean_gradient(nodes, b, volume)) return false;
  const Eigen::Matrix3d F = Eigen::Matrix3d::Identity() + ByNode(displacement.data()).transpose() * b;
  if (!(F.determinant() > 0.0)) return false;
  const Gradient dN = b * F.inverse();
  const auto n = static_cast<std::size_t>(d_displacement.cols());
  PointDirections response;
  for (std::size_t k = 0; k < n; ++k) {
    response.L[k] = ByNode(d_displacement.col(static_cast<Eigen::Index>(k)).data()).transpose() * dN;
    response.dF[k] = response.L[k] * F;
  }
  if (!response.update(law, F, time_increment, parameters, history_old, 0, n, along)) return false;
  // f_a = V_0 tau dN_a and d(dN_a) = -L^T dN_a
  d_force.resize(24, d_displacement.cols());
  for (std::size_t k = 0; k < n; ++k) {
    const Gradient df = volume * dN * (tensor(response.d_kirchhoff[k]) - response.L[k] * tensor(response.kirchhoff));
    for (int a = 0; a < 8; ++a) d_force.col(static_cast<Eigen::Index>(k)).segment<3>(3 * a) = df.row(a).transpose();
  }
  return d_force.allFinite();
}

}  // namespace imic3d::mechanics
