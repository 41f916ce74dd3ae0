#include "imic3d/loop/light_statistics.hpp"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "imic3d/core/linear.hpp"
#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/low_pass.hpp"

namespace imic3d::loop {

namespace {

constexpr int basis = 6;

/// One direction of the response to a bright pixel, smoothed by `width` and interpolated: h(shift).
class Response {
 public:
  explicit Response(double width) : middle_(20 + static_cast<int>(std::ceil(5.0 * width))) {
    imaging::Image impulse(2 * middle_ + 1, 2 * middle_ + 1);
    impulse(middle_, middle_) = 1.0F;
    spline_ = imaging::BSpline(imaging::low_pass(impulse, width));
    scale_ = 1.0 / std::sqrt(static_cast<double>(spline_.value(middle_, middle_)));
  }
  [[nodiscard]] int reach() const { return middle_ - 1; }
  /// h(k + shift) for k = -reach ... reach.
  [[nodiscard]] Eigen::VectorXd operator()(double shift) const {
    Eigen::VectorXd h(2 * reach() + 1);
    for (int k = -reach(); k <= reach(); ++k)
      h[k + reach()] = scale_ * static_cast<double>(spline_.value(middle_ + k + shift, middle_));
    return h;
  }

 private:
  int middle_;
  imaging::BSpline spline_;
  double scale_ = 1.0;
};

/// Covariance at all shifts.
Eigen::VectorXd correlated(const Eigen::VectorXd& h) {
  const Eigen::Index n = h.size();
  Eigen::VectorXd all(2 * n - 1);
  for (Eigen::Index k = 1 - n; k < n; ++k) {
    const Eigen::Index overlap = n - std::abs(k);
    all[k + n - 1] =
        h.segment(std::max<Eigen::Index>(0, -k), overlap).dot(h.segment(std::max<Eigen::Index>(0, k), overlap));
  }
  return all;
}

Eigen::VectorXd convolved(const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  Eigen::VectorXd all = Eigen::VectorXd::Zero(a.size() + b.size() - 1);
  for (Eigen::Index i = 0; i < a.size(); ++i) all.segment(i, b.size()) += a[i] * b;
  return all;
}

Eigen::Vector4d shape_functions(double xi, double eta) {
  return 0.25 * Eigen::Vector4d((1 - xi) * (1 - eta), (1 + xi) * (1 - eta), (1 + xi) * (1 + eta), (1 - xi) * (1 + eta));
}

}  // namespace

Eigen::MatrixXd LightOptics::offset_and_gain() const {
  Eigen::MatrixXd light = Eigen::MatrixXd::Zero(basis * cells(), 2);
  for (Eigen::Index c = 0; c < cells(); ++c)
    light(basis * c, 0) = 1.0, light(basis * c, 1) = mean[c], light(basis * c + 1, 1) = 1.0;
  return light;
}

LightStatistics::LightStatistics(const correlation::GlobalDic& dic, int camera, int references, double noise,
                                 const Scene& scene)
    : dic_(&dic), camera_(camera), middle_(scene.middle()) {
  optics_.noise = noise, optics_.references = references;
  optics_.local = dic.options().local_brightness,
  optics_.gain_and_offset_fitted = dic.options().brightness || optics_.local;
  make_cells(scene);
  make_noise();
}

std::vector<LightStatistics> LightStatistics::of_face(const correlation::GlobalDic& dic,
                                                      const std::vector<correlation::View>& views, int references,
                                                      const std::vector<double>& noise, const Scene& scene) {
  Eigen::SparseMatrix<double> M = dic.cameras().M();
  if (const auto held = dic.held(); held.size() > 0) M += held;
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(M);
  std::vector<LightStatistics> all;
  std::vector<Moments> moments;
  std::vector<Eigen::MatrixXd> motions;
  for (std::size_t c = 0; c < views.size(); ++c) {
    all.push_back(LightStatistics(dic, static_cast<int>(c), references, noise[c], scene));
    moments.push_back(all.back().moments());
    motions.emplace_back(dic.cameras().weight(static_cast<int>(c)) * Eigen::MatrixXd(factor.solve(moments.back().b)));
  }
  for (std::size_t c = 0; c < views.size(); ++c) all[c].find_marks(moments[c], motions, views[c].reference, scene);
  return all;
}

void LightStatistics::find_marks(const Moments& of_this, const std::vector<Eigen::MatrixXd>& motions,
                                 const imaging::Image& reference, const Scene& scene) {
  // The linear numbers' weights A = B S.
  const auto cells = optics_.cells(), mine = basis * cells;
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(mine, 2 * cells + 2);
  for (Eigen::Index c = 0; c < cells; ++c) {
    S(basis * c, 2 * c) = S(basis * c + 1, 2 * c + 1) = 1.0;
    for (int k = 0; k < 2; ++k)
      S(basis * c, 2 * cells + k) = optics_.middle[static_cast<std::size_t>(c)][k] - scene.middle()[k],
                               S(basis * c + 2 + k, 2 * cells + k) = 1.0;
  }
  Eigen::MatrixXd motion(of_this.b.rows(), 0);  // of the light of all
  for (std::size_t k = 0; k < motions.size(); ++k) {
    if (static_cast<int>(k) == camera_) optics_.own = motion.cols();
    motion.conservativeResize(Eigen::NoChange, motion.cols() + motions[k].cols());
    motion.rightCols(motions[k].cols()) = motions[k];
  }
  Eigen::MatrixXd left = -of_this.b.transpose() * motion;
  for (Eigen::Index c = 0; c < cells; ++c)
    left.block<basis, basis>(basis * c, optics_.own + basis * c) += of_this.inner[static_cast<std::size_t>(c)];
  optics_.R = S.transpose() * left;
  optics_.G = covariance(S, motion.middleCols(optics_.own, mine) * S, reference.width, reference.height);
  for (Eigen::Index c = 0; c < cells; ++c) {
    const auto& inner = of_this.inner[static_cast<std::size_t>(c)];
    const Eigen::Index own = optics_.own + basis * c;
    Eigen::MatrixXd E = motion.transpose() * (of_this.M[static_cast<std::size_t>(c)] * motion);
    const Eigen::MatrixXd across = of_this.b.middleCols(basis * c, basis).transpose() * motion;
    E.middleRows(own, basis) -= across, E.middleCols(own, basis) -= across.transpose();
    E.block<basis, basis>(own, own) += inner;
    E -= optics_.R.row(2 * c).transpose() * optics_.R.row(2 * c) / inner(0, 0) +
         optics_.R.row(2 * c + 1).transpose() * optics_.R.row(2 * c + 1) / inner(1, 1);
    optics_.E.emplace_back(E / optics_.pixels[c]);
  }
  optics_.beside_fitted = Eigen::MatrixXd::Identity(mine, mine);
  if (optics_.local)
    optics_.beside_fitted.setZero();
  else if (optics_.gain_and_offset_fitted) {
    const Eigen::MatrixXd fitted = optics_.offset_and_gain();
    Eigen::MatrixXd weighted(mine, 2);
    for (Eigen::Index c = 0; c < cells; ++c)
      weighted.middleRows<basis>(basis * c) =
          of_this.inner[static_cast<std::size_t>(c)] * fitted.middleRows<basis>(basis * c);
    optics_.beside_fitted -= fitted * (weighted.transpose() * fitted).inverse() * weighted.transpose();
  }
  const auto& cameras = dic_->cameras();
  const double unknowns = static_cast<double>(cameras.unknowns()) / cameras.size();
  optics_.absorbed =
      std::min(0.5, std::pow(dic_->motion_noise(camera_), 2) * unknowns / (optics_.level * optics_.pixels.sum()));
}

void LightStatistics::make_cells(const Scene& scene) {
  const auto& surface = dic_->cameras().surface();
  const auto& q = dic_->correlation(camera_).quadrature();
  const Places places(scene);
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i)
    jacobian_.emplace_back(dic_->correlation(camera_).camera().jacobian(surface.nodes.row(i).transpose()));
  in_plane_.resize(2 * surface.nodes.rows());
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i)
    in_plane_.segment<2>(2 * i) = surface.nodes.row(i).head<2>().transpose();
  const auto place_of = [&](Eigen::Index e) {
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    for (int i = 0; i < 4; ++i) centre += 0.25 * in_plane_.segment<2>(2 * surface.cells(e, i));
    return places.of(centre);
  };
  std::vector<double> pixels(static_cast<std::size_t>(places.count()), 0.0);
  for (int e = 0; e < q.elements(); ++e)
    pixels[static_cast<std::size_t>(place_of(e))] += static_cast<double>(q.pixels_of(e));
  constexpr double least = 200.0;  // pixels of a cell
  std::vector<int> cell_of(pixels.size(), -1);
  for (std::size_t k = 0; k < pixels.size(); ++k)
    if (pixels[k] >= least)
      cell_of[k] = static_cast<int>(optics_.places.size()), optics_.places.push_back(static_cast<int>(k)),
      optics_.middle.push_back(places.middle(static_cast<int>(k)));
  optics_.size = places.size;
  const auto cells = static_cast<Eigen::Index>(optics_.places.size());
  optics_.pixels.setZero(cells), optics_.mean.setZero(cells), optics_.variance.setZero(cells);
  for (int e = 0; e < q.elements(); ++e) {
    cell_.push_back(cell_of[static_cast<std::size_t>(place_of(e))]);
    if (cell_.back() < 0) continue;
    for (std::size_t p = q.first[static_cast<std::size_t>(e)]; p < q.first[static_cast<std::size_t>(e) + 1]; ++p)
      optics_.pixels[cell_.back()] += 1.0, optics_.mean[cell_.back()] += q.f[p],
          optics_.variance[cell_.back()] += static_cast<double>(q.f[p]) * q.f[p];
  }
  optics_.mean = optics_.mean.cwiseQuotient(optics_.pixels);
  optics_.variance = optics_.variance.cwiseQuotient(optics_.pixels) - optics_.mean.cwiseAbs2();
}

/// Noise is white in an image, smoothed and interpolated in r: f has it at whole pixels, g at fractions of one.
void LightStatistics::make_noise() {
  const Response smooth(dic_->options().low_pass), plain(0.0);
  const Eigen::VectorXd at_pixel = smooth(0.0), of_reference = correlated(at_pixel);
  variance_.resize(table + 1), again_.resize(table + 1), across_.resize(table + 1),
      squared_.resize(table + 1, table + 1);
  std::vector<Eigen::VectorXd> covariance;
  for (int i = 0; i <= table; ++i) {
    const double shift = static_cast<double>(i) / table;
    const Eigen::VectorXd h = smooth(shift), twice = convolved(h, plain(-shift));
    variance_[i] = h.squaredNorm();
    again_[i] = twice.squaredNorm();
    across_[i] = twice.segment(plain.reach(), h.size()).dot(at_pixel);
    covariance.push_back(correlated(h));
  }
  const double share = 1.0 / optics_.references;
  const double a2 = of_reference.squaredNorm();
  double way = 0.0;
  for (Eigen::Index k = 0; k < of_reference.size(); ++k)
    way += std::abs(static_cast<double>(k - of_reference.size() / 2)) * std::pow(of_reference[k], 2);
  reach_ = way / a2;
  for (int i = 0; i <= table; ++i)
    for (int j = 0; j <= table; ++j) {
      const auto &x = covariance[static_cast<std::size_t>(i)], &y = covariance[static_cast<std::size_t>(j)];
      squared_(i, j) = share * share * a2 * a2 + 2.0 * share * of_reference.dot(x) * of_reference.dot(y) +
                       x.squaredNorm() * y.squaredNorm();
    }
  optics_.level = std::pow(at_pixel.squaredNorm(), 2);
  optics_.shared = 2.0 * share * share * a2 * a2;
}

/// Of unit noise that is smoothed: the Gram matrix of the smoothed weights A - grad F N M^-1 b_A, in strips of the
/// image.
Eigen::MatrixXd LightStatistics::covariance(const Eigen::MatrixXd& S, const Eigen::MatrixXd& motion, int width,
                                            int height) const {
  const auto& correlation = dic_->correlation(camera_);
  const auto& q = correlation.quadrature();
  const auto& surface = correlation.surface();
  const int dofs = correlation.dofs_per_node();
  const auto numbers = S.cols();
  const double smoothing = dic_->options().low_pass;
  const int strip = 128, margin = static_cast<int>(std::ceil(5.0 * smoothing)) + 1;
  std::vector<std::vector<std::array<int, 4>>> runs(static_cast<std::size_t>(
      height / strip + 1));  // of each strip with its margins: element, first pixel, row of pixels
  for (int e = 0; e < q.elements(); ++e) {
    auto p = static_cast<int>(q.first[static_cast<std::size_t>(e)]);
    for (const auto& row : q.rows_of(e)) {
      for (int k = std::max(0, row.row - margin) / strip; k <= std::min(height - 1, row.row + margin) / strip; ++k)
        runs[static_cast<std::size_t>(k)].push_back({e, p, row.column + width * row.row, row.count});
      p += row.count;
    }
  }
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(numbers, numbers);
  for (std::size_t k = 0; k < runs.size(); ++k) {
    if (runs[k].empty()) continue;
    const int top = static_cast<int>(k) * strip - margin, rows = strip + 2 * margin;
    std::vector<imaging::Image> weights(static_cast<std::size_t>(numbers), imaging::Image(width, rows));
    for (const auto& [e, first, start, pixels] : runs[k]) {
      const int c = cell_[static_cast<std::size_t>(e)];
      Eigen::MatrixXd D(4 * dofs, numbers);
      for (int i = 0; i < 4; ++i) D.middleRows(dofs * i, dofs) = motion.middleRows(dofs * surface.cells(e, i), dofs);
      for (int i = 0; i < pixels; ++i) {
        const auto p = static_cast<std::size_t>(first + i);
        Eigen::VectorXd a = -D.transpose() * slope(e, p);
        if (c >= 0) a += S.middleRows(basis * c, basis).transpose() * basis_at(e, p);
        for (Eigen::Index j = 0; j < numbers; ++j)
          weights[static_cast<std::size_t>(j)](start % width + i, start / width - top) = static_cast<float>(a[j]);
      }
    }
    Eigen::MatrixXf smoothed(static_cast<Eigen::Index>(strip) * width, numbers);
    for (Eigen::Index j = 0; j < numbers; ++j) {
      const auto one = imaging::low_pass(weights[static_cast<std::size_t>(j)], smoothing);
      smoothed.col(j) = Eigen::Map<const Eigen::VectorXf>(one.grey.data() + static_cast<std::ptrdiff_t>(margin) * width,
                                                          smoothed.rows());
    }
    G += (smoothed.transpose() * smoothed).cast<double>();
  }
  return G;
}

/// d(grey level)/d(displacement of the element's nodes) at a pixel.
Eigen::VectorXd LightStatistics::slope(int e, std::size_t p) const {
  const auto& correlation = dic_->correlation(camera_);
  const auto& q = correlation.quadrature();
  const int dofs = correlation.dofs_per_node();
  const Eigen::Vector4d N = shape_functions(q.xi[p], q.eta[p]);
  Eigen::VectorXd all(4 * dofs);
  for (int i = 0; i < 4; ++i) {
    const auto& J = jacobian_[static_cast<std::size_t>(correlation.surface().cells(e, i))];
    for (int a = 0; a < dofs; ++a)
      all[dofs * i + a] = N[i] * (static_cast<double>(q.fx[p]) * J(0, a) + static_cast<double>(q.fy[p]) * J(1, a));
  }
  return all;
}

/// The basis B at a pixel of a cell.
Eigen::Vector<double, 6> LightStatistics::basis_at(int e, std::size_t p) const {
  const auto& q = dic_->correlation(camera_).quadrature();
  const auto c = cell_[static_cast<std::size_t>(e)];
  const Eigen::Vector4d N = shape_functions(q.xi[p], q.eta[p]);
  Eigen::Vector2d at = -optics_.middle[static_cast<std::size_t>(c)];
  for (int i = 0; i < 4; ++i) at += N[i] * in_plane_.segment<2>(2 * dic_->cameras().surface().cells(e, i));
  const double grey = q.f[p] - optics_.mean[c];
  Eigen::Vector<double, basis> B;
  B << 1.0, grey, at[0], at[1], grey * at[0], grey * at[1];
  return B;
}

LightStatistics::Moments LightStatistics::moments() const {
  const auto& correlation = dic_->correlation(camera_);
  const auto& q = correlation.quadrature();
  const auto& surface = correlation.surface();
  const int dofs = correlation.dofs_per_node(), own = 4 * dofs;
  const auto cells = optics_.cells();
  Moments result;
  result.inner.assign(static_cast<std::size_t>(cells), Eigen::Matrix<double, basis, basis>::Zero());
  result.b.setZero(correlation.unknowns(), basis * cells);
  std::vector<std::vector<Eigen::Triplet<double>>> entries(static_cast<std::size_t>(cells) + 1);
  for (int e = 0; e < q.elements(); ++e) {
    const int c = cell_[static_cast<std::size_t>(e)];
    Eigen::MatrixXd K = Eigen::MatrixXd::Zero(own, own), b = Eigen::MatrixXd::Zero(own, basis);
    for (std::size_t p = q.first[static_cast<std::size_t>(e)]; p < q.first[static_cast<std::size_t>(e) + 1]; ++p) {
      const Eigen::VectorXd of_motion = slope(e, p);
      K.noalias() += of_motion * of_motion.transpose();
      if (c < 0) continue;
      const Eigen::Vector<double, basis> B = basis_at(e, p);
      result.inner[static_cast<std::size_t>(c)].noalias() += B * B.transpose();
      b.noalias() += of_motion * B.transpose();
    }
    for (int i = 0; i < own; ++i) {
      const int row = surface.cells(e, i / dofs) * dofs + i % dofs;
      if (c >= 0) result.b.row(row).segment(basis * c, basis) += b.row(i);
      for (int j = 0; j < own; ++j)
        entries[static_cast<std::size_t>(c >= 0 ? c : static_cast<int>(cells))].emplace_back(
            row, surface.cells(e, j / dofs) * dofs + j % dofs, K(i, j));
    }
  }
  for (const auto& part : entries)
    result.M.emplace_back(correlation.unknowns(), correlation.unknowns()).setFromTriplets(part.begin(), part.end());
  return result;
}

/// Noise spreads whatever levels a specimen has, and the largest have the fewest pixels. Where they pile up at the
/// largest instead, the record was cut there: at the end of a camera's range of any number of bits, or by what was done
/// to the images. Noise far below the step between levels spreads nothing, and tells nothing.
float LightStatistics::largest_grey(const imaging::Image& image) const {
  std::vector<double> pixels(static_cast<std::size_t>(image.dynamic()) + 1, 0.0);  // of each level
  for (const float grey : image.grey)
    pixels[static_cast<std::size_t>(std::lround(std::clamp(grey, 0.0F, image.dynamic())))] += 1.0;
  const auto next = [&](std::size_t below) {
    while (below > 0 && pixels[below - 1] == 0.0) --below;
    return below > 0 ? below - 1 : 0;
  };
  const std::size_t most = next(pixels.size()), step = most - next(most);
  const auto reach = std::max(2 * step, static_cast<std::size_t>(2.0 * optics_.noise));
  const double beneath = *std::max_element(pixels.begin() + static_cast<std::ptrdiff_t>(most - std::min(most, reach)),
                                           pixels.begin() + static_cast<std::ptrdiff_t>(most));
  const bool cut =
      optics_.noise > 0.25 * static_cast<double>(step) && pixels[most] > 3.0 * beneath + 5.0 * std::sqrt(beneath);
  return cut ? static_cast<float>(most) : image.dynamic();
}

LightFrame LightStatistics::frame(const imaging::Image& image, const Eigen::VectorXd& U,
                                  const correlation::InImage& off_epipolar) const {
  const auto& correlation = dic_->correlation(camera_);
  const auto& q = correlation.quadrature();
  const auto& surface = correlation.surface();
  const int dofs = correlation.dofs_per_node();
  const imaging::BSpline spline = dic_->spline(image);
  const std::vector<float> r = correlation.residual(spline, U, off_epipolar);
  Eigen::VectorXd gain = Eigen::VectorXd::Ones(correlation.elements());
  if (optics_.gain_and_offset_fitted)
    gain = correlation
               .evaluate(spline, U, Communicator{MPI_COMM_SELF}, correlation::Gradient::reference,
                         correlation::Precision::single, off_epipolar)
               .element_gain;
  const auto shift = correlation.pixel_displacement(U);
  const float limit = largest_grey(image);
  const auto cells = optics_.cells();
  LightFrame result;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(cells);
  Eigen::VectorXd n = zero, sum_f = zero, sum_ff = zero, fourth = zero;
  result.linear.setZero(2 * cells + 2);
  result.squares = result.frame_noise = result.spread = result.echo = result.echo_linear = result.aliasing = zero;
  result.motion.assign(static_cast<std::size_t>(cells), Eigen::Vector2d::Zero());
  const double one = std::pow(variance_[0], 2);
  for (int e = 0; e < q.elements(); ++e) {
    const int c = cell_[static_cast<std::size_t>(e)];
    if (c < 0) continue;
    Eigen::Matrix<double, 2, 4> X, pixels, moved;
    for (int i = 0; i < 4; ++i) {
      const int node = surface.cells(e, i);
      X.col(i) = in_plane_.segment<2>(2 * node), moved.col(i) = U.segment<2>(dofs * node),
      pixels.col(i) = shift.row(node).transpose();
    }
    std::size_t p = q.first[static_cast<std::size_t>(e)];
    for (const auto& row : q.rows_of(e))
      for (int i = 0; i < row.count; ++i, ++p) {
        if (!std::isfinite(r[p])) continue;
        const Eigen::Vector4d N = shape_functions(q.xi[p], q.eta[p]);
        const Eigen::Vector2d d = pixels * N, at = X * N - middle_;
        const double grey = r[p], f = q.f[p] - optics_.mean[c];
        n[c] += 1.0, sum_f[c] += f, sum_ff[c] += f * f;
        result.linear[2 * c] += grey, result.linear[2 * c + 1] += f * grey;
        result.linear.tail<2>() += grey * at;
        result.squares[c] += grey * grey, fourth[c] += grey * grey * grey * grey;
        const int x = static_cast<int>(std::lround((d[0] - std::floor(d[0])) * table)),
                  y = static_cast<int>(std::lround((d[1] - std::floor(d[1])) * table));
        result.frame_noise[c] += gain[e] * gain[e] * variance_[x] * variance_[y];
        result.spread[c] += squared_(x, y);
        result.echo[c] += one - 2.0 * across_[x] * across_[y] + again_[x] * again_[y];
        result.echo_linear[c] += one - across_[x] * across_[y];
        result.aliasing[c] += 2.0 - std::cos(2.0 * M_PI * d[0]) - std::cos(2.0 * M_PI * d[1]);
        result.motion[static_cast<std::size_t>(c)] += moved * N;
        const int column = std::clamp(row.column + i + static_cast<int>(std::lround(d[0])), 0, image.width - 1);
        const int line = std::clamp(row.row + static_cast<int>(std::lround(d[1])), 0, image.height - 1);
        if (image(column, line) >= limit) result.saturated += 1.0;
      }
  }
  result.pixels = n.sum();
  n = n.cwiseMax(1.0);
  for (auto* mean : {&result.frame_noise, &result.echo, &result.aliasing}) *mean = mean->cwiseQuotient(n);
  // A pixel at a cell's edge has fewer neighbours: of a square all but (1 - reach/side)^2.
  result.spread = 2.0 * result.spread.array() / n.array().square() * (1.0 - reach_ / n.array().sqrt()).square();
  result.kurtosis = zero;
  for (Eigen::Index c = 0; c < cells; ++c) {
    result.motion[static_cast<std::size_t>(c)] /= n[c];
    const double mean_square = result.squares[c] / n[c];
    result.kurtosis[c] = fourth[c] / n[c] / std::max(1e-300, mean_square * mean_square);
    const double sum = result.linear[2 * c], with_f = result.linear[2 * c + 1] - sum_f[c] * sum / n[c],
                 of_f = sum_ff[c] - sum_f[c] * sum_f[c] / n[c];
    result.squares[c] = (result.squares[c] - sum * sum / n[c] - with_f * with_f / std::max(1e-300, of_f)) / n[c];
    // As if no pixel had left the image.
    result.linear.segment<2>(2 * c) *= optics_.pixels[c] / n[c], result.echo_linear[c] *= optics_.pixels[c] / n[c];
  }
  return result;
}

}  // namespace imic3d::loop
