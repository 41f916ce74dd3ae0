#include "fields.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <memory>
#include <numbers>
#include <optional>

#include "imic3d/app/observation.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/loop/surface_modes.hpp"

namespace imic3d::app {

namespace {

using Points = Eigen::Matrix<double, Eigen::Dynamic, 2>;

/// From the tables to the specimen: x = R (x_table - origin) scale, the y axis turned where it points downwards.
struct Axes {
  Eigen::Matrix2d linear;
  Eigen::RowVector2d origin;

  explicit Axes(const io::FieldsCase& fields) : origin(fields.origin[0], fields.origin[1]) {
    const double turn = fields.rotation * std::numbers::pi / 180.0;
    linear = fields.scale * Eigen::Rotation2Dd(-turn).toRotationMatrix() *
             Eigen::Vector2d(1.0, fields.y_down ? -1.0 : 1.0).asDiagonal();
  }
  [[nodiscard]] Points place(const Points& at) const { return (at.rowwise() - origin) * linear.transpose(); }
  [[nodiscard]] Points displacement(const Points& d) const { return d * linear.transpose(); }
};

/// Least squares of one component on the nodes.
struct LeastSquares {
  Eigen::SparseMatrix<double> N;  // values of the nodes' field at the points [points x nodes]
  Eigen::SparseMatrix<double> M;  // [nodes x nodes]
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor;
  double inflation = 1.0;
  [[nodiscard]] Eigen::MatrixXd operator()(const Eigen::MatrixXd& values) const {
    return factor.solve(N.transpose() * values / inflation);
  }
};

/// Two components a node, interleaved [2 nodes x 1], of two columns [nodes x 2], and back.
Eigen::VectorXd interleaved(const Points& U) { return Eigen::MatrixXd(U.transpose()).reshaped(); }
Points columns_of(const Eigen::VectorXd& U) {
  return Eigen::Map<const Eigen::Matrix2Xd>(U.data(), 2, U.size() / 2).transpose();
}

/// Points that every table has [points], in the axes of the specimen, within its face; displacements of each frame
/// there.
struct Common {
  Points at;
  std::vector<Points> displacement;
  Eigen::SparseMatrix<double> N;
};

Common common_points(const io::FieldsCase& fields, const mesh::Mesh& face) {
  const Axes axes(fields);
  // Places are compared to a millionth of the field.
  const auto& first = fields.tables.front();
  const double unit =
      1e-6 * std::max(1e-300, (first.at.colwise().maxCoeff() - first.at.colwise().minCoeff()).maxCoeff());
  const auto key = [&](const Points& at, Eigen::Index k) {
    return std::pair(std::llround(at(k, 0) / unit), std::llround(at(k, 1) / unit));
  };
  // of each point in the tables that have it
  std::map<std::pair<long long, long long>, std::vector<Eigen::Index>> rows;
  for (Eigen::Index k = 0; k < first.at.rows(); ++k) rows[key(first.at, k)] = {k};
  for (std::size_t f = 1; f < fields.tables.size(); ++f)
    for (Eigen::Index k = 0; k < fields.tables[f].at.rows(); ++k)
      if (const auto found = rows.find(key(fields.tables[f].at, k)); found != rows.end() && found->second.size() == f)
        found->second.push_back(k);
  std::vector<std::vector<Eigen::Index>> kept;
  for (Eigen::Index k = 0; k < first.at.rows(); ++k)
    if (const auto& its = rows[key(first.at, k)]; its.size() == fields.tables.size()) kept.push_back(its);
  if (kept.empty())
    throw InputError("fields.files", fmt::format("no point that stands in all {} tables", fields.tables.size()),
                     "the same points of the reference in every frame");
  std::vector<Eigen::Index> lines;
  for (const auto& its : kept) lines.push_back(its.front());
  const Points all = axes.place(first.at(lines, Eigen::all));
  const Eigen::SparseMatrix<double> N = identification::interpolation(face, all);
  // The nearest element serves points off the mesh: such a point is not where its weights say.
  const Points there = N * Points(face.nodes.leftCols<2>());
  const double tolerance = 1e-6 * std::sqrt(mesh::plane_area(face));
  std::vector<Eigen::Index> inside;
  for (Eigen::Index k = 0; k < all.rows(); ++k)
    if ((there.row(k) - all.row(k)).norm() < tolerance) inside.push_back(k);
  const auto lost = first.at.rows() - all.rows();
  spdlog::info("fields: {} points on the specimen; {} beside it, {} lost in some frame", inside.size(),
               all.rows() - static_cast<Eigen::Index>(inside.size()), lost);
  if (const Eigen::Index least = std::max<Eigen::Index>(3, face.nodes.rows() / 4);
      static_cast<Eigen::Index>(inside.size()) < least)
    throw InputError(
        "fields",
        fmt::format("{} of {} points on the specimen: they lie from ({:.4g}, {:.4g}) to ({:.4g}, {:.4g}), the mesh "
                    "from ({:.4g}, {:.4g}) to ({:.4g}, {:.4g})",
                    inside.size(), all.rows(), all.col(0).minCoeff(), all.col(1).minCoeff(), all.col(0).maxCoeff(),
                    all.col(1).maxCoeff(), face.nodes.col(0).minCoeff(), face.nodes.col(1).minCoeff(),
                    face.nodes.col(0).maxCoeff(), face.nodes.col(1).maxCoeff()),
        fmt::format(
            "at least {}, a quarter of the mesh's nodes: scale, origin, rotation, y_down that bring them onto it",
            least));
  Common result{all(inside, Eigen::all), {}, {}};
  Eigen::SparseMatrix<double, Eigen::RowMajor> by_row = N, chosen(static_cast<Eigen::Index>(inside.size()), N.cols());
  for (std::size_t i = 0; i < inside.size(); ++i)
    chosen.middleRows(static_cast<Eigen::Index>(i), 1) = by_row.middleRows(inside[i], 1);
  result.N = chosen;
  for (std::size_t f = 0; f < fields.tables.size(); ++f) {
    Points d(result.at.rows(), 2);
    for (std::size_t i = 0; i < inside.size(); ++i)
      d.row(static_cast<Eigen::Index>(i)) =
          fields.tables[f].displacement.row(kept[static_cast<std::size_t>(inside[i])][f]);
    result.displacement.push_back(axes.displacement(d));
  }
  return result;
}

/// Points that are said not to have moved at all, though those about them have, were lost: some programs write 0.
void refuse_zeros(const io::FieldsCase& fields, const Common& points, const std::vector<Points>& nodal) {
  constexpr double beside = 8.0;
  std::vector<Mistake> mistakes;
  for (std::size_t f = 0; f < nodal.size(); ++f) {
    const Eigen::VectorXd off = (points.displacement[f] - points.N * nodal[f]).rowwise().norm();
    const double usual = median(std::vector<double>(off.begin(), off.end()));
    int zeros = 0;
    Eigen::Index first = 0;
    for (Eigen::Index k = off.size() - 1; k >= 0; --k)
      if (points.displacement[f].row(k).isZero(0.0) && off[k] > beside * usual) ++zeros, first = k;
    if (zeros > 0)
      mistakes.push_back(
          {fields.files[f].string(),
           fmt::format("{} point{} with a displacement of 0, 0, the first at ({:.4g}, {:.4g}), among others "
                       "that move: were they lost?",
                       zeros, zeros == 1 ? "" : "s", points.at(first, 0), points.at(first, 1)),
           "nan, no row, or a column that says so (fields.columns.valid) where a point was lost"});
  }
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
}

/// Where no points are near, the ends above all, the measured displacement would be an extrapolation.
void check_cover(const Points& at, double distance, const identification::Specimen& specimen) {
  for (const char* end : {"held", "loaded"}) {
    const auto& nodes = std::string(end) == "held" ? specimen.held : specimen.loaded;
    double furthest = 0.0;
    Eigen::RowVector2d there = Eigen::RowVector2d::Zero();
    for (int node : nodes) {
      const Eigen::RowVector2d place = specimen.volume.nodes.row(node).head<2>();
      const double off = std::sqrt((at.rowwise() - place).rowwise().squaredNorm().minCoeff());
      if (off > furthest) furthest = off, there = place;
    }
    if (furthest > 3.0 * distance)
      throw InputError(
          "specimen.mesh",
          fmt::format("its end `{}` is {:.3g} from the nearest point of the fields, which are {:.3g} apart, at its "
                      "node ({:.4g}, {:.4g})",
                      end, furthest, distance, there[0], there[1]),
          "a mesh whose ends, which the measured displacement drives, lie within the points");
  }
}

/// Of the frame at a place of the tables; its number where there is no record.
double time_of_field(const io::Case& test, std::size_t place) {
  return test.loads.records.empty() ? static_cast<double>(test.fields->frames[place])
                                    : test.load(static_cast<int>(place)).time;
}

/// That of the reference's own field, of zeros, if there is one; else what is recorded last before the first frame, or
/// as long before it as the second one is after it.
double time_of_field_reference(const io::Case& test, std::optional<std::size_t> own, double start) {
  const auto& frames = test.fields->frames;
  const auto time = [&](std::size_t place) { return time_of_field(test, place); };
  if (own) return std::min(time(*own), start);
  double reference = frames.size() > 1 ? time(0) - (time(1) - time(0)) : start;
  for (const auto& record : test.loads.records)
    if (record.frame < frames.front()) reference = record.time;
  return std::min(reference, start);
}

/// Correlation between what a point and its nearest neighbour err by at rest, about a uniform motion of all, and how
/// far apart they are; 0 where it is less than a tenth, or none beyond chance.
std::pair<double, double> correlation_at_rest(const Common& points, const std::vector<std::size_t>& at_rest) {
  const Eigen::Index count = points.at.rows(), every = std::max<Eigen::Index>(1, count / 1000);
  Eigen::MatrixXd affine(count, 3);
  affine << Eigen::VectorXd::Ones(count), points.at;
  std::vector<std::pair<Eigen::Index, Eigen::Index>> pairs;
  std::vector<double> apart;
  for (Eigen::Index k = 0; k < count; k += every) {
    Eigen::VectorXd squares = (points.at.rowwise() - points.at.row(k)).rowwise().squaredNorm();
    squares[k] = INFINITY;
    Eigen::Index nearest = 0;
    apart.push_back(std::sqrt(squares.minCoeff(&nearest)));
    pairs.emplace_back(k, nearest);
  }
  double product = 0.0, square = 0.0;
  for (const std::size_t frame : at_rest) {
    const Points& d = points.displacement[frame];
    const Points rest = d - affine * affine.colPivHouseholderQr().solve(Eigen::MatrixXd(d));
    for (const auto& [one, other] : pairs)
      product += rest.row(one).dot(rest.row(other)),
          square += 0.5 * (rest.row(one).squaredNorm() + rest.row(other).squaredNorm());
  }
  const double correlation = square > 0.0 ? product / square : 0.0;
  const double least = std::max(0.1, 4.0 / std::sqrt(static_cast<double>(pairs.size())));
  return {correlation > least ? correlation : 0.0, median(apart)};
}

constexpr int most_references = 100;

/// Of frames at rest: what they differ by is their own noise, what they have in common that of the reference, too.
struct AtRest {
  double frames;
  double squares;  // of what they differ from their mean by, summed, in units of a number's variance
  double of_mean;

  /// `still`: their displacements [unknowns x frames]; `variance` of a displacement over that of a number.
  AtRest(const Eigen::MatrixXd& still, const std::function<double(const Eigen::VectorXd&)>& variance)
      : frames(static_cast<double>(still.cols())), squares(0.0), of_mean(0.0) {
    if (still.cols() == 0) return;
    const Eigen::VectorXd mean = still.rowwise().mean();
    for (const auto& frame : still.colwise()) squares += variance(frame - mean);
    of_mean = variance(mean);
  }
  /// Variance of a frame by itself; two and more of them.
  [[nodiscard]] double of_frame() const { return squares / (frames - 1.0); }

  /// Images that were averaged to the reference; one, if there are not two frames.
  [[nodiscard]] int averaged_references() const {
    if (frames < 2.0) return 1;
    const double common = of_mean - of_frame() / frames;
    return static_cast<int>(std::clamp(std::round(of_frame() / std::max(common, of_frame() / most_references)), 1.0,
                                       static_cast<double>(most_references)));
  }
  /// Whether the reference is the mean of the frames themselves: as independent images they would have in common what
  /// noise leaves of their own mean, and its noise.
  [[nodiscard]] bool are_the_reference() const { return frames >= 2.0 && of_mean < 0.5 * of_frame() / frames; }

  /// Noise of a frame, the reference being the mean of so many other images.
  [[nodiscard]] double noise(int references) const {
    return std::sqrt((squares + frames * of_mean / (1.0 + frames / references)) / frames);
  }
};

}  // namespace

loop::FieldData imported_fields(const io::Case& test, const identification::Specimen& specimen) {
  const io::FieldsCase& fields = *test.fields;
  const mesh::Mesh& face = specimen.surface.mesh;
  Common points = common_points(fields, face);
  const auto count = points.at.rows();
  const double area = mesh::plane_area(face), distance = std::sqrt(area / static_cast<double>(count));
  check_cover(points.at, distance, specimen);

  // Frames: a field of zeros was not measured, it is the reference's own; those at rest tell the noise, the others are
  // judged.
  std::vector<std::size_t> judged, at_rest;
  std::optional<std::size_t> reference;
  // The last one that a stage uses: those behind it take no part, but for those that are held out.
  int last = test.identify.stages.empty() ? fields.frames.back() : 0;
  for (const auto& stage : test.identify.stages)
    if (!stage.frames.empty()) last = std::max(last, stage.frames.back());
  for (std::size_t f = 0; f < fields.frames.size(); ++f) {
    const bool rests = std::binary_search(fields.at_rest.begin(), fields.at_rest.end(), fields.frames[f]);
    const auto& held_out = test.identify.held_out;
    if (!rests && fields.frames[f] > last && !std::binary_search(held_out.begin(), held_out.end(), fields.frames[f]))
      continue;
    if (points.displacement[f].isZero(0.0)) {
      spdlog::log(judged.empty() ? spdlog::level::info : spdlog::level::warn,
                  "fields: frame {} is left out: its displacement is 0 at all points{}", fields.frames[f],
                  judged.empty() ? ", as in the reference" : "");
      if (judged.empty()) reference = f;
      continue;
    }
    (rests ? at_rest : judged).push_back(f);
  }
  if (judged.empty())
    throw InputError("fields.at_rest", "every frame that has a displacement",
                     "frames under load beside them, of which a stage uses some");
  const auto [together, apart] = correlation_at_rest(points, at_rest);
  double shared = fields.subset * fields.scale;  // length over which points err together
  if (together > 0.0) {
    // As means over squares do, or a Gaussian filter of the same sum, whichever is less.
    shared =
        std::max(shared, apart * std::min(1.0 / (1.0 - together), std::sqrt(-std::numbers::pi / std::log(together))));
    spdlog::info("fields: points that are {:.3g} {} apart err together (correlation {:.2f} at rest)", apart,
                 test.units.length, together);
  }
  auto squares = std::make_shared<LeastSquares>();
  squares->N = points.N;
  squares->inflation = std::pow(std::max(1.0, shared / distance), 2);
  const double density = static_cast<double>(count) / area / squares->inflation;  // of M, per area
  const auto weight = [density](double wave) { return density * std::pow(wave / (2.0 * std::numbers::pi), 4); };
  const Eigen::SparseMatrix<double> NtN = points.N.transpose() * points.N / squares->inflation,
                                    curvature = correlation::curvature_energy(face, 1);
  squares->M = NtN + weight(2.0 * distance) * curvature;
  squares->factor.compute(squares->M);
  // What a mean over a square of a side w leaves of the noise of a wave falls to half at 2.26 w.
  const Eigen::SparseMatrix<double> M =
      NtN + weight(std::max(2.0 * distance, together > 0.0 ? 2.26 * shared : 0.0)) * curvature;

  std::vector<Points> nodal;
  for (const auto& d : points.displacement) nodal.emplace_back((*squares)(d));
  refuse_zeros(fields, points, nodal);

  loop::FieldData data;
  data.faces = {{.surface = face, .M = identification::of_components(M)}};
  // Numbers of a component that the nodes take from the points; what holds the shortest waves takes the others.
  const double followed = squares->factor.solve(Eigen::MatrixXd(NtN)).trace();
  // Less what a clamped specimen does between two pictures: it moves and strains uniformly.
  Eigen::MatrixXd affine(face.nodes.rows(), 3);
  affine << Eigen::VectorXd::Ones(face.nodes.rows()), face.nodes.leftCols<2>();
  const Eigen::MatrixXd weighted = squares->M * affine,
                        motion = solve_symmetric(affine.transpose() * weighted, weighted.transpose());
  std::function<double(const Eigen::VectorXd&)> variance_at_rest = [squares, affine, motion,
                                                                    followed](const Eigen::VectorXd& frame) {
    const Points u = columns_of(frame);
    const Eigen::MatrixXd rest = u - affine * (motion * u);
    return rest.cwiseProduct(squares->M * rest).sum() / (2.0 * std::max(1.0, followed - 3.0));
  };
  data.at_rest = static_cast<int>(at_rest.size());
  Eigen::MatrixXd still(2 * face.nodes.rows(), data.at_rest);
  for (std::size_t k = 0; k < at_rest.size(); ++k)
    still.col(static_cast<Eigen::Index>(k)) = interleaved(nodal[at_rest[k]]);
  // Points that share pixels, or that another program smoothed, err together: less from one to the next, more in the
  // smooth modes that are judged. Where frames at rest show that, these tell the noise.
  if (together > 0.0)
    variance_at_rest = [affine, motion, modes = loop::SurfaceModes(face, data.faces.front().M, test.loop.modes)](
                           const Eigen::VectorXd& frame) {
      const Points u = columns_of(frame), rest = u - affine * (motion * u);
      const Eigen::VectorXd numbers = modes.numbers(interleaved(rest));
      return numbers.squaredNorm() / std::max(1.0, static_cast<double>(numbers.size()) - 6.0);
    };
  const AtRest rest(still, variance_at_rest);
  const bool of_rest = rest.are_the_reference();
  const int references = fields.references ? *fields.references : of_rest ? data.at_rest : rest.averaged_references();
  // Displacements count from the mean of the images of the reference and of those at rest: what noise the reference has
  // is in all frames.
  data.references = of_rest ? references : references + data.at_rest;
  Points origin = Points::Zero(face.nodes.rows(), 2);
  if (data.at_rest > 0 && !of_rest) origin = columns_of(still.rowwise().sum() / data.references);
  const auto variances = [](int images) { return 1.0 + 1.0 / images; };  // of frame and reference, over the frame's
  if (fields.noise) {
    data.noise = *fields.noise * fields.scale / std::sqrt(variances(references));
  } else if (!at_rest.empty()) {
    const auto noise_of = [of_rest](const AtRest& frames, int images) {
      return of_rest ? std::sqrt(frames.of_frame()) : frames.noise(images);
    };
    data.noise = noise_of(rest, references);
    data.noise_at_rest = [noise_of, variance_at_rest, images = data.references](const Eigen::MatrixXd& U) {
      return noise_of(AtRest(U, variance_at_rest), images);
    };
  } else {
    // What the nodes cannot follow, in the frame where that is least: noise of the frame and of the reference.
    double least = INFINITY;
    for (std::size_t f : judged)
      least = std::min(least, (points.displacement[f] - points.N * nodal[f]).squaredNorm() /
                                  (2.0 * std::max(1.0, static_cast<double>(count) - followed)));
    data.noise = std::sqrt(least / variances(references));
  }
  spdlog::info("fields: {} frames, points {:.3g} {} apart, noise of a displacement {:.3g} {}{}", judged.size(),
               distance, test.units.length, data.noise * std::sqrt(variances(references)), test.units.length,
               of_rest           ? "; the reference is the mean of the frames at rest"
               : references == 1 ? ""
                                 : fmt::format("; {}the reference is the mean of {}{} images",
                                               fields.references ? "" : "by the frames at rest ", references,
                                               !fields.references && references == most_references ? " or more" : ""));

  const auto frames = static_cast<Eigen::Index>(judged.size());
  data.displacement.resize(2 * face.nodes.rows(), frames), data.time.resize(frames), data.force.setZero(frames);
  for (Eigen::Index t = 0; t < frames; ++t) {
    const auto f = judged[static_cast<std::size_t>(t)];
    data.displacement.col(t) = interleaved(nodal[f] - origin);
    data.frames.push_back(fields.frames[f]);
    data.time[t] = fields.frames[f];
    if (test.loads.records.empty()) continue;
    const auto& load = test.load(static_cast<int>(f));
    data.time[t] = load.time, data.force[t] = load.force;
  }
  if (std::includes(test.identify.held_out.begin(), test.identify.held_out.end(), data.frames.begin(),
                    data.frames.end()))  // but for that of the reference, of zeros
    throw InputError("identify.held_out", "every frame under load", "frames beside them that are fitted");
  data.start_time = test.loads.records.empty() ? 0.0 : data.time[0];
  for (const auto& record : test.loads.records)
    if (record.frame < data.frames.front()) data.start_time = record.time;
  if (data.start_time >= data.time[0] && frames > 1) data.start_time = data.time[0] - (data.time[1] - data.time[0]);
  const int others = of_rest ? 0 : references;
  data.reference_time = others * time_of_field_reference(test, reference, data.start_time);
  for (const std::size_t f : at_rest) data.reference_time += time_of_field(test, f);
  data.reference_time = std::min(data.reference_time / (others + data.at_rest), data.start_time);
  data.force_noise = INFINITY;
  if (!test.loads.records.empty()) {
    Eigen::VectorXd force(std::ssize(at_rest));
    std::transform(at_rest.begin(), at_rest.end(), force.begin(),
                   [&](std::size_t f) { return test.load(static_cast<int>(f)).force; });
    data.force_noise = test.loads.noise.value_or(force_noise(force, data.force.cwiseAbs().maxCoeff()));
    data.force_at_rest = reading_at_rest(force, test.loads.noise);
    spdlog::info("fields: noise of the force {:.4g} {} ({})", data.force_noise, test.units.force,
                 test.loads.noise                                        ? "given"
                 : force.size() > 2 && (force.array() != force[0]).any() ? "of the frames at rest"
                                                                         : "a thousandth of the largest");
  }

  auto measure = std::make_shared<correlation::Measure>(
      correlation::Measure{.surface = face, .dofs_per_node = 2, .M = data.faces.front().M, .smoothing_weight = weight});
  const Eigen::VectorXd touched = Eigen::VectorXd::Ones(specimen.displacement_from_surface.rows()).transpose() *
                                  specimen.displacement_from_surface.cwiseAbs();
  std::vector<int> ends;
  for (Eigen::Index i = 0; i < face.nodes.rows(); ++i)
    if (touched[2 * i] + touched[2 * i + 1] > 0.0) ends.push_back(static_cast<int>(i));
  std::vector<double> cut_offs;
  const double longest = test.identify.boundary_smoothing.value_or(longest_cut_off(specimen));
  if (longest > 0.0)
    cut_offs = correlation::undersmoothed(
        correlation::cut_offs_of_least_error(
            *measure, data.displacement, ends,
            Eigen::VectorXd::Constant(data.displacement.cols(), data.noise * std::sqrt(variances(data.references))),
            longest),
        longest);
  data.smooth = [measure, cut_offs](Eigen::MatrixXd field) {
    return correlation::smooth(*measure, std::move(field), cut_offs);
  };
  data.driving = data.smooth(data.displacement);

  const Points at = points.at;
  const double subset = fields.subset * fields.scale;
  data.correlate = [squares, at, subset](const identification::Specimen& made, const Eigen::MatrixXd& U) {
    const Eigen::SparseMatrix<double> sample = identification::means_over_squares(made.surface.mesh, at, subset);
    Eigen::MatrixXd seen(2 * squares->N.cols(), U.cols());
    for (Eigen::Index t = 0; t < U.cols(); ++t) seen.col(t) = interleaved((*squares)(sample * columns_of(U.col(t))));
    return seen;
  };
  data.images = false;
  data.faces.front().pixels = Axes(fields).linear.inverse();
  if (!fields.y_down) data.faces.front().pixels.row(1) *= -1.0;  // pictures have their rows downwards
  data.faces.front().axis_of_lens = 0.5 * (at.colwise().minCoeff() + at.colwise().maxCoeff()).transpose();
  return data;
}

}  // namespace imic3d::app
