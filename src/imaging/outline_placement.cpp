// A specimen's place by its outline in the reference image: a search on a coarse image, then a robust fit to the
// sub-pixel position of its edges.

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "imic3d/core/linear.hpp"
#include "outline.hpp"
#include "plane_map.hpp"

namespace imic3d::imaging {

using Eigen::Matrix2d;
using Eigen::Vector2d;

namespace {

// ---------------------------------------------------------------------------------------------------------------------
// Coarse search

struct Candidate {
  double score = -1.0;
  double pixel_size = 0.0, rotation = 0.0;  // [radian]
  Vector2d centre;                          // pixel of the middle of the mesh
};

/// The image at the resolution of the search, and which of its pixels are the specimen's.
struct CoarseImage {
  double factor = 1.0;  ///< pixels of the image per coarse pixel
  cv::Mat1b mask;
  double dark = 0.0, bright = 0.0, threshold = 0.0;  ///< grey levels of the two classes and between them
};

constexpr int coarse_size = 80;

CoarseImage coarse_image(const cv::Mat1f& image) {
  CoarseImage coarse;
  coarse.factor = std::max(1.0, static_cast<double>(std::max(image.rows, image.cols)) / coarse_size);
  cv::Mat1f small;
  cv::resize(image, small,
             cv::Size(static_cast<int>(std::lround(image.cols / coarse.factor)),
                      static_cast<int>(std::lround(image.rows / coarse.factor))),
             0.0, 0.0, cv::INTER_AREA);
  cv::GaussianBlur(small, small, cv::Size(0, 0), 0.7, 0.7, cv::BORDER_REPLICATE);
  double low = 0.0, high = 0.0;
  cv::minMaxLoc(small, &low, &high);
  cv::Mat1b bytes, mask;
  const double scale = 255.0 / std::max(high - low, 1e-9);
  small.convertTo(bytes, CV_8U, scale, -low * scale);
  const double otsu = cv::threshold(bytes, mask, 0.0, 1.0, cv::THRESH_BINARY | cv::THRESH_OTSU);
  coarse.threshold = low + otsu / scale;
  coarse.mask = mask;
  coarse.bright = cv::mean(small, mask)[0];
  coarse.dark = cv::mean(small, mask == 0)[0];
  return coarse;
}

/// Slides the outline over the coarse image. The score of a place is the mean over the outline of (material just inside
/// - material just outside), less what the mesh's inside has of background. The best places, best first.
std::vector<Candidate> search(const CoarseImage& coarse, const std::vector<Contour>& contours, const Vector2d& low,
                              const Vector2d& high, const OutlineOptions& options) {
  const double width = coarse.mask.cols, height = coarse.mask.rows;
  const Vector2d middle = 0.5 * (low + high), extent = high - low;
  const auto outline = sample_outline(contours, extent.sum() / 80.0, 0.0);
  const auto inside = points_inside(contours, low, high, 80);
  constexpr double reach = 2.0, angle_step = 4.0 * degree;

  std::vector<double> pixel_sizes;  // per coarse pixel
  if (options.pixel_size) {
    pixel_sizes.push_back(*options.pixel_size * coarse.factor);
  } else {
    const double largest_view =
        std::max(extent.maxCoeff() / std::max(width, height), extent.minCoeff() / std::min(width, height));
    for (double size = 0.95 * largest_view; size < 4.0 * largest_view; size *= 1.05) pixel_sizes.push_back(size);
  }
  const int angle_count = 2 * static_cast<int>(std::ceil(options.search * degree / angle_step)) + 1;
  const int poses = static_cast<int>(pixel_sizes.size()) * angle_count;
  std::vector<std::vector<Candidate>> found(static_cast<std::size_t>(poses));

#pragma omp parallel for schedule(dynamic)
  for (int pose = 0; pose < poses; ++pose) {
    const double pixel_size = pixel_sizes[static_cast<std::size_t>(pose / angle_count)];
    const double rotation = options.rotation * degree + (pose % angle_count - angle_count / 2) * angle_step;
    const Matrix2d linear = similarity(pixel_size, rotation, options.flip);
    std::vector<Vector2d> in, out, body;
    Vector2d least = Vector2d::Constant(1e9), most = -least;
    for (const auto& point : outline) {
      const Vector2d at = linear * (point.place - middle), normal = (linear * point.normal).normalized();
      in.push_back(at - reach * normal);
      out.push_back(at + reach * normal);
      least = least.cwiseMin(at);
      most = most.cwiseMax(at);
    }
    // Strided, so that the first few are all over the mesh.
    constexpr std::size_t stride = 7;
    for (std::size_t first = 0; first < stride; ++first)
      for (std::size_t i = first; i < inside.size(); i += stride) body.emplace_back(linear * (inside[i] - middle));
    const int allowed = static_cast<int>(body.size()) / 5;
    const auto material = [&](const Vector2d& at) -> int {
      const int x = std::clamp(static_cast<int>(std::lround(at.x())), 0, coarse.mask.cols - 1);
      const int y = std::clamp(static_cast<int>(std::lround(at.y())), 0, coarse.mask.rows - 1);
      return coarse.mask(y, x);
    };
    std::vector<Candidate>& mine = found[static_cast<std::size_t>(pose)];
    constexpr double slack = 2.0;
    for (double y = std::ceil(-least.y() - slack); y <= height - 1 - most.y() + slack; y += 1.0)
      for (double x = std::ceil(-least.x() - slack); x <= width - 1 - most.x() + slack; x += 1.0) {
        const Vector2d centre(x, y);
        int background = 0;
        for (std::size_t i = 0; i < body.size() && background <= allowed; ++i)
          background += 1 - material(centre + body[i]);
        if (background > allowed) continue;
        const double missing = static_cast<double>(background) / static_cast<double>(body.size());
        int edge = 0;
        for (std::size_t i = 0; i < in.size(); ++i) edge += material(centre + in[i]) - material(centre + out[i]);
        const double score = static_cast<double>(edge) / static_cast<double>(in.size()) - 2.0 * missing;
        if (score < 0.1) continue;
        mine.push_back({score, pixel_size / coarse.factor, rotation, centre});
      }
    std::sort(mine.begin(), mine.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
    if (mine.size() > 20) mine.resize(20);
  }

  std::vector<Candidate> all;
  for (const auto& some : found) all.insert(all.end(), some.begin(), some.end());
  std::stable_sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  std::vector<Candidate> best;
  for (const auto& candidate : all) {
    const bool near = std::any_of(best.begin(), best.end(), [&](const Candidate& other) {
      return (other.centre - candidate.centre).norm() < 4.0 &&
             std::abs(other.rotation - candidate.rotation) < 1.5 * angle_step &&
             std::abs(std::log(other.pixel_size / candidate.pixel_size)) < 0.05;
    });
    if (!near) best.push_back(candidate);
    if (best.size() == 8) break;
  }
  for (auto& candidate : best)  // the centre of coarse pixel X lies at factor * (X + 1/2) - 1/2
    candidate.centre = (candidate.centre.array() + 0.5) * coarse.factor - 0.5;
  return best;
}

// ---------------------------------------------------------------------------------------------------------------------
// Sub-pixel fit

float bilinear(const cv::Mat1f& image, const Vector2d& at) {
  const double x = std::clamp(at.x(), 0.0, image.cols - 1.001), y = std::clamp(at.y(), 0.0, image.rows - 1.001);
  const int column = static_cast<int>(x), row = static_cast<int>(y);
  const auto tx = static_cast<float>(x - column), ty = static_cast<float>(y - row);
  const float* upper = image[row] + column;
  const float* lower = image[row + 1] + column;
  return (1 - ty) * ((1 - tx) * upper[0] + tx * upper[1]) + ty * ((1 - tx) * lower[0] + tx * lower[1]);
}

double quantile(std::vector<double> values, double part) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// An edge of the image near a point of the outline.
struct Edge {
  bool found = false;
  double offset = 0.0;  ///< from the point, positive outwards [px]
  double weight = 0.0;  ///< 1 where the material just inside is bright, 0 where a dark speckle lies on the edge
};

/// Looks for an edge along a normal, from `outside` px out in the background to `inside` px in the material: where the
/// grey level first rises half way from the background's to the bright part of the material's.
Edge find_edge(const cv::Mat1f& image, const CoarseImage& classes, const Vector2d& at, const Vector2d& normal,
               double outside, double inside) {
  const double step = std::max(0.25, (outside + inside) / 88.0);
  const auto zero = static_cast<std::size_t>(std::lround(outside / step));  // where the outline is in the profile
  const std::size_t size = zero + static_cast<std::size_t>(std::lround(inside / step)) + 1;
  const auto on_image = [&](double out) {
    const Vector2d place = at + out * normal;
    return place.x() >= 0.0 && place.y() >= 0.0 && place.x() <= image.cols - 1 && place.y() <= image.rows - 1;
  };
  if (!on_image(std::min(outside, 6.0)) || !on_image(-inside)) return {};
  const Vector2d tangent(-normal.y(), normal.x());
  std::vector<double> profile(size);
  for (std::size_t k = 0; k < size; ++k) {
    const Vector2d place = at + (static_cast<double>(zero) - static_cast<double>(k)) * step * normal;
    profile[k] = (bilinear(image, place - tangent) + bilinear(image, place) + bilinear(image, place + tangent)) / 3.0;
  }
  // Outside all is dark; inside the speckles may be dark too, so that the bright part counts.
  const double contrast = classes.bright - classes.dark;
  const double background = quantile({profile.begin(), profile.begin() + static_cast<std::ptrdiff_t>(zero / 2)}, 0.9);
  const double bright = quantile({profile.begin() + static_cast<std::ptrdiff_t>(zero), profile.end()}, 0.8);
  if (background > classes.dark + 0.4 * contrast || bright < classes.threshold || bright - background < 0.35 * contrast)
    return {};
  const double level = 0.5 * (background + bright);
  for (std::size_t k = zero / 2 + 1; k < size; ++k) {
    if (profile[k] < level || profile[k - 1] >= level) continue;
    const double part = (level - profile[k - 1]) / (profile[k] - profile[k - 1]);
    Edge edge{.found = true, .offset = (static_cast<double>(zero) - static_cast<double>(k) + 1.0 - part) * step};
    double lowest = bright;  // from 1 to 2.5 px inside the edge
    for (std::size_t i = k + 4; i < std::min(k + 11, size); ++i) lowest = std::min(lowest, profile[i]);
    edge.weight = std::clamp((lowest - level) / (0.7 * (bright - level)), 0.0, 1.0);
    return edge;
  }
  return {};
}

struct Fit {
  PlaneMap map;
  double rms = std::numeric_limits<double>::infinity();
  int agreeing = 0, visible = 0, tried = 0;
  std::vector<int> tried_of_contour, agreeing_of_contour;
  double median = 0.0;  ///< of the distances of the edge points that agree [px]
  /// smallest eigenvalue of a similarity's normal matrix per edge point: 0 if one is free
  double stiffness = 0.0;
};

/// How far from the outline an edge is looked for [px].
struct Reach {
  double outside, inside;
};

enum class Freedom { rigid = 3, similarity = 4, affine = 6 };

/// Where the outline lies inside the material (an end of a mesh shorter than the specimen), speckles pass for edges
/// here and there: an edge counts if most of its neighbours along the contour have one.
void drop_stray_edges(const std::vector<OutlinePoint>& outline, std::vector<Edge>& edges) {
  constexpr std::ptrdiff_t neighbours = 8;
  const auto count = static_cast<std::ptrdiff_t>(edges.size());
  std::vector<char> keep(edges.size(), 0);
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    int there = 0, with_edge = 0;
    for (std::ptrdiff_t k = std::max<std::ptrdiff_t>(0, i - neighbours); k <= std::min(count - 1, i + neighbours);
         ++k) {
      const auto at = static_cast<std::size_t>(k);
      if (outline[at].contour != outline[static_cast<std::size_t>(i)].contour ||
          outline[at].normal.dot(outline[static_cast<std::size_t>(i)].normal) < 0.5)
        continue;
      ++there;
      with_edge += edges[at].found ? 1 : 0;
    }
    keep[static_cast<std::size_t>(i)] = 2 * with_edge > there ? 1 : 0;
  }
  for (std::size_t i = 0; i < edges.size(); ++i) edges[i].found = edges[i].found && keep[i] != 0;
}

/// One robust step: looks for the edges within `reach` of the outline and moves the map towards those within `window`
/// of it (Tukey's weights).
Fit step(const cv::Mat1f& image, const CoarseImage& classes, const std::vector<OutlinePoint>& outline, PlaneMap map,
         Freedom freedom, const Reach& reach, double window) {
  const auto count = static_cast<std::ptrdiff_t>(outline.size());
  const auto unknowns = static_cast<Eigen::Index>(freedom);
  std::vector<Edge> edges(outline.size());
  std::vector<Vector2d> places(outline.size()), normals(outline.size());
  // Normals are carried by the inverse transpose of the map.
  const Matrix2d carry = map.linear.inverse().transpose();
#pragma omp parallel for schedule(static)
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    places[k] = map(outline[k].place);
    normals[k] = (carry * outline[k].normal).normalized();
    edges[k] = find_edge(image, classes, places[k], normals[k], reach.outside, reach.inside);
  }
  drop_stray_edges(outline, edges);

  Vector2d centre = Vector2d::Zero();
  double radius = 0.0;
  for (const auto& place : places) centre += place / static_cast<double>(count);
  for (const auto& place : places) radius += (place - centre).norm() / static_cast<double>(count);

  Fit fit;
  fit.tried = static_cast<int>(count);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(unknowns, unknowns);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(unknowns);
  Eigen::Matrix4d of_similarity = Eigen::Matrix4d::Zero();
  double weights = 0.0, squares = 0.0;
  std::vector<double> distances;
  const auto contour_count = static_cast<std::size_t>(outline.back().contour) + 1;
  fit.tried_of_contour.assign(contour_count, 0);
  fit.agreeing_of_contour.assign(contour_count, 0);
  for (std::size_t k = 0; k < outline.size(); ++k) {
    ++fit.tried_of_contour[static_cast<std::size_t>(outline[k].contour)];
    if (!edges[k].found) continue;
    ++fit.visible;
    const double offset = edges[k].offset;
    if (std::abs(offset) >= window) continue;
    ++fit.agreeing;
    ++fit.agreeing_of_contour[static_cast<std::size_t>(outline[k].contour)];
    distances.push_back(std::abs(offset));
    squares += offset * offset;
    const double part = 1.0 - offset * offset / (window * window), weight = part * part * (0.02 + edges[k].weight);
    const Vector2d arm = (places[k] - centre) / radius, &normal = normals[k];
    Eigen::VectorXd row(unknowns);
    row.head<2>() = normal;
    const double turn = normal.x() * -arm.y() + normal.y() * arm.x();
    if (freedom == Freedom::rigid) row[2] = turn;
    if (freedom == Freedom::similarity) row.tail<2>() << turn, normal.dot(arm);
    if (freedom == Freedom::affine)
      row.tail<4>() << normal.x() * arm.x(), normal.x() * arm.y(), normal.y() * arm.x(), normal.y() * arm.y();
    matrix += weight * row * row.transpose();
    const Eigen::Vector4d movement(normal.x(), normal.y(), turn, normal.dot(arm));
    of_similarity += weight * movement * movement.transpose();
    right += weight * offset * row;
    weights += weight;
  }
  fit.map = map;
  if (fit.agreeing < 2 * unknowns) return fit;
  fit.rms = std::sqrt(squares / fit.agreeing);
  fit.median = quantile(distances, 0.5);
  const SymmetricEigen eigen = symmetric_eigen(matrix / weights);
  // Even where the scale is known: edges that would leave it free (one corner of the specimen) are no evidence of a
  // place.
  fit.stiffness =
      std::min(freedom == Freedom::affine ? 1.0 : eigen.values[0], symmetric_eigen(of_similarity / weights).values[0]);
  // A movement that the edges leave free is not made.
  Eigen::VectorXd update = Eigen::VectorXd::Zero(unknowns);
  for (Eigen::Index i = 0; i < unknowns; ++i)
    if (eigen.values[i] > 1e-4)
      update += eigen.vectors.col(i) * (eigen.vectors.col(i).dot(right / weights) / eigen.values[i]);
  Matrix2d change = Matrix2d::Identity();
  if (freedom == Freedom::affine) {
    change(0, 0) += update[2] / radius;
    change(0, 1) += update[3] / radius;
    change(1, 0) += update[4] / radius;
    change(1, 1) += update[5] / radius;
  } else {
    change = Eigen::Rotation2Dd(update[2] / radius).toRotationMatrix();
    if (freedom == Freedom::similarity) change *= 1.0 + update[3] / radius;
  }
  fit.map.linear = change * map.linear;
  fit.map.offset = centre + update.head<2>() + change * (map.offset - centre);
  return fit;
}

/// From a place of the coarse search to the sub-pixel fit, by looking ever closer. `background` is how far out of the
/// outline the image is known to be dark [px].
Fit refine(const cv::Mat1f& image, const CoarseImage& classes, const std::vector<OutlinePoint>& outline,
           const PlaneMap& start, Freedom freedom, double reach, double background) {
  Fit fit;
  fit.map = start;
  const Freedom while_far = freedom == Freedom::affine ? Freedom::similarity : freedom;
  for (; reach > 8.0; reach *= 0.7)
    for (int i = 0; i < 3; ++i) fit = step(image, classes, outline, fit.map, while_far, {1.5 * reach, reach}, reach);
  const Reach close{background, 8.0};
  for (double window : {4.0, 3.0, 2.0})
    for (int i = 0; i < 4; ++i)
      fit = step(image, classes, outline, fit.map, window > 3.5 ? while_far : freedom, close, window);
  return fit;
}

/// The last steps: edges beyond four times the median distance do not count any more. Their number is of those within 2
/// px.
Fit polish(const cv::Mat1f& image, const CoarseImage& classes, const std::vector<OutlinePoint>& outline, Fit fit,
           Freedom freedom, double background) {
  const Reach close{background, 8.0};
  for (int i = 0; i < 8; ++i)
    fit = step(image, classes, outline, fit.map, freedom, close, std::clamp(5.0 * fit.median, 0.75, 2.0));
  const PlaneMap map = fit.map;
  fit = step(image, classes, outline, map, freedom, close, 2.0);
  fit.map = map;
  return fit;
}

bool better(const Fit& a, const Fit& b) { return a.agreeing != b.agreeing ? a.agreeing > b.agreeing : a.rms < b.rms; }

/// How far out of the outline the image is known to be dark [px]: less in narrow holes.
double background_around(const std::vector<Contour>& contours, double pixel) {
  double background = 14.0;
  for (const auto& contour : contours) {
    double across = std::numeric_limits<double>::infinity();
    for (const Vector2d& axis :
         {Vector2d(1, 0), Vector2d(0, 1), Vector2d(1, 1).normalized(), Vector2d(1, -1).normalized()}) {
      double least = std::numeric_limits<double>::infinity(), most = -least;
      for (const auto& point : contour) {
        least = std::min(least, axis.dot(point));
        most = std::max(most, axis.dot(point));
      }
      across = std::min(across, most - least);
    }
    background = std::min(background, std::max(5.0, 0.6 * across / pixel));
  }
  return background;
}

cv::Mat1f smoothed(const cv::Mat1f& image) {
  cv::Mat1f smooth;
  cv::GaussianBlur(image, smooth, cv::Size(0, 0), 0.7, 0.7, cv::BORDER_REPLICATE);
  return smooth;
}

cv::Mat1f matrix_of(const Image& image) {
  cv::Mat1f matrix(image.height, image.width);
  std::copy(image.grey.begin(), image.grey.end(), matrix.begin());
  return matrix;
}

Placement placement_of(const Fit& fit, bool flip) {
  Placement placement;
  describe(fit.map, flip, placement);
  placement.rms = fit.rms;
  placement.agreeing = fit.agreeing;
  placement.visible = fit.visible;
  placement.tried = fit.tried;
  return placement;
}

Placement place_bright_specimen(const cv::Mat1f& image, const std::vector<Contour>& contours, const Vector2d& low,
                                const Vector2d& high, const OutlineOptions& options) {
  const CoarseImage coarse = coarse_image(image);
  const auto candidates = search(coarse, contours, low, high, options);
  if (candidates.empty())
    throw InputError(
        "place.auto", "no place in the reference image at which its edges follow the mesh's outline",
        "an image that shows the specimen's sides against its background, the right pixel_size and mesh, or "
        "place.points");
  const cv::Mat1f smooth = smoothed(image);
  const Freedom freedom = options.affine ? Freedom::affine : options.pixel_size ? Freedom::rigid : Freedom::similarity;
  const double pixel = candidates.front().pixel_size;
  const double background = background_around(contours, pixel);
  Fit best;
  const auto few = sample_outline(contours, 8.0 * pixel, 6.0 * pixel),
             many = sample_outline(contours, 2.0 * pixel, 6.0 * pixel);
  if (few.empty() || many.empty())
    throw InputError("place.auto", "an outline of a few pixels", "an image that shows the specimen larger");
  for (const auto& candidate : candidates) {
    PlaneMap map;
    map.linear = similarity(candidate.pixel_size, candidate.rotation, options.flip);
    map.offset = candidate.centre - map.linear * (0.5 * (low + high));
    const Fit fit = refine(smooth, coarse, few, map, freedom, std::max(8.5, 3.0 * coarse.factor), background);
    if (better(fit, best)) best = fit;
  }
  best = polish(smooth, coarse, many, best, freedom, background);

  const Placement placement = placement_of(best, options.flip);
  const auto complain = [&](const std::string& found) {
    throw InputError("place.auto", found, "a mesh of this specimen, the right pixel_size, or place.points");
  };
  if (best.agreeing < 20 || best.visible < 0.2 * best.tried || best.agreeing < 0.6 * best.visible ||
      best.rms > options.largest_rms)
    complain(fmt::format("an edge at {} of {} points of the mesh's outline, {} of them within 2 px (rms {:.2f} px)",
                         best.visible, best.tried, best.agreeing, best.rms));
  for (std::size_t c = 0; c < contours.size(); ++c)
    if (signed_area(contours[c]) < 0.0 && best.agreeing_of_contour[c] < 0.4 * best.tried_of_contour[c])
      complain(fmt::format("no hole in the image where the mesh has one: an edge at {} of {} points",
                           best.agreeing_of_contour[c], best.tried_of_contour[c]));
  if (best.stiffness < 2e-3)
    throw InputError("place.auto", "an outline along which the mesh can slide",
                     "an outline with a hole, a fillet or an end in the image, or place.points");
  return placement;
}

}  // namespace

Placement place_by_outline(const Image& reference, const std::vector<Contour>& contours,
                           const OutlineOptions& options) {
  Vector2d low = Vector2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  for (const auto& contour : contours)
    for (const auto& point : contour) {
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
  if (!((high - low).minCoeff() > 0.0))
    throw InputError("place.auto", "a mesh without an outline", "a mesh with an area");
  if (options.pixel_size && !(*options.pixel_size > 0.0))
    throw InputError("pixel_size", fmt::format("{}", *options.pixel_size), "a positive number [length/px]");
  if (reference.width < 16 || reference.height < 16)
    throw InputError("place.auto", fmt::format("an image of {} x {} px", reference.width, reference.height),
                     "a picture of the specimen");
  if (options.pixel_size) {
    const Vector2d extent = (high - low) / *options.pixel_size;
    const double largest = std::max(reference.width, reference.height),
                 smallest = std::min(reference.width, reference.height);
    if (extent.maxCoeff() > 1.45 * largest || extent.minCoeff() > 1.05 * std::hypot(largest, smallest))
      throw InputError("place.auto",
                       fmt::format("a mesh of {:.0f} x {:.0f} px (by pixel_size) on an image of {} x {} px", extent.x(),
                                   extent.y(), reference.width, reference.height),
                       "a mesh that lies on the image");
  }

  const cv::Mat1f image = matrix_of(reference);
  Placement placement;
  try {
    placement = place_bright_specimen(image, contours, low, high, options);
  } catch (const InputError& of_bright) {
    try {
      placement = place_bright_specimen(reference.dynamic() - image, contours, low, high, options);
    } catch (const InputError&) {
      throw of_bright;
    }
  }
  std::vector<Eigen::Vector3d> points;
  for (const auto& contour : contours)
    for (const auto& point : contour) points.emplace_back(point.x(), point.y(), 0.0);
  if (auto mistakes = check_on_image(placement.camera, points, reference.header(), "place.auto"); !mistakes.empty())
    throw InputError(std::move(mistakes));
  return placement;
}

std::optional<Placement> outline_near(const Image& reference, const std::vector<Contour>& contours,
                                      const TelecentricCamera& camera, double reach) {
  const PlaneMap start{camera.linear.leftCols<2>(), camera.offset};
  const double pixel = 1.0 / std::sqrt(std::abs(start.linear.determinant())),
               background = background_around(contours, pixel);
  const auto few = sample_outline(contours, 8.0 * pixel, 6.0 * pixel),
             many = sample_outline(contours, 2.0 * pixel, 6.0 * pixel);
  if (few.empty() || many.empty()) return {};
  Fit best;
  const cv::Mat1f image = matrix_of(reference);
  for (const cv::Mat1f& seen : {image, cv::Mat1f(reference.dynamic() - image)}) {
    const CoarseImage coarse = coarse_image(seen);
    const cv::Mat1f smooth = smoothed(seen);
    const Fit fit =
        polish(smooth, coarse, many, refine(smooth, coarse, few, start, Freedom::similarity, reach, background),
               Freedom::similarity, background);
    if (better(fit, best)) best = fit;
  }
  constexpr double clear = 1.0;  // [px]
  if (best.agreeing < 20 || best.visible < 0.2 * best.tried || best.agreeing < 0.7 * best.visible || best.rms > clear ||
      best.stiffness < 2e-3)
    return {};
  for (std::size_t c = 0; c < contours.size(); ++c)
    if (signed_area(contours[c]) < 0.0 && best.agreeing_of_contour[c] < 0.5 * best.tried_of_contour[c]) return {};
  return placement_of(best, start.linear.determinant() > 0.0);
}

}  // namespace imic3d::imaging
