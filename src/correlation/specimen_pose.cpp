#include "imic3d/correlation/specimen_pose.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "bilinear.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/patch_match.hpp"
#include "imic3d/imaging/pyramid.hpp"

namespace imic3d::correlation {
namespace {

using imaging::BSpline;
using imaging::PinholeCamera;
using imaging::Pose;
using Six = Eigen::Matrix<double, 6, 1>;

const char* const place = "specimen.place";

Eigen::Matrix3d turn(const Eigen::Vector3d& r) {
  return r.norm() > 0.0 ? Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix()
                        : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
}

Eigen::Matrix3d cross(const Eigen::Vector3d& v) {
  return Eigen::Matrix3d{{0.0, -v[2], v[1]}, {v[2], 0.0, -v[0]}, {-v[1], v[0], 0.0}};
}

PinholeCamera seen_from(const PinholeCamera& camera, const Pose& pose) {
  return {camera.intrinsics(), camera.pose() * pose};
}

/// The specimen moved by (rotation vector, translation) in its own frame.
Pose moved(const Pose& pose, const Six& d) { return pose * Pose{turn(d.head<3>()), d.tail<3>()}; }

/// d(pixel)/d(movement) of the specimen's point X.
Eigen::Matrix<double, 2, 6> of_movement(const Eigen::Matrix<double, 2, 3>& J, const Eigen::Vector3d& X) {
  Eigen::Matrix<double, 2, 6> slope;
  slope << -J * cross(X), J;
  return slope;
}

double points_rms(const PinholeCamera& camera, const Pose& pose, std::span<const PlacedPoint> points) {
  double squares = 0.0;
  const PinholeCamera eye = seen_from(camera, pose);
  for (const PlacedPoint& p : points)
    squares += (eye.project({p.x, p.y, 0.0}) - Eigen::Vector2d(p.column, p.row)).squaredNorm();
  return std::sqrt(squares / static_cast<double>(points.size()));
}

/// Gauss-Newton on the points along the `free` movements [6 x k].
Pose fit_points(const PinholeCamera& camera, Pose pose, std::span<const PlacedPoint> points,
                const Eigen::MatrixXd& free) {
  for (int iteration = 0; iteration < 30; ++iteration) {
    Eigen::Matrix<double, 6, 6> H = Eigen::Matrix<double, 6, 6>::Zero();
    Six b = Six::Zero();
    const PinholeCamera eye = seen_from(camera, pose);
    for (const PlacedPoint& p : points) {
      const Eigen::Vector3d X(p.x, p.y, 0.0);
      const auto slope = of_movement(eye.jacobian(X), X);
      H += slope.transpose() * slope;
      b += slope.transpose() * (Eigen::Vector2d(p.column, p.row) - eye.project(X));
    }
    const Eigen::VectorXd step = solve_symmetric(free.transpose() * H * free, free.transpose() * b);
    if (!step.allFinite()) break;
    const Six d = free * step;
    pose = moved(pose, d);
    if (d.head<3>().norm() < 1e-12 && d.tail<3>().norm() < 1e-10 * pose.translation.norm()) break;
  }
  return pose;
}

/// Movements in the specimen's plane and, with `depth`, through it.
Eigen::MatrixXd in_plane_movements(bool depth) {
  Eigen::MatrixXd free = Eigen::MatrixXd::Zero(6, depth ? 4 : 3);
  free(2, 0) = free(3, 1) = free(4, 2) = 1.0;
  if (depth) free(5, 3) = 1.0;
  return free;
}

/// Parallel to the mean of the sensors, as large as the points say.
Pose pose_from_points(std::span<const RigView> views, std::span<const PlacedPoint> points, int camera) {
  const std::string wanted =
      "at least 3 points of the mesh that are not on a line, with the pixels where the camera sees them";
  if (points.size() < 3)
    throw InputError(std::string(place) + ".points", fmt::format("{} points", points.size()), wanted);
  Eigen::MatrixXd mesh_side(points.size(), 3), image_side(points.size(), 2);
  for (std::size_t k = 0; k < points.size(); ++k) {
    mesh_side.row(static_cast<Eigen::Index>(k)) << points[k].x, points[k].y, 1.0;
    image_side.row(static_cast<Eigen::Index>(k)) << points[k].column, points[k].row;
  }
  const Eigen::MatrixXd affine = least_squares(mesh_side, image_side);  // [3 x 2]
  const Eigen::Matrix2d A = affine.topRows<2>().transpose();
  const double area = A.determinant();
  const double size =
      (mesh_side.leftCols<2>().colwise().maxCoeff() - mesh_side.leftCols<2>().colwise().minCoeff()).norm();
  const Eigen::MatrixXd centred = mesh_side.leftCols<2>().rowwise() - mesh_side.leftCols<2>().colwise().mean();
  if (singular_values(centred)[1] < 1e-3 * size)
    throw InputError(std::string(place) + ".points", "points on a line", wanted);
  if (area > 0.0)
    throw InputError(std::string(place) + ".points",
                     "a mirrored mesh: its z axis, x cross y, points away from the cameras",
                     "a mesh seen from its front (rows of the image go downwards)");
  const PinholeCamera& eye = views[static_cast<std::size_t>(camera)].camera;
  Eigen::Vector3d sight = Eigen::Vector3d::Zero();
  for (const RigView& view : views) sight += view.camera.pose().rotation.row(2).transpose();
  const Eigen::Vector3d z = -sight.normalized();
  const Eigen::Vector3d along = eye.pose().rotation.transpose() * Eigen::Vector3d(A(0, 0), A(1, 0), 0.0);
  const Eigen::Vector3d x = (along - z * z.dot(along)).normalized();
  Pose pose;
  pose.rotation << x, z.cross(x), z;
  const double distance = std::sqrt(eye.intrinsics().fx * eye.intrinsics().fy / -area);
  const Eigen::Vector2d origin = affine.row(2).transpose();
  const Eigen::Vector3d ray = eye.ray(origin);
  pose.translation = eye.centre() + ray * distance / ray.dot(eye.pose().rotation.row(2).transpose());
  return fit_points(eye, pose, points, in_plane_movements(true));
}

/// References of one pyramid level.
struct Level {
  double factor;
  std::vector<BSpline> splines;
};

/// Points of an element's surface, about one each `spacing` pixels of the image.
struct Sample {
  Eigen::Vector4d N;
  Eigen::Vector3d X;  // in the specimen's frame
};

class Scene {
 public:
  Scene(const mesh::Mesh& surface, std::span<const RigView> views, std::span<const PlacedPoint> points,
        const PoseOptions& options)
      : surface_(surface), views_(views), points_(points), options_(options) {
    for (const RigView& view : views) rig.push_back(view.camera);
    for (int k = 0; k < 4; ++k) {
      Level level{std::ldexp(1.0, k), {}};
      for (std::size_t c = 0; c < views.size(); ++c) {
        if (k == 0) images_.push_back(views[c].reference);
        if (k > 0) images_[c] = imaging::half_size(images_[c]);
        level.splines.emplace_back(images_[c]);
      }
      levels_.push_back(std::move(level));
    }
    shape = Eigen::VectorXd::Zero(surface.nodes.rows());
  }

  Pose pose;
  std::vector<PinholeCamera> rig;  // in the rig's frame
  Eigen::VectorXd shape;           // of the nodes, along z

  [[nodiscard]] std::vector<PinholeCamera> eyes() const {
    std::vector<PinholeCamera> all;
    for (const PinholeCamera& camera : rig) all.push_back(seen_from(camera, pose));
    return all;
  }

  /// Residual over the mesh; `visit(element, sample, a, b, r, slope_a, slope_b)` gets the gradients [1/px] of the two
  /// terms.
  template <class Visit>
  double residuals(int level, const Visit& visit) const {
    const std::vector<PinholeCamera> cameras = eyes();
    const Level& at = levels_[static_cast<std::size_t>(level)];
    double squares = 0.0, count = 0.0;
    struct Seen {
      Sample sample;
      BSpline::Sample grey[2];
    };
    std::vector<Seen> seen;
    for (int e = 0; e < static_cast<int>(surface_.cells.rows()); ++e) {
      Eigen::Matrix<double, 4, 3> X;
      for (int i = 0; i < 4; ++i) {
        X.row(i) = surface_.nodes.row(surface_.cells(e, i));
        X(i, 2) += shape[surface_.cells(e, i)];
      }
      const double pixels =
          std::max((cameras[0].project(X.row(0).transpose()) - cameras[0].project(X.row(2).transpose())).norm(),
                   (cameras[0].project(X.row(1).transpose()) - cameras[0].project(X.row(3).transpose())).norm());
      const int n = std::clamp(static_cast<int>(0.7 * pixels / (at.factor * (level == 0 ? 1.5 : 1.0))), 4, 100);
      for (std::size_t a = 0; a < cameras.size(); ++a)
        for (std::size_t b = a + 1; b < cameras.size(); ++b) {
          seen.clear();
          double f = 0.0, g = 0.0, ff = 0.0, gg = 0.0;
          for (int j = 0; j < n; ++j)
            for (int i = 0; i < n; ++i) {
              const double xi = (2.0 * i + 1.0) / n - 1.0, eta = (2.0 * j + 1.0) / n - 1.0;
              Seen one;
              one.sample.N = 0.25 * (1.0 + corner_xi.array() * xi) * (1.0 + corner_eta.array() * eta);
              one.sample.X = X.transpose() * one.sample.N;
              const Eigen::Vector2d pa = cameras[a].project(one.sample.X) / at.factor,
                                    pb = cameras[b].project(one.sample.X) / at.factor;
              if (!at.splines[a].contains(pa[0], pa[1]) || !at.splines[b].contains(pb[0], pb[1])) continue;
              one.grey[0] = at.splines[a].sample(pa[0], pa[1]), one.grey[1] = at.splines[b].sample(pb[0], pb[1]);
              const double u = one.grey[0].value, v = one.grey[1].value;
              f += u, g += v, ff += u * u, gg += v * v;
              seen.push_back(one);
            }
          const auto m = static_cast<double>(seen.size());
          if (m < 9.0) continue;
          f /= m, g /= m;
          const double sf = std::sqrt(ff / m - f * f), sg = std::sqrt(gg / m - g * g);
          if (!(sf > 0.0) || !(sg > 0.0)) continue;
          for (const Seen& one : seen) {
            const double r = (one.grey[0].value - f) / sf - (one.grey[1].value - g) / sg;
            squares += r * r, count += 1.0;
            visit(e, one.sample, a, b, r, one.grey[0].slope.template cast<double>() / (sf * at.factor),
                  one.grey[1].slope.template cast<double>() / (sg * at.factor));
          }
        }
    }
    if (count == 0.0)
      throw InputError(place, "no part of the mesh is seen by two cameras", "a mesh that lies in both images");
    return std::sqrt(squares / count);
  }
  /// The coarsest level worth while: elements of at least 8 pixels.
  [[nodiscard]] int coarsest() const {
    const PinholeCamera eye = eyes().front();
    double pixels = 0.0;
    for (Eigen::Index e = 0; e < surface_.cells.rows(); ++e)
      pixels += (eye.project(surface_.nodes.row(surface_.cells(e, 0)).transpose()) -
                 eye.project(surface_.nodes.row(surface_.cells(e, 1)).transpose()))
                    .norm() /
                static_cast<double>(surface_.cells.rows());
    return std::clamp(static_cast<int>(std::log2(pixels / 8.0)), 0, 3);
  }
  [[nodiscard]] double rms(int level) const {
    return residuals(level, [](auto&&...) {});
  }

  /// Gauss-Newton for the specimen's pose and, with `cameras`, those of the cameras from the second on.
  void refine_pose(int level, bool cameras) {
    const Eigen::Index unknowns = 6 + (cameras ? 6 * static_cast<Eigen::Index>(rig.size() - 1) : 0);
    const double distance = pose.translation.norm() > 0.0 ? (rig[0].centre() - pose.translation).norm() : 1.0;
    Six deviation;  // what holds a camera
    deviation << Eigen::Vector3d::Constant(0.1 * std::numbers::pi / 180.0), Eigen::Vector3d::Constant(1e-3 * distance);
    const std::vector<PinholeCamera> given = [&] {
      std::vector<PinholeCamera> all;
      for (const RigView& view : views_) all.push_back(view.camera);
      return all;
    }();
    for (int iteration = 0; iteration < 15; ++iteration) {
      Eigen::MatrixXd H = Eigen::MatrixXd::Zero(unknowns, unknowns);
      Eigen::VectorXd b = Eigen::VectorXd::Zero(unknowns);
      const std::vector<PinholeCamera> eyes = this->eyes();
      Eigen::VectorXd slope(unknowns);
      const double rms = residuals(level, [&](int, const Sample& s, std::size_t ca, std::size_t cb, double r,
                                              const Eigen::Vector2d& ga, const Eigen::Vector2d& gb) {
        const Eigen::RowVector3d ja = ga.transpose() * eyes[ca].jacobian(s.X),
                                 jb = gb.transpose() * eyes[cb].jacobian(s.X);
        slope.setZero();  // of r
        // Gliding in the plane changes nothing but by what interpolation and light leave in the residual: the points
        // hold it.
        const Eigen::RowVector3d turning = -(ja - jb) * cross(s.X);
        slope[0] = turning[0], slope[1] = turning[1], slope[5] = ja[2] - jb[2];
        for (const auto& [c, j, sign] : {std::tuple{ca, ja, 1.0}, std::tuple{cb, jb, -1.0}}) {
          if (!cameras || c == 0) continue;
          // The camera's frame: x = exp(w) R X + t + v; j is with respect to X, j R^T with respect to x.
          const Eigen::Matrix3d& R = eyes[c].pose().rotation;
          const Eigen::RowVector3d jx = sign * j * R.transpose();
          const Eigen::Vector3d turned = rig[c].pose().rotation * (pose.rotation * s.X + pose.translation);
          slope.segment<3>(6 * static_cast<Eigen::Index>(c)) = (-jx * cross(turned)).transpose();
          slope.segment<3>(6 * static_cast<Eigen::Index>(c) + 3) = jx.transpose();
        }
        H.selfadjointView<Eigen::Lower>().rankUpdate(slope);
        b -= r * slope;
      });
      H = Eigen::MatrixXd(H.selfadjointView<Eigen::Lower>()) / (rms * rms), b /= rms * rms;
      const PinholeCamera& eye = eyes[static_cast<std::size_t>(options_.camera)];
      const double weight = 1.0 / (options_.point_deviation * options_.point_deviation);
      for (const PlacedPoint& p : points_) {
        const Eigen::Vector3d X(p.x, p.y, 0.0);
        const auto of_pixel = of_movement(eye.jacobian(X), X);
        H.topLeftCorner<6, 6>() += weight * of_pixel.transpose() * of_pixel;
        b.head<6>() += weight * of_pixel.transpose() * (Eigen::Vector2d(p.column, p.row) - eye.project(X));
      }
      for (Eigen::Index c = 1; cameras && c < static_cast<Eigen::Index>(rig.size()); ++c) {
        const Six change = difference(given[static_cast<std::size_t>(c)], rig[static_cast<std::size_t>(c)]);
        for (int k = 0; k < 6; ++k) {
          const double held = 1.0 / (deviation[k] * deviation[k]);
          H(6 * c + k, 6 * c + k) += held, b[6 * c + k] -= held * change[k];
        }
      }
      const Eigen::VectorXd step = solve_symmetric(H, b);
      if (!step.allFinite())
        throw InputError(place, "the images do not hold the specimen's pose", "speckle that the cameras share");
      pose = moved(pose, step.head<6>());
      for (std::size_t c = 1; cameras && c < rig.size(); ++c) {
        const Six d = step.segment<6>(6 * static_cast<Eigen::Index>(c));
        const Pose& at = rig[c].pose();
        rig[c] =
            PinholeCamera(rig[c].intrinsics(), Pose{turn(d.head<3>()) * at.rotation, at.translation + d.tail<3>()});
      }
      const std::vector<PinholeCamera> after = this->eyes();
      double largest = 0.0;
      for (Eigen::Index node = 0; node < surface_.nodes.rows();
           node += std::max<Eigen::Index>(1, surface_.nodes.rows() / 50))
        for (std::size_t c = 0; c < eyes.size(); ++c) {
          const Eigen::Vector3d X = surface_.nodes.row(node).transpose();
          largest = std::max(largest, (after[c].project(X) - eyes[c].project(X)).norm() /
                                          levels_[static_cast<std::size_t>(level)].factor);
        }
      if (largest < 2e-3) break;
    }
  }

  /// Rotation vector [rad] and translation [length] from one pose of a camera to another.
  static Six difference(const PinholeCamera& from, const PinholeCamera& to) {
    const Eigen::AngleAxisd r(to.pose().rotation * from.pose().rotation.transpose());
    Six d;
    d << r.angle() * r.axis(), to.pose().translation - from.pose().translation;
    return d;
  }

  /// Gauss-Newton for the offsets of the nodes along z, without waves shorter than `cut_off`.
  void refine_shape(int level, double cut_off) {
    const Eigen::SparseMatrix<double> energy = curvature_energy(surface_, 1);
    double area = 0.0;
    for (Eigen::Index e = 0; e < surface_.cells.rows(); ++e) {
      const Eigen::RowVector3d d1 = surface_.nodes.row(surface_.cells(e, 2)) - surface_.nodes.row(surface_.cells(e, 0));
      const Eigen::RowVector3d d2 = surface_.nodes.row(surface_.cells(e, 3)) - surface_.nodes.row(surface_.cells(e, 1));
      area += 0.5 * std::abs(d1[0] * d2[1] - d1[1] * d2[0]);
    }
    const std::vector<PinholeCamera> eyes = this->eyes();
    for (int iteration = 0; iteration < 15; ++iteration) {
      std::vector<Eigen::Matrix4d> H(static_cast<std::size_t>(surface_.cells.rows()), Eigen::Matrix4d::Zero());
      Eigen::VectorXd b = Eigen::VectorXd::Zero(shape.size());
      double stiffness = 0.0;
      residuals(level, [&](int e, const Sample& s, std::size_t ca, std::size_t cb, double r, const Eigen::Vector2d& ga,
                           const Eigen::Vector2d& gb) {
        const double slope = ga.dot(eyes[ca].jacobian(s.X).col(2)) - gb.dot(eyes[cb].jacobian(s.X).col(2));
        H[static_cast<std::size_t>(e)] += slope * slope * s.N * s.N.transpose();
        for (int i = 0; i < 4; ++i) b[surface_.cells(e, i)] -= slope * r * s.N[i];
        stiffness += slope * slope;
      });
      const double weight = stiffness / area * std::pow(cut_off / (2.0 * std::numbers::pi), 4);
      std::vector<Eigen::Triplet<double>> entries;
      for (Eigen::Index e = 0; e < surface_.cells.rows(); ++e)
        for (int i = 0; i < 4; ++i)
          for (int j = 0; j < 4; ++j)
            entries.emplace_back(surface_.cells(e, i), surface_.cells(e, j), H[static_cast<std::size_t>(e)](i, j));
      Eigen::SparseMatrix<double> A(shape.size(), shape.size());
      A.setFromTriplets(entries.begin(), entries.end());
      A += weight * energy;
      const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(A);
      const Eigen::VectorXd step = factor.solve(b - weight * (energy * shape));
      if (factor.info() != Eigen::Success || !step.allFinite())
        throw InputError(std::string(place) + ".shape", "the images do not hold the shape", "longer waves");
      shape += step;
      const double pixels = eyes[0].jacobian(Eigen::Vector3d::Zero()).topLeftCorner<2, 2>().norm();
      if (step.cwiseAbs().maxCoeff() * pixels < 0.02 * levels_[static_cast<std::size_t>(level)].factor) break;
    }
  }

  /// The plane from patches of the points' camera that are found in the others' images; then the points again.
  void find_plane(SpecimenPose& result) {
    const auto first = static_cast<std::size_t>(options_.camera);
    constexpr int most = 150;
    constexpr double depth_search = 0.15;  // of the distance
    std::vector<Eigen::Vector3d> found;    // in the specimen's frame
    const std::vector<PinholeCamera> eyes = this->eyes();
    const int step = std::max(1, static_cast<int>(surface_.cells.rows()) / most);
    for (int e = step / 2; e < static_cast<int>(surface_.cells.rows()); e += step) {
      Eigen::Vector3d X = Eigen::Vector3d::Zero();
      for (int i = 0; i < 4; ++i) X += 0.25 * surface_.nodes.row(surface_.cells(e, i)).transpose();
      const Eigen::Vector2d here = eyes[first].project(X);
      if (!levels_[0].splines[first].contains(here[0], here[1])) continue;
      const Eigen::Vector3d from = X - eyes[first].centre();
      for (std::size_t c = 0; c < eyes.size(); ++c) {
        if (c == first) continue;
        ++result.patches;
        // The patch as the other camera would see it if the plane were right.
        constexpr int half = 15;
        const Eigen::Matrix2d back = eyes[c].jacobian(X).leftCols<2>().inverse();
        imaging::Image patch(2 * half + 1, 2 * half + 1);
        bool inside = true;
        for (int j = -half; j <= half && inside; ++j)
          for (int i = -half; i <= half && inside; ++i) {
            const Eigen::Vector2d offset = back * Eigen::Vector2d(i, j);
            const Eigen::Vector2d pixel = eyes[first].project(X + Eigen::Vector3d(offset[0], offset[1], 0.0));
            inside = levels_[0].splines[first].contains(pixel[0], pixel[1]);
            if (inside) patch(i + half, j + half) = levels_[0].splines[first].value(pixel[0], pixel[1]);
          }
        const Eigen::Vector2d there = eyes[c].project(X);
        const double reach = 10.0 + depth_search * (eyes[c].jacobian(X) * from).norm();
        if (!inside || !there.allFinite()) continue;
        const imaging::PatchMatch match = imaging::match_patch(patch, views_[c].reference, there[0], there[1], reach);
        if (match.score < 0.6) continue;
        const std::array<PinholeCamera, 2> two{eyes[first], eyes[c]};
        const std::array<Eigen::Vector2d, 2> pixels{here, Eigen::Vector2d(match.x, match.y)};
        const Triangulated point = triangulate(two, pixels);
        if (point.gap * views_[c].camera.intrinsics().fx / from.norm() < 3.0) found.push_back(point.point);
      }
    }
    const Eigen::Vector2d extent =
        (surface_.nodes.colwise().maxCoeff() - surface_.nodes.colwise().minCoeff()).head<2>().transpose();
    const double near = 0.02 * extent.norm();
    std::mt19937 generator(1);
    std::vector<Eigen::Vector3d> best;
    for (int trial = 0; trial < 300 && found.size() > 2; ++trial) {
      std::uniform_int_distribution<std::size_t> any(0, found.size() - 1);
      const Eigen::Vector3d &p = found[any(generator)], &q = found[any(generator)], &r = found[any(generator)];
      const Eigen::Vector3d normal = (q - p).cross(r - p).normalized();
      if (!normal.allFinite() || std::abs(normal[2]) < 0.5) continue;
      std::vector<Eigen::Vector3d> agree;
      for (const Eigen::Vector3d& one : found)
        if (std::abs(normal.dot(one - p)) < near) agree.push_back(one);
      if (agree.size() > best.size()) best = std::move(agree);
    }
    if (best.size() < 6 || 3 * best.size() < static_cast<std::size_t>(result.patches))
      throw InputError(
          place,
          fmt::format("only {} of {} patches of one camera's image were found in another's on one plane", best.size(),
                      result.patches),
          "points that place the mesh within 15 % of its distance, and a calibration that belongs to the images");
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& one : best) mean += one / static_cast<double>(best.size());
    Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3d& one : best) scatter += (one - mean) * (one - mean).transpose();
    const SymmetricEigen axes = symmetric_eigen(scatter);
    Eigen::Vector3d z = axes.vectors.col(0);
    if (z[2] < 0.0) z = -z;
    result.matched = static_cast<int>(best.size());
    result.plane_rms = std::sqrt(axes.values[0] / static_cast<double>(best.size()));
    // Turn z = e_z to the normal and lift the plane; then glide in it to the points.
    Pose change;
    change.rotation =
        Eigen::AngleAxisd(std::atan2(z.head<2>().norm(), z[2]), Eigen::Vector3d::UnitZ().cross(z).stableNormalized())
            .toRotationMatrix();
    change.translation = z * z.dot(mean);
    pose = fit_points(rig[first], pose * change, points_, in_plane_movements(false));
  }

 private:
  const mesh::Mesh& surface_;
  std::span<const RigView> views_;
  std::span<const PlacedPoint> points_;
  PoseOptions options_;
  std::vector<imaging::Image> images_;
  std::vector<Level> levels_;
};

}  // namespace

Triangulated triangulate(std::span<const PinholeCamera> cameras, std::span<const Eigen::Vector2d> pixels) {
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  std::vector<Eigen::Matrix3d> across;
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    const Eigen::Vector3d ray = cameras[c].ray(pixels[c]);
    across.emplace_back(Eigen::Matrix3d::Identity() - ray * ray.transpose());
    H += across.back(), b += across.back() * cameras[c].centre();
  }
  Triangulated result{H.ldlt().solve(b), 0.0};
  for (std::size_t c = 0; c < cameras.size(); ++c)
    result.gap = std::max(result.gap, (across[c] * (result.point - cameras[c].centre())).norm());
  return result;
}

SpecimenPose find_pose(const mesh::Mesh& surface, std::span<const RigView> views, std::span<const PlacedPoint> points,
                       const PoseOptions& options) {
  SpecimenPose result;
  Scene scene(surface, views, points, options);
  const PinholeCamera& given = views[static_cast<std::size_t>(options.camera)].camera;
  scene.pose = pose_from_points(views, points, options.camera);
  if (views.size() == 1) {
    if (points.size() < 4)
      throw InputError(std::string(place) + ".points", fmt::format("{} points", points.size()),
                       "at least 4 points for one camera");
    scene.pose = fit_points(given, scene.pose, points, Eigen::MatrixXd::Identity(6, 6));
  } else {
    scene.find_plane(result);
    result.rms_start = scene.rms(0);
    for (int level = scene.coarsest(); level >= 0; --level) scene.refine_pose(level, false);
    result.rms_pose = scene.rms(0);
    if (options.cameras) {
      for (int level = std::min(1, scene.coarsest()); level >= 0; --level) scene.refine_pose(level, true);
      result.rms_cameras = scene.rms(0);
    }
    if (options.shape > 0.0) {
      for (int level = std::min(2, scene.coarsest()); level >= 0; --level) scene.refine_shape(level, options.shape);
      result.rms_shape = scene.rms(0);
    }
  }
  result.pose = scene.pose;
  result.shape = scene.shape;
  result.cameras = scene.eyes();
  result.points_rms = points_rms(scene.rig[static_cast<std::size_t>(options.camera)], scene.pose, points);
  for (std::size_t c = 0; c < views.size(); ++c) {
    Six change = Scene::difference(views[c].camera, scene.rig[c]);
    change.head<3>() *= 180.0 / std::numbers::pi;
    result.camera_change.push_back(change);
  }
  return result;
}

}  // namespace imic3d::correlation
