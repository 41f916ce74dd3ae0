#include "imic3d/imaging/calibrate.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/calib3d.hpp>

#include "imic3d/core/error.hpp"

namespace imic3d::imaging {

namespace {

using Eigen::Index;
constexpr int first_term = 5, first_of_pose = 17;  // places among a camera's numbers
constexpr std::size_t fewest_images = 3;
constexpr double most_unsure = 0.1;  // standard deviation of a focal length over its value

/// exp([r]x) rotation, translation + t.
Pose moved(const Pose& pose, const Eigen::Vector3d& r, const Eigen::Vector3d& t) {
  const double angle = r.norm();
  const Eigen::Matrix3d turn =
      angle > 0.0 ? Eigen::AngleAxisd(angle, r / angle).toRotationMatrix() : Eigen::Matrix3d::Identity();
  return {Eigen::Quaterniond(turn * pose.rotation).normalized().toRotationMatrix(), pose.translation + t};
}

/// Everything that the fit moves.
struct State {
  std::vector<Intrinsics> lenses;
  std::vector<Pose> cameras, targets;
  [[nodiscard]] PinholeCamera camera(std::size_t c) const { return {lenses[c], cameras[c]}; }
};

/// Which numbers are unknowns, and where.
class Unknowns {
 public:
  Unknowns(std::size_t cameras, const std::vector<char>& used, const std::vector<int>& terms) {
    for (std::size_t c = 0; c < cameras; ++c) {
      std::vector<int> numbers = {0, 1, 2, 3};
      for (const int term : terms) numbers.push_back(first_term + term);
      if (c > 0)
        for (int n = first_of_pose; n < camera_numbers; ++n) numbers.push_back(n);
      camera_starts_.push_back(count_);
      count_ += static_cast<Index>(numbers.size());
      numbers_.push_back(numbers);
    }
    of_cameras_ = count_;
    for (const char is_used : used) {
      target_starts_.push_back(count_);
      if (is_used) count_ += 6;
    }
  }
  [[nodiscard]] Index count() const { return count_; }
  [[nodiscard]] Index of_cameras() const { return of_cameras_; }  ///< the unknowns of the cameras come first
  [[nodiscard]] const std::vector<int>& numbers(std::size_t camera) const { return numbers_[camera]; }
  [[nodiscard]] Index camera(std::size_t c) const { return camera_starts_[c]; }
  [[nodiscard]] Index target(std::size_t frame) const { return target_starts_[frame]; }

  [[nodiscard]] State moved_by(const State& from, const Eigen::VectorXd& step, const std::vector<char>& used) const {
    State to = from;
    for (std::size_t c = 0; c < numbers_.size(); ++c) {
      Eigen::Vector<double, camera_numbers> change = Eigen::Vector<double, camera_numbers>::Zero();
      for (std::size_t i = 0; i < numbers_[c].size(); ++i)
        change[numbers_[c][i]] = step[camera_starts_[c] + static_cast<Index>(i)];
      Intrinsics& lens = to.lenses[c];
      lens.fx += change[0], lens.fy += change[1], lens.cx += change[2], lens.cy += change[3];
      for (std::size_t k = 0; k < lens.distortion.size(); ++k)
        lens.distortion[k] += change[first_term + static_cast<Index>(k)];
      to.cameras[c] = moved(from.cameras[c], change.segment<3>(first_of_pose), change.tail<3>());
    }
    for (std::size_t f = 0; f < used.size(); ++f)
      if (used[f])
        to.targets[f] =
            moved(from.targets[f], step.segment<3>(target_starts_[f]), step.segment<3>(target_starts_[f] + 3));
    return to;
  }

 private:
  std::vector<std::vector<int>> numbers_;
  std::vector<Index> camera_starts_, target_starts_;
  Index count_ = 0, of_cameras_ = 0;
};

cv::Mat matrix(const Intrinsics& lens) {
  return cv::Mat(cv::Matx33d(lens.fx, lens.skew, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0));
}

Pose pose_of(const cv::Mat& rotation_vector, const cv::Mat& translation) {
  cv::Mat R;
  cv::Rodrigues(rotation_vector, R);
  Pose pose;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) pose.rotation(i, j) = R.at<double>(i, j);
    pose.translation[i] = translation.at<double>(i);
  }
  return pose;
}

std::vector<cv::Point3f> as_points3(const std::vector<Eigen::Vector3d>& points) {
  std::vector<cv::Point3f> all;
  for (const auto& point : points)
    all.emplace_back(static_cast<float>(point[0]), static_cast<float>(point[1]), static_cast<float>(point[2]));
  return all;
}

std::vector<cv::Point2f> as_points2(const std::vector<Eigen::Vector2d>& pixels) {
  std::vector<cv::Point2f> all;
  for (const auto& pixel : pixels) all.emplace_back(static_cast<float>(pixel[0]), static_cast<float>(pixel[1]));
  return all;
}

/// Zhang's method for one camera by itself.
Intrinsics lens_alone(const std::vector<Eigen::Vector3d>& points, const CameraSightings& seen,
                      const std::vector<int>& terms) {
  std::vector<std::vector<cv::Point3f>> objects;
  std::vector<std::vector<cv::Point2f>> images;
  for (const auto& pixels : seen.pixels)
    if (!pixels.empty()) objects.push_back(as_points3(points)), images.push_back(as_points2(pixels));
  const auto free = [&](int term) { return std::find(terms.begin(), terms.end(), term) != terms.end(); };
  int flags = 0;
  constexpr std::pair<int, int> fixed[] = {{0, cv::CALIB_FIX_K1}, {1, cv::CALIB_FIX_K2}, {4, cv::CALIB_FIX_K3}};
  for (const auto& [term, flag] : fixed)
    if (!free(term)) flags |= flag;
  if (!free(2) || !free(3)) flags |= cv::CALIB_ZERO_TANGENT_DIST;  // the further terms start from zero
  cv::Mat K, D;
  std::vector<cv::Mat> rotations, translations;
  try {
    cv::calibrateCamera(objects, images, {seen.width, seen.height}, K, D, rotations, translations, flags);
  } catch (const cv::Exception& exception) {
    throw InputError("camera " + seen.name, "no calibration: " + exception.err,
                     "images of a flat target in different directions");
  }
  Intrinsics lens{
      .fx = K.at<double>(0, 0), .fy = K.at<double>(1, 1), .cx = K.at<double>(0, 2), .cy = K.at<double>(1, 2)};
  for (std::size_t k = 0; k < 5; ++k)
    if (free(static_cast<int>(k))) lens.distortion[k] = D.at<double>(static_cast<int>(k));
  return lens;
}

Pose pose_alone(const std::vector<Eigen::Vector3d>& points, const std::vector<Eigen::Vector2d>& pixels,
                const Intrinsics& lens) {
  cv::Mat rotation, translation;
  cv::solvePnP(as_points3(points), as_points2(pixels), matrix(lens),
               std::vector<double>(lens.distortion.begin(), lens.distortion.end()), rotation, translation);
  return pose_of(rotation, translation);
}

std::vector<Eigen::Vector3d> ordered(const std::vector<Eigen::Vector3d>& points, const std::vector<int>& order) {
  std::vector<Eigen::Vector3d> all;
  for (const int k : order) all.push_back(points[static_cast<std::size_t>(k)]);
  return all;
}

class Adjustment {
 public:
  Adjustment(const Target& target, const std::vector<CameraSightings>& sightings, const std::vector<int>& terms)
      : target_(target),
        points_(target.points()),
        sightings_(sightings),
        orders_(target.orders()),
        frames_(sightings[0].pixels.size()),
        used_(frames_, 0) {
    for (const auto& camera : sightings_)
      for (std::size_t f = 0; f < frames_; ++f)
        if (!camera.pixels[f].empty()) used_[f] = 1;
    start(terms);
    offsets_.assign(sightings_.size(), std::vector<std::vector<Eigen::Vector2d>>(
                                           frames_, std::vector<Eigen::Vector2d>(points_.size(), {0.0, 0.0})));
  }

  RigCalibration run(const std::vector<int>& terms) {
    const Unknowns unknowns(sightings_.size(), used_, terms);
    RigCalibration result;
    const int passes = target_.type != TargetType::chessboard && target_.diameter > 0.0 ? 3 : 1;
    for (int pass = 0; pass < passes; ++pass) {
      if (passes > 1) set_offsets();
      result.iterations += minimise(unknowns);
    }
    finish(unknowns, result);  // says what is undetermined, which is why a fit may not end
    if (!converged_) throw ConvergenceError(fmt::format("calibration: {} iterations", result.iterations));
    return result;
  }

 private:
  void start(const std::vector<int>& terms) {
    state_.targets.resize(frames_);
    // of the target in each camera's frame
    std::vector<std::vector<Pose>> seen(sightings_.size(), std::vector<Pose>(frames_));
    order_.assign(sightings_.size(), std::vector<std::size_t>(frames_, 0));
    for (std::size_t c = 0; c < sightings_.size(); ++c) {
      state_.lenses.push_back(lens_alone(points_, sightings_[c], terms));
      for (std::size_t f = 0; f < frames_; ++f)
        if (!sightings_[c].pixels[f].empty())
          seen[c][f] = pose_alone(points_, sightings_[c].pixels[f], state_.lenses[c]);
      state_.cameras.push_back(c == 0 ? Pose{} : relative_pose(c, seen[0]));
    }
    for (std::size_t f = 0; f < frames_; ++f)
      for (std::size_t c = sightings_.size(); c-- > 0;)
        if (!sightings_[c].pixels[f].empty())
          state_.targets[f] = inverse(state_.cameras[c]) * pose_alone(ordered(points_, orders_[order_[c][f]]),
                                                                      sightings_[c].pixels[f], state_.lenses[c]);
  }

  /// Camera c after the first: the pose that most frames agree on, each with the order of the points that suits best.
  Pose relative_pose(std::size_t c, const std::vector<Pose>& in_first) {
    struct Candidate {
      std::size_t frame, order;
      Pose pose;
    };
    std::vector<Candidate> candidates;
    for (std::size_t f = 0; f < frames_; ++f)
      for (std::size_t o = 0; o < orders_.size(); ++o)
        if (!sightings_[0].pixels[f].empty() && !sightings_[c].pixels[f].empty())
          candidates.push_back({f, o,
                                pose_alone(ordered(points_, orders_[o]), sightings_[c].pixels[f], state_.lenses[c]) *
                                    inverse(in_first[f])});
    const auto difference = [](const Pose& a, const Pose& b) {
      return Eigen::AngleAxisd(a.rotation * b.rotation.transpose()).angle() +
             (a.translation - b.translation).norm() / (1e-300 + a.translation.norm() + b.translation.norm());
    };
    double best = std::numeric_limits<double>::infinity();
    Pose found;
    for (const auto& candidate : candidates) {
      std::vector<double> nearest(frames_, std::numeric_limits<double>::infinity());
      for (const auto& other : candidates)
        nearest[other.frame] = std::min(nearest[other.frame], difference(candidate.pose, other.pose));
      double sum = 0.0;
      for (const double distance : nearest)
        if (std::isfinite(distance)) sum += distance;
      if (sum < best) best = sum, found = candidate.pose;
    }
    std::vector<double> nearest(frames_, std::numeric_limits<double>::infinity());
    for (const auto& candidate : candidates)
      if (const double distance = difference(candidate.pose, found); distance < nearest[candidate.frame])
        nearest[candidate.frame] = distance, order_[c][candidate.frame] = candidate.order;
    return found;
  }

  /// A circle's image has its centroid where the centre's image is not: their difference, by the contour's polygon.
  void set_offsets() {
    constexpr int corners = 48;
    for (std::size_t c = 0; c < sightings_.size(); ++c) {
      const PinholeCamera camera = state_.camera(c);
      for (std::size_t f = 0; f < frames_; ++f) {
        if (sightings_[c].pixels[f].empty()) continue;
        const Pose& pose = state_.targets[f];
        for (std::size_t p = 0; p < points_.size(); ++p) {
          const Eigen::Vector2d centre = camera.project(pose.rotation * points_[p] + pose.translation);
          std::vector<Eigen::Vector2d> contour;
          for (int k = 0; k < corners; ++k) {
            const double angle = 2.0 * std::numbers::pi * k / corners;
            const Eigen::Vector3d point =
                points_[p] + 0.5 * target_.diameter * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0);
            contour.push_back(camera.project(pose.rotation * point + pose.translation) - centre);
          }
          double area = 0.0;
          Eigen::Vector2d moment(0.0, 0.0);
          for (std::size_t k = 0; k < contour.size(); ++k) {
            const auto &a = contour[k], &b = contour[(k + 1) % contour.size()];
            const double cross = a[0] * b[1] - a[1] * b[0];
            area += 0.5 * cross, moment += cross / 6.0 * (a + b);
          }
          offsets_[c][f][p] = moment / area;
        }
      }
    }
  }

  /// Calls action(camera, frame, number of the finder's point, residual [px], the point in the rig's frame, R_target *
  /// point).
  template <class Action>
  void for_points(const State& state, Action action) const {
    for (std::size_t c = 0; c < sightings_.size(); ++c) {
      const PinholeCamera camera = state.camera(c);
      for (std::size_t f = 0; f < frames_; ++f) {
        const auto& pixels = sightings_[c].pixels[f];
        for (std::size_t k = 0; k < pixels.size(); ++k) {
          const auto p = static_cast<std::size_t>(orders_[order_[c][f]][k]);
          const Eigen::Vector3d turned = state.targets[f].rotation * points_[p],
                                at = turned + state.targets[f].translation;
          action(c, f, p, Eigen::Vector2d(pixels[k] - offsets_[c][f][p] - camera.project(at)), at, turned);
        }
      }
    }
  }

  [[nodiscard]] double squares(const State& state) const {
    double sum = 0.0;
    for_points(state, [&](std::size_t, std::size_t, std::size_t, const Eigen::Vector2d& r, const Eigen::Vector3d&,
                          const Eigen::Vector3d&) { sum += r.squaredNorm(); });
    return sum;
  }

  /// H = J^T J, g = J^T r.
  void normal_equations(const Unknowns& unknowns, Eigen::MatrixXd& H, Eigen::VectorXd& g) const {
    H.setZero(unknowns.count(), unknowns.count());
    g.setZero(unknowns.count());
    std::vector<PinholeCamera> cameras;
    for (std::size_t c = 0; c < sightings_.size(); ++c) cameras.push_back(state_.camera(c));
    for_points(state_, [&](std::size_t c, std::size_t f, std::size_t, const Eigen::Vector2d& r,
                           const Eigen::Vector3d& at, const Eigen::Vector3d& turned) {
      const auto& numbers = unknowns.numbers(c);
      const auto count = static_cast<Index>(numbers.size());
      const auto of_numbers = cameras[c].jacobian_of_numbers(at);
      Eigen::Matrix<double, 2, Eigen::Dynamic> J(2, count + 6);
      for (Index i = 0; i < count; ++i) J.col(i) = of_numbers.col(numbers[static_cast<std::size_t>(i)]);
      const Eigen::Matrix<double, 2, 3> of_point = cameras[c].jacobian(at);
      for (int axis = 0; axis < 3; ++axis) J.col(count + axis) = of_point * Eigen::Vector3d::Unit(axis).cross(turned);
      J.rightCols<3>() = of_point;
      const Eigen::MatrixXd JtJ = J.transpose() * J;
      const Eigen::VectorXd Jtr = J.transpose() * r;
      const Index a = unknowns.camera(c), b = unknowns.target(f);
      H.block(a, a, count, count) += JtJ.topLeftCorner(count, count);
      H.block(a, b, count, 6) += JtJ.topRightCorner(count, 6);
      H.block(b, a, 6, count) += JtJ.bottomLeftCorner(6, count);
      H.block(b, b, 6, 6) += JtJ.bottomRightCorner<6, 6>();
      g.segment(a, count) += Jtr.head(count);
      g.segment(b, 6) += Jtr.tail(6);
    });
  }

  /// Levenberg-Marquardt, damped along the diagonal. Returns the iterations; converged_ says whether it came to an end.
  int minimise(const Unknowns& unknowns) {
    constexpr int most = 200;
    Eigen::MatrixXd H;
    Eigen::VectorXd g;
    double damping = 1e-4, now = squares(state_);
    for (int iteration = 1; iteration <= most; ++iteration) {
      normal_equations(unknowns, H, g);
      if (!g.allFinite()) throw ConvergenceError("calibration: a point fell behind a camera");
      while (true) {
        Eigen::MatrixXd damped = H;
        damped.diagonal() *= 1.0 + damping;
        const Eigen::VectorXd step = damped.ldlt().solve(g);
        const double predicted = step.dot(g);  // about twice the fall of the squares
        converged_ = predicted < 1e-13 * now + 1e-20;
        if (converged_) return iteration;
        const State trial = unknowns.moved_by(state_, step, used_);
        const double then = squares(trial);
        if (then <= now) {
          state_ = trial, now = then;
          damping = std::max(1e-12, 0.1 * damping);
          break;
        }
        damping *= 10.0;
        converged_ = damping > 1e12;  // rounding: no step is downhill
        if (converged_) return iteration;
      }
    }
    return most;
  }

  void finish(const Unknowns& unknowns, RigCalibration& result) const {
    Eigen::MatrixXd H;
    Eigen::VectorXd g;
    normal_equations(unknowns, H, g);
    result.residuals.assign(sightings_.size(), std::vector<std::vector<Eigen::Vector2d>>(frames_));
    for (std::size_t c = 0; c < sightings_.size(); ++c)
      for (std::size_t f = 0; f < frames_; ++f) result.residuals[c][f].resize(sightings_[c].pixels[f].size());
    double sum = 0.0;
    Index points = 0;
    std::vector<std::vector<std::size_t>> next(sightings_.size(), std::vector<std::size_t>(frames_, 0));
    for_points(state_, [&](std::size_t c, std::size_t f, std::size_t, const Eigen::Vector2d& r, const Eigen::Vector3d&,
                           const Eigen::Vector3d&) {
      result.residuals[c][f][next[c][f]++] = r;  // in the finder's order, as the pixels
      sum += r.squaredNorm(), ++points;
    });
    result.rms = std::sqrt(sum / static_cast<double>(points));
    const Index freedom = 2 * points - unknowns.count();
    if (freedom <= 0)
      throw InputError("images", fmt::format("{} points for {} unknowns", points, unknowns.count()), "more images");
    result.deviation = std::sqrt(sum / static_cast<double>(freedom));
    const Eigen::VectorXd scale = H.diagonal().cwiseSqrt().cwiseInverse();
    const Eigen::LDLT<Eigen::MatrixXd> factor(scale.asDiagonal() * H * scale.asDiagonal());
    if (!(factor.rcond() > 1e-15))
      throw InputError("images", "they leave a number of the cameras undetermined",
                       "the target turned in different directions, or fewer distortion terms");
    const Eigen::MatrixXd unscaled =
        factor.solve(Eigen::MatrixXd::Identity(unknowns.count(), unknowns.of_cameras())).topRows(unknowns.of_cameras());
    const Eigen::VectorXd head = scale.head(unknowns.of_cameras());
    const Eigen::MatrixXd covariance =
        head.asDiagonal() * unscaled * head.asDiagonal() * (result.deviation * result.deviation);
    const auto cameras = static_cast<Index>(sightings_.size());
    for (Index c = 0; c < cameras; ++c) {
      const auto& seen = sightings_[static_cast<std::size_t>(c)];
      CalibratedCamera camera{.name = seen.name,
                              .width = seen.width,
                              .height = seen.height,
                              .intrinsics = state_.lenses[static_cast<std::size_t>(c)],
                              .pose = state_.cameras[static_cast<std::size_t>(c)],
                              .covariance = Eigen::MatrixXd::Zero(camera_numbers, camera_numbers * cameras)};
      for (Index d = 0; d < cameras; ++d) {
        const auto &rows = unknowns.numbers(static_cast<std::size_t>(c)),
                   &columns = unknowns.numbers(static_cast<std::size_t>(d));
        for (std::size_t i = 0; i < rows.size(); ++i)
          for (std::size_t j = 0; j < columns.size(); ++j)
            camera.covariance(rows[i], d * camera_numbers + columns[j]) =
                covariance(unknowns.camera(static_cast<std::size_t>(c)) + static_cast<Index>(i),
                           unknowns.camera(static_cast<std::size_t>(d)) + static_cast<Index>(j));
      }
      for (const auto& [number, value] : {std::pair(0, camera.intrinsics.fx), std::pair(1, camera.intrinsics.fy)})
        if (const double deviation = std::sqrt(camera.covariance(number, c * camera_numbers + number));
            !(deviation < most_unsure * value))
          throw InputError(
              "camera " + seen.name,
              fmt::format(
                  "the images leave its focal length undetermined: {:.4g} px with a standard deviation of {:.2g}",
                  value, deviation),
              "the target turned in different directions");
      result.cameras.push_back(camera);
    }
    result.targets = state_.targets;
    result.used = used_;
  }

  const Target& target_;
  const std::vector<Eigen::Vector3d> points_;
  const std::vector<CameraSightings>& sightings_;
  const std::vector<std::vector<int>> orders_;
  std::size_t frames_;
  std::vector<char> used_;
  // [cameras][frames] which order the finder took
  std::vector<std::vector<std::size_t>> order_;
  // [cameras][frames][points] centroid - centre [px]
  std::vector<std::vector<std::vector<Eigen::Vector2d>>> offsets_;
  State state_;
  bool converged_ = false;
};

double root_mean(double sum, std::size_t count) {
  return count > 0 ? std::sqrt(sum / static_cast<double>(count)) : std::nan("");
}

}  // namespace

double RigCalibration::rms_of(std::size_t camera) const {
  double sum = 0.0;
  std::size_t count = 0;
  for (const auto& frame : residuals[camera])
    for (const auto& r : frame) sum += r.squaredNorm(), ++count;
  return root_mean(sum, count);
}

double RigCalibration::rms_of(std::size_t camera, std::size_t frame) const {
  double sum = 0.0;
  for (const auto& r : residuals[camera][frame]) sum += r.squaredNorm();
  return root_mean(sum, residuals[camera][frame].size());
}

RigCalibration calibrate_rig(const Target& target, const std::vector<CameraSightings>& sightings,
                             const std::vector<int>& terms) {
  std::vector<Mistake> mistakes;
  for (const auto& camera : sightings) {
    std::size_t found = 0, shared = 0;
    for (std::size_t f = 0; f < camera.pixels.size(); ++f) {
      found += !camera.pixels[f].empty();
      shared += !camera.pixels[f].empty() && !sightings[0].pixels[f].empty();
    }
    if (found < fewest_images)
      mistakes.push_back({"camera " + camera.name,
                          fmt::format("the target was found in {} of {} images", found, camera.pixels.size()),
                          fmt::format("at least {}", fewest_images)});
    else if (shared < 1)
      mistakes.push_back(
          {"camera " + camera.name, "no image of the target at the same time as " + sightings[0].name, "at least 1"});
  }
  if (!mistakes.empty()) throw InputError(mistakes);
  return Adjustment(target, sightings, terms).run(terms);
}

}  // namespace imic3d::imaging
