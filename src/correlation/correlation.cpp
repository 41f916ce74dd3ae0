#include "imic3d/correlation/correlation.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <numeric>

#include "bilinear.hpp"
#include "imic3d/core/lanes.hpp"
#include "pixel_sums.hpp"

namespace imic3d::correlation {
namespace {

/// F^-T of every element; an element that has collapsed keeps the reference's gradient.
std::vector<Eigen::Matrix2d> transport_of(std::vector<Eigen::Matrix2d> F) {
  for (Eigen::Matrix2d& of_element : F)
    of_element = of_element.determinant() > 0.05 ? Eigen::Matrix2d(of_element.inverse().transpose())
                                                 : Eigen::Matrix2d::Identity();
  return F;
}

double in_order(const Eigen::VectorXd& values) { return std::accumulate(values.begin(), values.end(), 0.0); }

}  // namespace

Correlation::Correlation(const mesh::Mesh& surface, std::shared_ptr<const imaging::Camera> camera,
                         const imaging::BSpline& reference, const CorrelationOptions& options)
    : surface_(surface),
      camera_(std::move(camera)),
      dofs_(options.dofs_per_node),
      brightness_(options.brightness || options.local_brightness),
      local_brightness_(options.local_brightness),
      slope_noise_(options.slope_noise),
      low_pass_(options.low_pass) {
  const std::string& place = options.quadrature.place;
  if (surface_.type != mesh::CellType::quad4 || surface_.cells.cols() != 4 || surface_.cells.rows() == 0)
    throw InputError(place, "no quadrilaterals", "a surface mesh of 4-node quadrilaterals");
  if (dofs_ != 2 && dofs_ != 3) throw InputError(place, fmt::format("{} unknowns per node", dofs_), "2 or 3");
  positions_.resize(nodes(), 2);
  for (int node = 0; node < nodes(); ++node)
    positions_.row(node) = camera_->project(surface_.nodes.row(node).transpose()).transpose();
  quadrature_ = correlation::quadrature(surface_.cells, positions_, reference, options.quadrature);
  if (!camera_->affine()) correct_local_coordinates();
  if (low_pass_ > 0.0) reference_ = reference;
  const auto& f = quadrature_.f;
  if (!f.empty())
    mean_grey_ = static_cast<float>(std::accumulate(f.begin(), f.end(), 0.0) / static_cast<double>(f.size()));
  gram_.resize(static_cast<std::size_t>(elements()));
#pragma omp parallel for schedule(static)
  for (int e = 0; e < elements(); ++e) gram_[static_cast<std::size_t>(e)] = sum_gram(pixels_of(e));
  make_pattern();
}

Eigen::Matrix2d Correlation::pixels_per_length() const {
  return camera_->jacobian(surface_.nodes.colwise().mean().transpose()).leftCols<2>();
}

double Correlation::mean_square_gradient() const {
  double sum = 0.0;
  for (const Gram& gram : gram_)
    for (std::size_t pair = 0; pair < 10; ++pair) {
      // sum of N_i N_j over i, j is one
      const bool diagonal = pair == 0 || pair == 4 || pair == 7 || pair == 9;
      sum += (diagonal ? 0.5 : 1.0) * (gram[pair][0] + gram[pair][2]);
    }
  return sum / std::max(1.0, static_cast<double>(quadrature_.pixels()));
}

Eigen::Matrix<double, 4, 2> Correlation::of_element(const InImage& values, int element) const {
  Corners corners;
  for (int i = 0; i < 4; ++i) corners.row(i) = values.row(surface_.cells(element, i));
  return corners;
}

ElementPixels Correlation::pixels_of(int element) const {
  const PixelQuadrature& q = quadrature_;
  const std::size_t at = q.first[static_cast<std::size_t>(element)];
  return {.count = static_cast<int>(q.pixels_of(element)),
          .xi = q.xi.data() + at,
          .eta = q.eta.data() + at,
          .f = q.f.data() + at,
          .gx = q.fx.data() + at,
          .gy = q.fy.data() + at};
}

// Contiguous blocks of elements with about equal numbers of pixels.
std::pair<int, int> Correlation::share(const Communicator& group) const {
  const auto bound = [this, size = group.size()](int rank) {
    if (rank == size) return elements();
    const std::size_t pixels = quadrature_.pixels() * static_cast<std::size_t>(rank) / static_cast<std::size_t>(size);
    return static_cast<int>(std::lower_bound(quadrature_.first.begin(), quadrature_.first.end() - 1, pixels) -
                            quadrature_.first.begin());
  };
  return {bound(group.rank()), bound(group.rank() + 1)};
}

Eigen::Matrix<double, 5, 2> Correlation::inner_points(int element, const Eigen::VectorXd* U) const {
  Eigen::Matrix<double, 4, 3> corners;
  for (int i = 0; i < 4; ++i) {
    const int node = surface_.cells(element, i);
    corners.row(i) = U != nullptr ? Eigen::RowVector3d(displaced(node, *U).transpose())
                                  : Eigen::RowVector3d(surface_.nodes.row(node));
  }
  Eigen::Matrix<double, 5, 2> points;
  for (int k = 0; k < 5; ++k) {
    const Eigen::Vector4d N =
        0.25 * (1.0 + corner_xi.array() * Bulge::xi[k]) * (1.0 + corner_eta.array() * Bulge::eta[k]);
    points.row(k) = camera_->project(corners.transpose() * N).transpose();
  }
  return points;
}

namespace {
/// The bilinear interpolation of nodal values at the five places of a Bulge.
Eigen::Matrix<double, 5, 2> bilinear_inside(const Corners& nodal) {
  Eigen::Matrix<double, 5, 2> inside;
  for (int k = 0; k < 4; ++k) inside.row(k) = 0.5 * (nodal.row(k) + nodal.row((k + 1) % 4));
  inside.row(4) = nodal.colwise().mean();
  return inside;
}
}  // namespace

// The quadrature inverts the bilinear map of the projected nodes; two steps of fixed point lead to the local
// coordinates on the specimen, since the bulge is a small part of the element.
void Correlation::correct_local_coordinates() {
  inner_.resize(static_cast<std::size_t>(elements()));
  PixelQuadrature& q = quadrature_;
#pragma omp parallel for schedule(static)
  for (int e = 0; e < elements(); ++e) {
    const auto k = static_cast<std::size_t>(e);
    inner_[k] = inner_points(e, nullptr);
    const Corners corners = of_element(positions_, e);
    const Bulge bulge(inner_[k] - bilinear_inside(corners));
    const Eigen::Vector4f x = bilinear(corners.col(0)).cast<float>(), y = bilinear(corners.col(1)).cast<float>();
    for (std::size_t p = q.first[k]; p < q.first[k + 1]; ++p) {
      const float xi0 = q.xi[p], eta0 = q.eta[p];
      const float a = x[1] + x[3] * eta0, b = x[2] + x[3] * xi0, c = y[1] + y[3] * eta0, d = y[2] + y[3] * xi0;
      const float det = a * d - b * c;
      float xi = xi0, eta = eta0;
      for (int step = 0; step < 2; ++step) {
        const Eigen::Vector2f beyond = bulge.at(xi, eta);
        xi = xi0 - (d * beyond.x() - b * beyond.y()) / det;
        eta = eta0 - (a * beyond.y() - c * beyond.x()) / det;
      }
      q.xi[p] = xi, q.eta[p] = eta;
    }
  }
}

// The pattern of M and, for every block of the element matrices, its place among M's values.
void Correlation::make_pattern() {
  std::vector<std::vector<int>> neighbours(static_cast<std::size_t>(nodes()));
  for (int e = 0; e < elements(); ++e)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j)
        neighbours[static_cast<std::size_t>(surface_.cells(e, i))].push_back(surface_.cells(e, j));
  pattern_.resize(unknowns(), unknowns());
  Eigen::VectorXi entries(unknowns());
  for (int node = 0; node < nodes(); ++node) {
    auto& list = neighbours[static_cast<std::size_t>(node)];
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    for (int a = 0; a < dofs_; ++a) entries[node * dofs_ + a] = static_cast<int>(list.size()) * dofs_;
  }
  pattern_.reserve(entries);
  for (int node = 0; node < nodes(); ++node)
    for (int a = 0; a < dofs_; ++a)
      for (const int other : neighbours[static_cast<std::size_t>(node)])
        for (int c = 0; c < dofs_; ++c) pattern_.insert(other * dofs_ + c, node * dofs_ + a) = 0.0;
  pattern_.makeCompressed();
  slots_.reserve(static_cast<std::size_t>(elements() * 16));
  for (int k = 0; k < elements(); ++k)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) {  // first entry of the block (row node i, column node j), column component 0
        const int row = surface_.cells(k, i), column = surface_.cells(k, j);
        const auto& list = neighbours[static_cast<std::size_t>(column)];
        const auto rank = static_cast<int>(std::lower_bound(list.begin(), list.end(), row) - list.begin());
        slots_.push_back(pattern_.outerIndexPtr()[column * dofs_] + rank * dofs_);
      }
}

Eigen::Vector3d Correlation::displaced(int node, const Eigen::VectorXd& U) const {
  Eigen::Vector3d point(surface_.nodes(node, 0), surface_.nodes(node, 1), surface_.nodes(node, 2));
  for (int a = 0; a < dofs_; ++a) point[a] += U[static_cast<Eigen::Index>(node) * dofs_ + a];
  return point;
}

// Eq. (8): M = N^T grad F grad F^T N, from sums over the pixels that were made once.
Eigen::SparseMatrix<double> Correlation::M() const {
  return assemble(
      [](int, const std::array<double, 4>& sums) {
        return Eigen::Matrix2d{{sums[0], sums[1]}, {sums[1], sums[2]}};
      },
      nullptr);
}

// A transported gradient T grad F with one T an element turns each block S into T S T^T.
Eigen::SparseMatrix<double> Correlation::M(const Eigen::VectorXd& U, const Eigen::VectorXd& share) const {
  const std::vector<Eigen::Matrix2d> transport = transport_of(deformation_gradient(U));
  return assemble(
      [&transport, &share](int e, const std::array<double, 4>& sums) {
        const Eigen::Matrix2d& T = transport[static_cast<std::size_t>(e)];
        const Eigen::Matrix2d S{{sums[0], sums[1]}, {sums[1], sums[2]}};
        const Eigen::Matrix2d block = T * S * T.transpose();
        return share.size() > 0 ? Eigen::Matrix2d(share[e] * block) : block;
      },
      &U);
}

Eigen::MatrixXd Correlation::M_in_image(const Eigen::MatrixXd& motions) const {
  Eigen::MatrixXd forces = Eigen::MatrixXd::Zero(motions.rows(), motions.cols());
  for (int e = 0; e < elements(); ++e) {
    std::size_t pair = 0;
    for (int i = 0; i < 4; ++i)
      for (int j = i; j < 4; ++j, ++pair) {
        const auto& sums = gram_[static_cast<std::size_t>(e)][pair];
        const Eigen::Matrix2d M{{sums[0], sums[1]}, {sums[1], sums[2]}};
        const int row = 2 * surface_.cells(e, i), column = 2 * surface_.cells(e, j);
        forces.middleRows<2>(row) += M * motions.middleRows<2>(column);
        if (i != j) forces.middleRows<2>(column) += M * motions.middleRows<2>(row);
      }
  }
  return forces;
}

Eigen::MatrixXd Correlation::projected(const Eigen::MatrixXd& in_image, const Eigen::VectorXd* U) const {
  Eigen::MatrixXd forces(unknowns(), in_image.cols());
  for (int node = 0; node < nodes(); ++node) {
    const Eigen::Vector3d point =
        U != nullptr ? displaced(node, *U) : Eigen::Vector3d(surface_.nodes.row(node).transpose());
    forces.middleRows(node * dofs_, dofs_) =
        camera_->jacobian(point).leftCols(dofs_).transpose() * in_image.middleRows<2>(2 * node);
  }
  return forces;
}

Eigen::SparseMatrix<double> Correlation::gradient_noise() const {
  return assemble(
      [this](int, const std::array<double, 4>& sums) {
        return Eigen::Matrix2d(slope_noise_ * sums[3] * Eigen::Matrix2d::Identity());
      },
      nullptr);
}

Eigen::SparseMatrix<double> Correlation::assemble(const Block& block_of, const Eigen::VectorXd* U) const {
  Eigen::SparseMatrix<double> M = pattern_;
  double* const values = M.valuePtr();
  std::fill(values, values + M.nonZeros(), 0.0);
  for (int e = 0; e < elements(); ++e) {
    std::array<Eigen::Matrix<double, 2, 3>, 4> J;  // d(pixel)/d(displacement) at the nodes
    for (int i = 0; i < 4; ++i)
      J[static_cast<std::size_t>(i)] =
          camera_->jacobian(U != nullptr ? displaced(surface_.cells(e, i), *U)
                                         : Eigen::Vector3d(surface_.nodes.row(surface_.cells(e, i)).transpose()));
    const Gram& gram = gram_[static_cast<std::size_t>(e)];
    std::size_t pair = 0;
    for (int i = 0; i < 4; ++i)
      for (int j = i; j < 4; ++j, ++pair) {
        const Eigen::Matrix2d S = block_of(e, gram[pair]);
        const Eigen::Matrix3d block = J[static_cast<std::size_t>(i)].transpose() * S * J[static_cast<std::size_t>(j)];
        const auto add = [&](int row, int column, const Eigen::Matrix3d& entries) {
          int slot = slots_[static_cast<std::size_t>(e * 16 + row * 4 + column)];
          const int stride = M.outerIndexPtr()[surface_.cells(e, column) * dofs_ + 1] -
                             M.outerIndexPtr()[surface_.cells(e, column) * dofs_];
          for (int c = 0; c < dofs_; ++c, slot += stride)
            for (int a = 0; a < dofs_; ++a) values[slot + a] += entries(a, c);
        };
        add(i, j, block);
        if (i != j) add(j, i, block.transpose());
      }
  }
  return M;
}

InImage Correlation::pixel_displacement(const Eigen::VectorXd& U) const {
  if (U.size() != unknowns())
    throw InputError("displacement", fmt::format("{} values", U.size()),
                     fmt::format("{} ({} per node)", unknowns(), dofs_));
  InImage shift(nodes(), 2);
  for (int node = 0; node < nodes(); ++node)
    shift.row(node) = camera_->project(displaced(node, U)).transpose() - positions_.row(node);
  return shift;
}

std::vector<Eigen::Matrix2d> Correlation::deformation_gradient(const Eigen::VectorXd& U) const {
  const InImage shift = pixel_displacement(U);
  std::vector<Eigen::Matrix2d> F(static_cast<std::size_t>(elements()));
  const Corners slopes = central_slopes();
  for (int e = 0; e < elements(); ++e) {
    const Eigen::Matrix2d reference = of_element(positions_, e).transpose() * slopes;
    F[static_cast<std::size_t>(e)] =
        Eigen::Matrix2d::Identity() + of_element(shift, e).transpose() * slopes * reference.inverse();
  }
  return F;
}

std::vector<Eigen::Matrix2d> Correlation::smoothed_over(const std::vector<Eigen::Matrix2d>& F) const {
  if (!(low_pass_ > 0.0)) return {};
  std::vector<Eigen::Matrix2d> of_node(static_cast<std::size_t>(nodes()), Eigen::Matrix2d::Zero()), mean(F.size());
  Eigen::VectorXd count = Eigen::VectorXd::Zero(nodes());
  for (int e = 0; e < elements(); ++e)
    for (int i = 0; i < 4; ++i)
      of_node[static_cast<std::size_t>(surface_.cells(e, i))] += F[static_cast<std::size_t>(e)],
          count[surface_.cells(e, i)] += 1.0;
  for (int e = 0; e < elements(); ++e) {
    Eigen::Matrix2d sum = Eigen::Matrix2d::Zero();
    for (int i = 0; i < 4; ++i)
      sum += of_node[static_cast<std::size_t>(surface_.cells(e, i))] / count[surface_.cells(e, i)];
    mean[static_cast<std::size_t>(e)] = 0.25 * sum;
  }
  return mean;
}

const float* Correlation::smoothed_alike(int element, const std::vector<Eigen::Matrix2d>& F,
                                         std::vector<float>& levels) const {
  const ElementPixels pixels = pixels_of(element);
  if (F.empty()) return pixels.f;
  const Eigen::Matrix2d& own = F[static_cast<std::size_t>(element)];
  if (!(own.determinant() > 0.05)) return pixels.f;
  const Eigen::Matrix2d inverse = own.inverse();
  const Eigen::Matrix2f wider =
      (0.5 * low_pass_ * low_pass_ * (inverse * inverse.transpose() - Eigen::Matrix2d::Identity())).cast<float>();
  levels.resize(static_cast<std::size_t>(pixels.count + lanes - 1));
  float* at = levels.data();
  for (const PixelRow& run : quadrature_.rows_of(element)) {
    reference_.curvature_row(run.column, run.row, run.count, wider(0, 0), wider(0, 1), wider(1, 1), at);
    at += run.count;
  }
#pragma omp simd
  for (int i = 0; i < pixels.count; ++i) levels[static_cast<std::size_t>(i)] += pixels.f[i];
  return levels.data();
}

template <class Real>
void Correlation::interpolate(const imaging::BSpline& g, int element, const InImage& shift, const Eigen::VectorXd& U,
                              const InImage& own, bool slopes, Seen<Real>& seen) const {
  const ElementPixels pixels = pixels_of(element);
  Corners u = of_element(shift, element);
  const bool curved = !inner_.empty() && pixels.count > 0;
  Bulge bulge;
  if (curved) bulge = Bulge(inner_points(element, &U) - inner_[static_cast<std::size_t>(element)] - bilinear_inside(u));
  if (own.size() > 0) u += of_element(own, element);
  const Corners deformed = u + of_element(positions_, element);
  // The whole pixels of the displacement are taken out, so that single precision is enough for the rest.
  const int whole_x = static_cast<int>(std::floor(u.col(0).mean())),
            whole_y = static_cast<int>(std::floor(u.col(1).mean()));
  const auto padded = static_cast<std::size_t>(pixels.count + lanes - 1);
  seen.dx.resize(padded), seen.dy.resize(padded), seen.value.resize(padded);
  const auto map = [&](int component, int whole, std::vector<Real>& values) {
    const Eigen::Vector<Real, 4> flat = bilinear(u.col(component).array() - whole).template cast<Real>();
    const Eigen::Vector<Real, 5> beyond = bulge.coefficients.col(component).template cast<Real>();
    map_at(pixels, flat.data(), curved ? beyond.data() : nullptr, values.data());
  };
  map(0, whole_x, seen.dx), map(1, whole_y, seen.dy);
  // A pixel beyond an element's outline by rounding must not touch what lies outside: one pixel of margin.
  const double margin = 1.0 + (curved ? bulge.coefficients.cwiseAbs().sum() : 0.0);
  const bool inside = deformed.minCoeff() >= margin && deformed.col(0).maxCoeff() <= g.width() - 1 - margin &&
                      deformed.col(1).maxCoeff() <= g.height() - 1 - margin;
  std::size_t p = 0;
  if (inside && !slopes) {
    for (const PixelRow& run : quadrature_.rows_of(element)) {
      g.shifted_row(run.column + whole_x, run.row + whole_y, &seen.dx[p], &seen.dy[p], run.count, &seen.value[p]);
      p += static_cast<std::size_t>(run.count);
    }
    return;
  }
  if (slopes) seen.slope_x.resize(padded), seen.slope_y.resize(padded);
  for (const PixelRow& run : quadrature_.rows_of(element))
    for (int i = 0; i < run.count; ++i, ++p) {
      const double x = run.column + i + whole_x + static_cast<double>(seen.dx[p]),
                   y = run.row + whole_y + static_cast<double>(seen.dy[p]);
      seen.value[p] = g.contains(x, y) ? g.value<Real>(x, y) : Real(NAN);
      if (!slopes) continue;
      const Eigen::Vector2f slope = g.gradient(x, y);
      seen.slope_x[p] = slope.x(), seen.slope_y[p] = slope.y();
    }
}

template <class Real>
std::vector<ElementSums> Correlation::sums_of(int begin, int end, const imaging::BSpline& g, const InImage& shift,
                                              const Eigen::VectorXd& U, const InImage& own,
                                              const std::vector<Eigen::Matrix2d>& F, Gradient gradient) const {
  const bool own_slopes = gradient == Gradient::deformed;
  std::vector<ElementSums> sums(static_cast<std::size_t>(end - begin));
#pragma omp parallel
  {
    Seen<Real> seen;
    std::vector<float> levels;
#pragma omp for schedule(static)
    for (int e = begin; e < end; ++e) {
      interpolate(g, e, shift, U, own, own_slopes, seen);
      ElementPixels pixels = pixels_of(e);
      pixels.f = smoothed_alike(e, F, levels);
      if (own_slopes) pixels.gx = seen.slope_x.data(), pixels.gy = seen.slope_y.data();
      sums[static_cast<std::size_t>(e - begin)] = sum_pixels(pixels, seen.value.data(), mean_grey_, brightness_);
    }
  }
  return sums;
}

Evaluation Correlation::evaluate(const imaging::BSpline& g, const Eigen::VectorXd& U, const Communicator& group,
                                 Gradient gradient, Precision precision, const InImage& own) const {
  const PixelQuadrature& q = quadrature_;
  const InImage shift = pixel_displacement(U);
  const bool own_slopes = gradient == Gradient::deformed;
  const auto [begin, end] = share(group);
  std::vector<Eigen::Matrix2d> F;
  if (low_pass_ > 0.0 || gradient == Gradient::transported) F = deformation_gradient(U);
  const std::vector<Eigen::Matrix2d> lengths = smoothed_over(F);
  // Element sums. Grey levels are counted from the reference's mean, so that the moments keep their digits.
  const auto sums = precision == Precision::single ? sums_of<float>(begin, end, g, shift, U, own, lengths, gradient)
                                                   : sums_of<double>(begin, end, g, shift, U, own, lengths, gradient);
  const float grey0 = mean_grey_;

  // Light and correlation coefficient from the moments of all pixels.
  Evaluation result;
  std::array<double, 7> all{};
  for (int e = begin; e < end; ++e) {
    const ElementSums& sum = sums[static_cast<std::size_t>(e - begin)];
    const double dropped = static_cast<double>(q.pixels_of(e)) - sum.seen;
    const std::array<double, 7> part{sum.f, sum.g, sum.fg, sum.gg, sum.seen, dropped, sum.squares};
    for (std::size_t i = 0; i < all.size(); ++i) all[i] += part[i];
  }
  if (group.size() > 1) group.sum(all);
  const double n = std::max(1.0, all[4]), covariance = all[2] - all[0] * all[1] / n;
  const double variance_g = all[3] - all[1] * all[1] / n;
  // sum of f^2 = sum of (f - g)^2 + 2 f g - g^2
  const double variance_f = all[6] + 2.0 * all[2] - all[3] - all[0] * all[0] / n;
  result.pixels = all[4];
  result.dropped = all[5];
  if (variance_f > 0.0 && variance_g > 0.0) result.coefficient = covariance / std::sqrt(variance_f * variance_g);
  double gain = 1.0, offset = 0.0;  // of grey levels counted from the mean
  if (brightness_ && variance_g > 1e-9 * all[3] && variance_f > 0.0) {
    // Not covariance/variance_g, the least squares of f on g: noise of g makes that too small, and what it leaves of
    // the speckle in the residual is taken for motion.
    gain = std::sqrt(variance_f / variance_g);
    offset = (all[0] - gain * all[1]) / n;
  }
  result.gain = gain;
  result.offset = offset + static_cast<double>(grey0) * (1.0 - gain);
  // The same of an element alone, if it is asked for: with few pixels the offset only, the gain of all.
  struct Light {
    double gain, offset, variance_f;
  };
  const auto light_of = [&](const ElementSums& sum) {
    const double pixels = std::max(1.0, sum.seen);
    const double of_g = sum.gg - sum.g * sum.g / pixels;
    const double of_f = sum.squares + 2.0 * sum.fg - sum.gg - sum.f * sum.f / pixels;
    Light light{gain, offset, of_f};
    if (!local_brightness_ || pixels < 4.0) return light;
    if (pixels >= 64.0 && of_g > 1e-9 * sum.gg && of_f > 0.0) light.gain = std::sqrt(of_f / of_g);
    light.offset = (sum.f - light.gain * sum.g) / pixels;
    return light;
  };

  std::vector<Eigen::Matrix2d> transport;
  if (gradient == Gradient::transported) transport = transport_of(F);
  // One message for everything: b in the image, squares and pixels of the elements.
  const int in_image = 2 * nodes();
  std::vector<double> message(static_cast<std::size_t>(in_image + 4 * elements()) + 1, 0.0);
  for (int e = begin; e < end; ++e) {
    const auto& sum = sums[static_cast<std::size_t>(e - begin)];
    const Light light = light_of(sum);
    const double d = 1.0 - light.gain;  // f - gain g - offset = (f - g) + (1 - gain) g - offset
    for (int i = 0; i < 4; ++i) {
      Eigen::Vector2d part = (sum.r.row(i) + d * sum.b.row(i) - light.offset * sum.one.row(i)).transpose();
      if (own_slopes) part *= light.gain;
      if (!transport.empty()) part = (transport[static_cast<std::size_t>(e)] * part).eval();
      for (int a = 0; a < 2; ++a) message[static_cast<std::size_t>(2 * surface_.cells(e, i) + a)] += part[a];
    }
    const double squares = sum.squares + d * d * sum.gg + light.offset * light.offset * sum.seen +
                           2.0 * d * (sum.fg - sum.gg) - 2.0 * light.offset * (sum.f - sum.g) -
                           2.0 * d * light.offset * sum.g;
    message[static_cast<std::size_t>(in_image + e)] = std::max(0.0, squares);
    message[static_cast<std::size_t>(in_image + elements() + e)] = sum.seen;
    message[static_cast<std::size_t>(in_image + 2 * elements() + e)] = light.gain;
    message[static_cast<std::size_t>(in_image + 3 * elements() + e)] = light.offset + static_cast<double>(grey0) * d;
    message.back() += light.variance_f;
  }
  if (group.size() > 1) group.sum(message);
  result.in_image = Eigen::Map<InImage>(message.data(), nodes(), 2);
  result.b = projected(result.in_image.reshaped<Eigen::RowMajor>(), &U);
  result.element_squares = Eigen::Map<Eigen::VectorXd>(message.data() + in_image, elements());
  result.element_pixels = Eigen::Map<Eigen::VectorXd>(message.data() + in_image + elements(), elements());
  result.element_rms = (result.element_squares.array() / result.element_pixels.array().max(1.0)).sqrt();
  result.squares = in_order(result.element_squares);
  result.element_gain = Eigen::Map<Eigen::VectorXd>(message.data() + in_image + 2 * elements(), elements());
  result.element_offset = Eigen::Map<Eigen::VectorXd>(message.data() + in_image + 3 * elements(), elements());
  // With each element's light taken out, what the images have in common is their detail.
  if (local_brightness_ && message.back() > 0.0) result.coefficient = 1.0 - 0.5 * result.squares / message.back();
  return result;
}

std::vector<float> Correlation::residual(const imaging::BSpline& g, const Eigen::VectorXd& U,
                                         const InImage& own) const {
  Evaluation seen;
  if (brightness_) seen = evaluate(g, U, Communicator{MPI_COMM_SELF}, Gradient::reference, Precision::single, own);
  const InImage shift = pixel_displacement(U);
  const std::vector<Eigen::Matrix2d> lengths =
      low_pass_ > 0.0 ? smoothed_over(deformation_gradient(U)) : std::vector<Eigen::Matrix2d>{};
  std::vector<float> residual(quadrature_.pixels());
#pragma omp parallel
  {
    Seen<float> here;
    std::vector<float> levels;
#pragma omp for schedule(static)
    for (int e = 0; e < elements(); ++e) {
      const float gain = brightness_ ? static_cast<float>(seen.element_gain[e]) : 1.0F;
      const float offset = brightness_ ? static_cast<float>(seen.element_offset[e]) : 0.0F;
      interpolate(g, e, shift, U, own, false, here);
      const std::size_t first = quadrature_.first[static_cast<std::size_t>(e)];
      const float* const f = smoothed_alike(e, lengths, levels);
      for (std::size_t p = 0; p < quadrature_.pixels_of(e); ++p)
        residual[first + p] = f[p] - (gain * here.value[p] + offset);
    }
  }
  return residual;
}

}  // namespace imic3d::correlation
