#include "imic3d/mechanics/quadrilateral.hpp"

#include <Eigen/Dense>
#include <array>
#include <cmath>

namespace imic3d::mechanics {

namespace {

/// Natural coordinates of the corners, and of the middles of the edges of a quad8.
constexpr std::array<std::array<int, 2>, 8> corner = {
    {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}, {0, -1}, {1, 0}, {0, 1}, {-1, 0}}};
const double g = 1.0 / std::sqrt(3.0);

/// dN/dxi at the Gauss points. Bilinear: N = r s / 4 with r = 1 + xi_1 a_1, s = 1 + xi_2 a_2. Serendipity: at a corner
/// N = r s (xi.a - 1) / 4; at a middle the factor along its edge is 1 - xi^2 and the other is linear, over 2.
template <int nodes>
std::array<Eigen::Matrix<double, nodes, 2>, quadrilateral_points> natural_gradients() {
  std::array<Eigen::Matrix<double, nodes, 2>, quadrilateral_points> gradients;
  for (std::size_t point = 0; point < gradients.size(); ++point)
    for (std::size_t a = 0; a < nodes; ++a) {
      std::array<double, 2> factor{}, slope{};
      double sum = -1.0;
      for (std::size_t i = 0; i < 2; ++i) {
        const double xi = g * corner[point][i], at = corner[a][i];
        factor[i] = at == 0.0 ? 1.0 - xi * xi : 1.0 + xi * at;
        slope[i] = at == 0.0 ? -2.0 * xi : at;
        sum += xi * at;
      }
      for (std::size_t i = 0; i < 2; ++i) {
        const double other = factor[1 - i];
        double value = 0.25 * slope[i] * other;
        if (nodes == 8) value = a < 4 ? 0.25 * other * corner[a][i] * (sum + factor[i]) : 0.5 * slope[i] * other;
        gradients[point](static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(i)) = value;
      }
    }
  return gradients;
}

template <int nodes>
const std::array<Eigen::Matrix<double, nodes, 2>, quadrilateral_points> dN_dxi = natural_gradients<nodes>();

/// The components 11, 22, 12 of a symmetric tensor.
constexpr std::array<int, 3> in_plane = {0, 1, 3};

}  // namespace

template <int nodes_count>
bool evaluate(const material::FiniteStrainLaw& law, double thickness, std::span<const double> parameters,
              double time_increment, const ElementNodes<nodes_count, 2>& nodes,
              const ElementVector<nodes_count, 2>& displacement, std::span<const double> history_old,
              std::span<double> history_new, ElementResult<nodes_count, 2>& result, bool with_tangent) noexcept {
  constexpr int dofs = 2 * nodes_count;
  using Gradient = Eigen::Matrix<double, nodes_count, 2>;
  const Eigen::Map<const Eigen::Matrix<double, nodes_count, 2, Eigen::RowMajor>> u(displacement.data());
  result.force.setZero();
  result.cauchy_stress.setZero();
  result.plastic_strain = 0.0;
  if (with_tangent) result.tangent.setZero();
  double reference_volume = 0.0;
  const auto size = static_cast<std::size_t>(law.history_size());
  for (std::size_t point = 0; point < quadrilateral_points; ++point) {
    const Eigen::Matrix2d dX_dxi = nodes.transpose() * dN_dxi<nodes_count>[point];
    const double dV = thickness * dX_dxi.determinant();
    if (!(dV > 0.0)) return false;
    const Gradient dN_dX = dN_dxi<nodes_count>[point] * dX_dxi.inverse();
    const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + u.transpose() * dN_dX;
    const double area_ratio = F.determinant();
    if (!(area_ratio > 0.0)) return false;

    Eigen::Matrix3d F_of_law = Eigen::Matrix3d::Identity();
    F_of_law.topLeftCorner<2, 2>() = F;
    material::Response response;
    const std::size_t offset = point * size;
    if (!law.update(F_of_law, time_increment, parameters, history_old.subspan(offset, size),
                    history_new.subspan(offset, size), response, with_tangent))
      return false;
    // lambda_3
    const double stretch = std::exp(history_new[offset + static_cast<std::size_t>(law.thickness_strain_index())]);

    const Gradient dN = dN_dX * F.inverse();
    Eigen::Matrix2d tau;
    tau << response.kirchhoff[0], response.kirchhoff[3], response.kirchhoff[3], response.kirchhoff[1];
    const Gradient traction = dV * dN * tau;
    for (int a = 0; a < nodes_count; ++a) result.force.template segment<2>(2 * a) += traction.row(a).transpose();
    reference_volume += dV;
    result.cauchy_stress += dV / (area_ratio * stretch) * response.kirchhoff;
    if (law.plastic_strain_index() >= 0)
      result.plastic_strain += dV * history_new[offset + static_cast<std::size_t>(law.plastic_strain_index())];
    if (!with_tangent) continue;

    Eigen::Matrix3d c;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        c(i, j) = dV * response.tangent(in_plane[static_cast<std::size_t>(i)], in_plane[static_cast<std::size_t>(j)]);
    Eigen::Matrix<double, 3, dofs> B;
    for (int a = 0; a < nodes_count; ++a)
      B.template block<3, 2>(0, 2 * a) << dN(a, 0), 0, 0, dN(a, 1), dN(a, 1), dN(a, 0);
    const Eigen::Matrix<double, 3, dofs> cB = c.lazyProduct(B);
    result.tangent += B.transpose().lazyProduct(cB);
    const Eigen::Matrix<double, nodes_count, nodes_count> stiffening = traction.lazyProduct(dN.transpose());
    for (int a = 0; a < nodes_count; ++a)
      for (int b = 0; b < nodes_count; ++b)
        result.tangent.template block<2, 2>(2 * a, 2 * b).diagonal().array() += stiffening(a, b);
  }
  result.cauchy_stress /= reference_volume;
  result.plastic_strain /= reference_volume;
  return result.force.allFinite();
}

template <int nodes_count>
bool differentiate(const material::FiniteStrainLaw& law, double thickness, std::span<const double> parameters,
                   double time_increment, const ElementNodes<nodes_count, 2>& nodes,
                   const ElementVector<nodes_count, 2>& displacement, std::span<const double> history_old,
                   const ElementColumns<nodes_count, 2>& d_displacement, const ElementDirections& along,
                   ElementColumns<nodes_count, 2>& d_force) noexcept {
  using Gradient = Eigen::Matrix<double, nodes_count, 2>;
  using ByNode = Eigen::Map<const Eigen::Matrix<double, nodes_count, 2, Eigen::RowMajor>>;
  const ByNode u(displacement.data());
  const auto n = static_cast<std::size_t>(d_displacement.cols());
  d_force.setZero(2 * nodes_count, d_displacement.cols());
  PointDirections response;
  for (std::size_t point = 0; point < quadrilateral_points; ++point) {
    const Eigen::Matrix2d dX_dxi = nodes.transpose() * dN_dxi<nodes_count>[point];
    const double dV = thickness * dX_dxi.determinant();
    const Gradient dN_dX = dN_dxi<nodes_count>[point] * dX_dxi.inverse();
    Eigen::Matrix3d F = Eigen::Matrix3d::Identity();
    F.topLeftCorner<2, 2>() += u.transpose() * dN_dX;
    if (!(dV > 0.0) || !(F.determinant() > 0.0)) return false;
    const Gradient dN = dN_dX * F.topLeftCorner<2, 2>().inverse();
    for (std::size_t k = 0; k < n; ++k) {
      response.L[k].setZero();
      response.L[k].template topLeftCorner<2, 2>() =
          ByNode(d_displacement.col(static_cast<Eigen::Index>(k)).data()).transpose() * dN;
      response.dF[k] = response.L[k] * F;
    }
    if (!response.update(law, F, time_increment, parameters, history_old, point, n, along)) return false;
    // f_a = sum dV tau dN_a and d(dN_a) = -L^T dN_a
    for (std::size_t k = 0; k < n; ++k) {
      const Eigen::Matrix3d moved = tensor(response.d_kirchhoff[k]) - response.L[k] * tensor(response.kirchhoff);
      const Gradient df = dV * dN * moved.topLeftCorner<2, 2>();
      for (int a = 0; a < nodes_count; ++a)
        d_force.col(static_cast<Eigen::Index>(k)).template segment<2>(2 * a) += df.row(a).transpose();
    }
  }
  return d_force.allFinite();
}

template bool evaluate<4>(const material::FiniteStrainLaw&, double, std::span<const double>, double,
                          const ElementNodes<4, 2>&, const ElementVector<4, 2>&, std::span<const double>,
                          std::span<double>, ElementResult<4, 2>&, bool) noexcept;
template bool evaluate<8>(const material::FiniteStrainLaw&, double, std::span<const double>, double,
                          const ElementNodes<8, 2>&, const ElementVector<8, 2>&, std::span<const double>,
                          std::span<double>, ElementResult<8, 2>&, bool) noexcept;

template bool differentiate<4>(const material::FiniteStrainLaw&, double, std::span<const double>, double,
                               const ElementNodes<4, 2>&, const ElementVector<4, 2>&, std::span<const double>,
                               const ElementColumns<4, 2>&, const ElementDirections&, ElementColumns<4, 2>&) noexcept;
template bool differentiate<8>(const material::FiniteStrainLaw&, double, std::span<const double>, double,
                               const ElementNodes<8, 2>&, const ElementVector<8, 2>&, std::span<const double>,
                               const ElementColumns<8, 2>&, const ElementDirections&, ElementColumns<8, 2>&) noexcept;

}  // namespace imic3d::mechanics
