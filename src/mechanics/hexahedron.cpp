#include "imic3d/mechanics/hexahedron.hpp"

#include <Eigen/Dense>
#include <array>
#include <cmath>

namespace imic3d::mechanics {

namespace {

using Gradient = Eigen::Matrix<double, 8, 3>;
using Gradient20 = Eigen::Matrix<double, 20, 3>;

/// Natural coordinates of the corners, and of the middles of the edges of a hex20.
constexpr std::array<std::array<int, 3>, 20> corner = {
    {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1}, {-1, -1, 1}, {1, -1, 1}, {1, 1, 1}, {-1, 1, 1},  //
     {0, -1, -1},  {1, 0, -1},  {0, 1, -1}, {-1, 0, -1}, {0, -1, 1},  {1, 0, 1},  {0, 1, 1}, {-1, 0, 1},  //
     {-1, -1, 0},  {1, -1, 0},  {1, 1, 0},  {-1, 1, 0}}};
const double g = 1.0 / std::sqrt(3.0);

/// dN/dxi of the trilinear shape functions at the Gauss points.
std::array<Gradient, hexahedron_points> natural_gradients() {
  std::array<Gradient, hexahedron_points> gradients;
  for (int point = 0; point < hexahedron_points; ++point) {
    const Eigen::Vector3d xi(g * corner[point][0], g * corner[point][1], g * corner[point][2]);
    for (int a = 0; a < 8; ++a) {
      const double r = 1.0 + corner[a][0] * xi[0], s = 1.0 + corner[a][1] * xi[1], t = 1.0 + corner[a][2] * xi[2];
      gradients[point].row(a) << corner[a][0] * s * t, r * corner[a][1] * t, r * s * corner[a][2];
    }
    gradients[point] *= 0.125;
  }
  return gradients;
}

const std::array<Gradient, hexahedron_points> dN_dxi = natural_gradients();

/// dN/dxi of the serendipity shape functions at the Gauss points: at a corner N = r s t (xi.a - 2) / 8 with
/// r = 1 + xi_1 a_1 and so on; at a middle, the factor along its edge is 1 - xi^2 and the others are linear, over 4.
std::array<Gradient20, hexahedron_points> quadratic_gradients() {
  std::array<Gradient20, hexahedron_points> gradients;
  for (std::size_t point = 0; point < gradients.size(); ++point)
    for (std::size_t a = 0; a < corner.size(); ++a) {
      std::array<double, 3> factor{}, slope{};
      double sum = -2.0;
      for (std::size_t i = 0; i < 3; ++i) {
        const double xi = g * corner[point][i], at = corner[a][i];
        factor[i] = at == 0.0 ? 1.0 - xi * xi : 1.0 + xi * at;
        slope[i] = at == 0.0 ? -2.0 * xi : at;
        sum += xi * at;
      }
      const bool is_corner = a < 8;
      for (std::size_t i = 0; i < 3; ++i) {
        const double others = factor[(i + 1) % 3] * factor[(i + 2) % 3];
        gradients[point](static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(i)) =
            is_corner ? 0.125 * others * corner[a][i] * (sum + factor[i]) : 0.25 * others * slope[i];
      }
    }
  return gradients;
}

const std::array<Gradient20, hexahedron_points> dN_dxi_20 = quadratic_gradients();

/// Kinematics at the points of a hex8, the element's volume ratio theta and mean spatial gradient.
struct MeanDilatation {
  std::array<Gradient, hexahedron_points> dN_dx;
  std::array<Eigen::Matrix3d, hexahedron_points> F;
  std::array<double, hexahedron_points> dV, J;
  Gradient mean = Gradient::Zero();
  double theta = 0.0, volume = 0.0, reference_volume = 0.0;

  /// False where the element is inverted.
  template <class Displacement>
  [[nodiscard]] bool set(const ElementNodes<8>& nodes, const Displacement& u) noexcept {
    for (std::size_t point = 0; point < hexahedron_points; ++point) {
      const Eigen::Matrix3d dX_dxi = nodes.transpose() * dN_dxi[point];
      dV[point] = dX_dxi.determinant();
      if (!(dV[point] > 0.0)) return false;
      const Gradient dN_dX = dN_dxi[point] * dX_dxi.inverse();
      F[point] = Eigen::Matrix3d::Identity() + u.transpose() * dN_dX;
      J[point] = F[point].determinant();
      if (!(J[point] > 0.0)) return false;
      dN_dx[point] = dN_dX * F[point].inverse();
      reference_volume += dV[point];
      volume += J[point] * dV[point];
      mean += J[point] * dV[point] * dN_dx[point];
    }
    mean /= volume;
    theta = volume / reference_volume;
    return true;
  }
};

}  // namespace

bool evaluate(const material::FiniteStrainLaw& law, std::span<const double> parameters, double time_increment,
              const ElementNodes<8>& nodes, const ElementVector<8>& displacement, std::span<const double> history_old,
              std::span<double> history_new, ElementResult<8>& result, bool with_tangent) noexcept {
  const Eigen::Map<const Eigen::Matrix<double, 8, 3, Eigen::RowMajor>> u(displacement.data());

  MeanDilatation at;
  if (!at.set(nodes, u)) return false;
  const auto& [dN_dx, F, dV, J, mean, theta, volume, reference_volume] = at;

  result.force.setZero();
  result.cauchy_stress.setZero();
  result.plastic_strain = 0.0;
  if (with_tangent) result.tangent.setZero();
  double pressure_volume = 0.0;  // sum of tr(tau)/3 dV

  const auto size = static_cast<std::size_t>(law.history_size());
  for (int point = 0; point < hexahedron_points; ++point) {
    const auto offset = static_cast<std::size_t>(point) * size;
    material::Response response;
    const Eigen::Matrix3d Fbar = std::cbrt(theta / J[point]) * F[point];
    if (!law.update(Fbar, time_increment, parameters, history_old.subspan(offset, size),
                    history_new.subspan(offset, size), response, with_tangent))
      return false;

    const Gradient& dN = dN_dx[point];
    const Gradient dilatation = (mean - dN) / 3.0;  // alpha_ai: what the averaging adds to each normal strain
    const Eigen::Matrix3d tau = tensor(response.kirchhoff);
    const Gradient traction = dN * tau;  // tau grad N_a
    const double trace = tau.trace();
    const Gradient force = traction + trace * dilatation;
    for (int a = 0; a < 8; ++a) result.force.segment<3>(3 * a) += dV[point] * force.row(a).transpose();

    result.cauchy_stress += dV[point] / theta * response.kirchhoff;
    if (law.plastic_strain_index() >= 0)
      result.plastic_strain += dV[point] * history_new[offset + static_cast<std::size_t>(law.plastic_strain_index())];
    if (!with_tangent) continue;

    // Material part: Bbar^T c Bbar.
    Eigen::Matrix<double, 6, 24> B;
    for (int a = 0; a < 8; ++a) {
      const auto n = dN.row(a);
      B.block<6, 3>(0, 3 * a) << n[0], 0, 0, 0, n[1], 0, 0, 0, n[2], n[1], n[0], 0, 0, n[2], n[1], n[2], 0, n[0];
      B.block<3, 3>(0, 3 * a).rowwise() += dilatation.row(a);
    }
    const Eigen::Matrix<double, 6, 24> cB = (dV[point] * response.tangent).lazyProduct(B);
    result.tangent += B.transpose().lazyProduct(cB);

    // Geometric part: tau : (grad du^T grad Du), and the change of the averaged gradient.
    const Eigen::Matrix<double, 8, 8> stiffening = dV[point] * traction.lazyProduct(dN.transpose());
    Eigen::Matrix<double, 24, 1> alpha, t;
    for (int a = 0; a < 8; ++a) {
      alpha.segment<3>(3 * a) = dilatation.row(a).transpose();
      t.segment<3>(3 * a) = dV[point] * (2.0 * traction.row(a) + trace * dilatation.row(a)).transpose();
    }
    result.tangent.noalias() += alpha * t.transpose();
    result.tangent.noalias() += t * alpha.transpose();
    const double pressure = trace / 3.0 * dV[point];
    pressure_volume += pressure;
    for (int a = 0; a < 8; ++a)
      for (int b = 0; b < 8; ++b) {
        result.tangent.block<3, 3>(3 * a, 3 * b).diagonal().array() += stiffening(a, b);
        result.tangent.block<3, 3>(3 * a, 3 * b).noalias() += pressure * dN.row(b).transpose() * dN.row(a);
      }
  }
  result.cauchy_stress /= reference_volume;
  result.plastic_strain /= reference_volume;

  if (with_tangent) {
    // p * second variation of theta, up to the part taken at the points above.
    for (int point = 0; point < hexahedron_points; ++point) {
      const Gradient& dN = dN_dx[point];
      const double weight = pressure_volume * J[point] * dV[point] / volume;
      for (int a = 0; a < 8; ++a)
        for (int b = 0; b < 8; ++b)
          result.tangent.block<3, 3>(3 * a, 3 * b).noalias() +=
              weight * (dN.row(a).transpose() * dN.row(b) - dN.row(b).transpose() * dN.row(a));
    }
    Eigen::Matrix<double, 24, 1> m;
    for (int a = 0; a < 8; ++a) m.segment<3>(3 * a) = mean.row(a).transpose();
    result.tangent.noalias() -= pressure_volume * (m * m.transpose());
  }
  return result.force.allFinite();
}

bool evaluate(const material::FiniteStrainLaw& law, std::span<const double> parameters, double time_increment,
              const ElementNodes<20>& nodes, const ElementVector<20>& displacement, std::span<const double> history_old,
              std::span<double> history_new, ElementResult<20>& result, bool with_tangent) noexcept {
  const Eigen::Map<const Eigen::Matrix<double, 20, 3, Eigen::RowMajor>> u(displacement.data());
  result.force.setZero();
  result.cauchy_stress.setZero();
  result.plastic_strain = 0.0;
  if (with_tangent) result.tangent.setZero();
  // tau : (grad N_a x grad N_b) dV
  Eigen::Matrix<double, 20, 20> stiffening = Eigen::Matrix<double, 20, 20>::Zero();
  double reference_volume = 0.0;
  const auto size = static_cast<std::size_t>(law.history_size());
  for (std::size_t point = 0; point < hexahedron_points; ++point) {
    const Eigen::Matrix3d dX_dxi = nodes.transpose().lazyProduct(dN_dxi_20[point]);
    const double dV = dX_dxi.determinant();
    if (!(dV > 0.0)) return false;
    const Gradient20 dN_dX = dN_dxi_20[point].lazyProduct(dX_dxi.inverse().eval());
    const Eigen::Matrix3d F = Eigen::Matrix3d::Identity() + u.transpose().lazyProduct(dN_dX);
    const double J = F.determinant();
    if (!(J > 0.0)) return false;
    material::Response response;
    const std::size_t offset = point * size;
    if (!law.update(F, time_increment, parameters, history_old.subspan(offset, size), history_new.subspan(offset, size),
                    response, with_tangent))
      return false;
    const Gradient20 dN = dN_dX.lazyProduct(F.inverse().eval());
    const Gradient20 traction = dN.lazyProduct((dV * tensor(response.kirchhoff)).eval());
    for (int a = 0; a < 20; ++a) result.force.segment<3>(3 * a) += traction.row(a).transpose();
    reference_volume += dV;
    result.cauchy_stress += dV / J * response.kirchhoff;
    if (law.plastic_strain_index() >= 0)
      result.plastic_strain += dV * history_new[offset + static_cast<std::size_t>(law.plastic_strain_index())];
    if (!with_tangent) continue;

    Eigen::Matrix<double, 60, 6> Bt;
    for (int a = 0; a < 20; ++a) {
      const auto n = dN.row(a);
      Bt.block<3, 6>(3 * a, 0) << n[0], 0, 0, n[1], 0, n[2], 0, n[1], 0, n[0], n[2], 0, 0, 0, n[2], 0, n[1], n[0];
    }
    // B^T c B column by column: of a column of B three numbers are not zero.
    const Eigen::Matrix<double, 60, 6> Btc = Bt.lazyProduct(dV * response.tangent);
    for (int a = 0; a < 20; ++a) {
      const auto n = dN.row(a);
      result.tangent.col(3 * a) += n[0] * Btc.col(0) + n[1] * Btc.col(3) + n[2] * Btc.col(5);
      result.tangent.col(3 * a + 1) += n[1] * Btc.col(1) + n[0] * Btc.col(3) + n[2] * Btc.col(4);
      result.tangent.col(3 * a + 2) += n[2] * Btc.col(2) + n[1] * Btc.col(4) + n[0] * Btc.col(5);
    }
    stiffening += traction.lazyProduct(dN.transpose());
  }
  if (with_tangent)
    for (int b = 0; b < 20; ++b)
      for (int a = 0; a < 20; ++a) result.tangent.block<3, 3>(3 * a, 3 * b).diagonal().array() += stiffening(a, b);
  result.cauchy_stress /= reference_volume;
  result.plastic_strain /= reference_volume;
  return result.force.allFinite();
}

bool differentiate(const material::FiniteStrainLaw& law, std::span<const double> parameters, double time_increment,
                   const ElementNodes<8>& nodes, const ElementVector<8>& displacement,
                   std::span<const double> history_old, const ElementColumns<8>& d_displacement,
                   const ElementDirections& along, ElementColumns<8>& d_force) noexcept {
  using ByNode = Eigen::Map<const Eigen::Matrix<double, 8, 3, Eigen::RowMajor>>;
  MeanDilatation at;
  if (!at.set(nodes, ByNode(displacement.data()))) return false;
  const auto n = static_cast<std::size_t>(d_displacement.cols());

  // How volume and mean gradient move: dJ = J tr L, d(dN_a) = -L^T dN_a with L = sum_a du_a dN_a^T.
  std::array<std::array<Eigen::Matrix3d, hexahedron_points>, most_directions> L;
  std::array<Gradient, most_directions> d_mean;
  std::array<double, most_directions> d_volume{};
  for (std::size_t k = 0; k < n; ++k) {
    d_mean[k].setZero();
    for (std::size_t point = 0; point < hexahedron_points; ++point) {
      const Gradient& dN = at.dN_dx[point];
      const double dv = at.J[point] * at.dV[point];
      L[k][point] = ByNode(d_displacement.col(static_cast<Eigen::Index>(k)).data()).transpose() * dN;
      d_volume[k] += dv * L[k][point].trace();
      d_mean[k] += dv * (L[k][point].trace() * dN - dN * L[k][point]);
    }
    d_mean[k] = (d_mean[k] - d_volume[k] * at.mean) / at.volume;
  }

  d_force.setZero(24, d_displacement.cols());
  PointDirections response;
  for (std::size_t point = 0; point < hexahedron_points; ++point) {
    const Eigen::Matrix3d Fbar = std::cbrt(at.theta / at.J[point]) * at.F[point];
    for (std::size_t k = 0; k < n; ++k)
      response.dF[k] = L[k][point] * Fbar + (d_volume[k] / at.volume - L[k][point].trace()) / 3.0 * Fbar;
    if (!response.update(law, Fbar, time_increment, parameters, history_old, point, n, along)) return false;
    // f_a = sum dV (tau dN_a + tr tau (mean_a - dN_a)/3), term by term
    const Gradient& dN = at.dN_dx[point];
    const Eigen::Matrix3d tau = tensor(response.kirchhoff);
    for (std::size_t k = 0; k < n; ++k) {
      const Eigen::Matrix3d d_tau = tensor(response.d_kirchhoff[k]);
      const Gradient turning = dN * L[k][point];
      const Gradient df =
          dN * d_tau - turning * tau + d_tau.trace() / 3.0 * (at.mean - dN) + tau.trace() / 3.0 * (d_mean[k] + turning);
      for (int a = 0; a < 8; ++a)
        d_force.col(static_cast<Eigen::Index>(k)).segment<3>(3 * a) += at.dV[point] * df.row(a).transpose();
    }
  }
  return d_force.allFinite();
}

bool differentiate(const material::FiniteStrainLaw& law, std::span<const double> parameters, double time_increment,
                   const ElementNodes<20>& nodes, const ElementVector<20>& displacement,
                   std::span<const double> history_old, const ElementColumns<20>& d_displacement,
                   const ElementDirections& along, ElementColumns<20>& d_force) noexcept {
  using ByNode = Eigen::Map<const Eigen::Matrix<double, 20, 3, Eigen::RowMajor>>;
  const ByNode u(displacement.data());
  const auto n = static_cast<std::size_t>(d_displacement.cols());
  d_force.setZero(60, d_displacement.cols());
  PointDirections response;
  for (std::size_t point = 0; point < hexahedron_points; ++point) {
    const Eigen::Matrix3d dX_dxi = nodes.transpose().lazyProduct(dN_dxi_20[point]);
    const double dV = dX_dxi.determinant();
    const Gradient20 dN_dX = dN_dxi_20[point].lazyProduct(dX_dxi.inverse().eval());
    const Eigen::Matrix3d F = Eigen::Matrix3d::Identity() + u.transpose().lazyProduct(dN_dX);
    if (!(dV > 0.0) || !(F.determinant() > 0.0)) return false;
    const Gradient20 dN = dN_dX.lazyProduct(F.inverse().eval());
    for (std::size_t k = 0; k < n; ++k) {
      response.L[k] = ByNode(d_displacement.col(static_cast<Eigen::Index>(k)).data()).transpose().lazyProduct(dN);
      response.dF[k] = response.L[k] * F;
    }
    if (!response.update(law, F, time_increment, parameters, history_old, point, n, along)) return false;
    // f_a = sum dV tau dN_a and d(dN_a) = -L^T dN_a
    for (std::size_t k = 0; k < n; ++k) {
      const Gradient20 df =
          dN.lazyProduct((dV * (tensor(response.d_kirchhoff[k]) - response.L[k] * tensor(response.kirchhoff))).eval());
      for (int a = 0; a < 20; ++a) d_force.col(static_cast<Eigen::Index>(k)).segment<3>(3 * a) += df.row(a).transpose();
    }
  }
  return d_force.allFinite();
}

}  // namespace imic3d::mechanics
