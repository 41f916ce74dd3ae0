// What the identification is given of an observation: the record, the displacement of the driven ends and its noise,
// the images.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "imic3d/app/observation.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/io/results_file.hpp"
#include "imic3d/loop/statistics.hpp"
#include "rig.hpp"

namespace imic3d::app {

namespace {
using identification::Face;
}

namespace {

correlation::Measure measure_of(const ObservedFace& face) {
  return correlation::measured_by(face.dic->cameras(), face.dic->held());
}

/// White noise of camera `c` of a face that moves a displacement as much as its own [grey level].
double motion_noise(const Observation& observation, const ObservedFace& face, std::size_t c) {
  return observation.camera_noise[static_cast<std::size_t>(face.rig->cameras[c])] *
         face.dic->motion_noise(static_cast<int>(c));
}

/// The same of a face's cameras together: of the b that the correlation's weights make, sum of w_c^2 sigma_c^2 M_c over
/// sum of w_c M_c. What the correlation leaves beyond noise counts like it.
double noise_of_face(const Observation& observation, const ObservedFace& face) {
  const auto& cameras = face.dic->cameras();
  double squares = 0.0, sum = 0.0;
  for (int c = 0; c < cameras.size(); ++c) {
    const double size = cameras.size() == 1 ? 1.0 : cameras[c].M().diagonal().sum();
    squares += std::pow(cameras.weight(c) * motion_noise(observation, face, static_cast<std::size_t>(c)), 2) * size;
    sum += cameras.weight(c) * size;
  }
  return beyond_noise(observation) * std::sqrt(squares / sum);
}

/// The same of a frame of median noise and the reference together.
double noise_of_pair(const Observation& observation, const ObservedFace& face) {
  return noise_of_face(observation, face) * std::sqrt(1.0 + 1.0 / observation.references);
}

}  // namespace

namespace {
/// The displacement of another `imic3d dic` on the same mesh, face by face, at the frames of the record [as
/// Record::surface_displacement].
Eigen::MatrixXd displacement_of_file(const io::Case& test, const identification::Specimen& specimen,
                                     const std::vector<int>& places, const identification::Record& record) {
  const auto file = io::ResultsFile::open(test.identify.driving);
  const std::string name = "dic/displacement";
  Eigen::Index nodes = 0;
  for (const Face& face : specimen.faces) nodes += face.surface.mesh.nodes.rows();
  const auto shape = file.has(name) ? file.shape(name) : std::vector<std::size_t>{};
  if (shape.size() != 3 || shape[0] < test.frames.size() || static_cast<Eigen::Index>(shape[1]) != nodes ||
      shape[2] != 3)
    throw InputError("identify.driving",
                     fmt::format("{}: {} [{}]", test.identify.driving.string(), name, fmt::join(shape, ", ")),
                     fmt::format("{} [{}, {}, 3], of the same mesh and frames", name, test.frames.size(), nodes));
  Eigen::MatrixXd displacement(record.surface_displacement.rows(), record.surface_displacement.cols());
  for (std::size_t t = 0; t < places.size(); ++t) {
    const auto u = file.read(name, static_cast<std::size_t>(places[t]));
    std::size_t node = 0;
    for (const Face& face : specimen.faces)
      for (Eigen::Index i = 0; i < face.surface.mesh.nodes.rows(); ++i, ++node)
        for (int k = 0; k < face.components; ++k)
          displacement(face.first_unknown + face.components * i + k, static_cast<Eigen::Index>(t)) =
              u[3 * node + static_cast<std::size_t>(k)];
    if (!displacement.col(static_cast<Eigen::Index>(t)).allFinite())
      throw InputError("identify.driving",
                       fmt::format("{}: no displacement at frame {}", test.identify.driving.string(), record.frames[t]),
                       "every frame");
  }
  return displacement;
}

/// The force is that on the loaded end along +axis, so that both grow in one direction until it is largest. Throws
/// InputError where they clearly do not.
void require_one_direction(const Observation& observation, const io::Case& test,
                           const identification::Specimen& specimen, const identification::Record& record) {
  const auto& dofs = specimen.displacement_dofs;
  Eigen::MatrixXd loaded = Eigen::MatrixXd::Zero(2, static_cast<Eigen::Index>(dofs.size())), held = loaded;
  for (std::size_t i = 0; i < dofs.size(); ++i)
    if (dofs[i] % 3 < 2)
      (std::binary_search(specimen.loaded.begin(), specimen.loaded.end(), dofs[i] / 3) ? loaded : held)(
          dofs[i] % 3, static_cast<Eigen::Index>(i)) = 1.0;
  for (auto* end : {&loaded, &held})
    for (auto row : end->rowwise()) row /= std::max(1.0, row.sum());
  const Eigen::MatrixXd apart = (loaded - held) * specimen.displacement_from_surface;
  const Eigen::RowVectorXd elongation = apart.row(specimen.axis);
  const auto& nodes = specimen.volume.nodes;
  const Eigen::Vector2d between =
      (nodes(specimen.loaded, Eigen::all).colwise().mean() - nodes(specimen.held, Eigen::all).colwise().mean())
          .head<2>()
          .transpose();
  const Eigen::MatrixXd moved_apart = apart * record.surface_displacement;
  Eigen::VectorXd length = moved_apart.row(specimen.axis).transpose();
  if (std::abs(between[specimen.axis]) > 0.7 * between.norm())  // along the axis that turns with the specimen
    length = std::copysign(1.0, between[specimen.axis]) *
             ((moved_apart.colwise() + between).colwise().norm().array() - between.norm()).matrix().transpose();
  const auto& reference = test.cameras.front().reference;
  double before = 0.0;
  for (int number : reference) before += test.load(test.index_of(number)).force / static_cast<double>(reference.size());
  Eigen::Index peak = 0;
  (record.force.array() - before).abs().maxCoeff(&peak);
  const auto changes = [&](const Eigen::VectorXd& values, double first) {
    Eigen::VectorXd change = values.head(peak + 1);
    change[0] -= first, change.tail(peak) -= values.head(peak);
    return change;
  };
  const Eigen::VectorXd force = changes(record.force, before), moved = changes(length, 0.0);
  const double sum = force.dot(moved);
  if (sum > -0.25 * force.cwiseProduct(moved).cwiseAbs().sum()) return;
  const double of_length = std::sqrt(2.0) * (elongation * driving_noise(observation)).norm() / 8.0,
               of_force = std::sqrt(2.0) * force_noise(observation, test);  // rms of 64 draws
  if (sum > -4.0 * (of_length * force.norm() + of_force * moved.norm() +
                    of_length * of_force * std::sqrt(static_cast<double>(peak + 1))))
    return;
  const char* axis = specimen.axis == 0 ? "x" : "y";
  throw InputError("loads.force",
                   fmt::format("a change of {:+.4g} {} by frame {}, while specimen.loaded moves against specimen.held "
                               "by {:+.3g} {} along {}",
                               record.force[peak] - before, test.units.force,
                               record.frames[static_cast<std::size_t>(peak)], length[peak], test.units.length, axis),
                   fmt::format("the force on specimen.loaded, positive along +{}: a negative loads.force_scale turns "
                               "its sign, specimen.held and specimen.loaded belong the other way round, or the images "
                               "come in another order than the record's rows",
                               axis));
}

}  // namespace

double time_of(const io::Case& test, int place) {
  return test.loads.records.empty() ? test.frames[static_cast<std::size_t>(place)] : test.load(place).time;
}

double reference_time(const io::Case& test) {
  const auto& frames = test.cameras.front().reference;
  double sum = 0.0;
  for (const int number : frames) sum += time_of(test, test.index_of(number));
  return sum / static_cast<double>(frames.size());
}

identification::Record make_record(Observation& observation, const io::Case& test,
                                   const identification::Specimen& specimen) {
  identification::Record record;
  const auto frames = static_cast<Eigen::Index>(observation.places.size());
  record.time.resize(frames);
  record.force.resize(frames);
  record.surface_displacement.resize(observation.frames.front().displacement.size(), frames);
  for (Eigen::Index t = 0; t < frames; ++t) {
    const int place = observation.places[static_cast<std::size_t>(t)];
    record.frames.push_back(test.frames[static_cast<std::size_t>(place)]);
    record.time[t] = time_of(test, place);
    record.force[t] = test.loads.records.empty() ? 0.0 : test.load(place).force;
    record.surface_displacement.col(t) = observation.frames[static_cast<std::size_t>(t)].displacement;
  }
  record.start_time = time_of(test, observation.places.front() - 1);
  if (!test.loads.records.empty() && test.identify.functional != "equilibrium_gap")
    require_one_direction(observation, test, specimen, record);

  // Noise of single nodes on the ends would strain, and might yield, what lies between them.
  const double longest = test.identify.boundary_smoothing.value_or(longest_cut_off(specimen));
  record.driving = test.identify.driving.empty() ? record.surface_displacement
                                                 : displacement_of_file(test, specimen, observation.places, record);
  if (longest > 0.0) {
    std::vector<double> cut_offs;
    const Eigen::VectorXd of_frames = (frame_noise(observation).array().square() + 1.0 / observation.references).sqrt();
    for (std::size_t k = 0; k < observation.faces.size(); ++k) {
      const Face& face = specimen.faces[k];
      auto& seen = observation.faces[k];
      seen.driving_cut_off = correlation::undersmoothed(
          correlation::cut_offs_of_least_error(measure_of(seen),
                                               record.driving.middleRows(face.first_unknown, face.unknowns()),
                                               seen.ends, noise_of_face(observation, seen) * of_frames, longest),
          longest);
      cut_offs.insert(cut_offs.end(), seen.driving_cut_off.begin(), seen.driving_cut_off.end());
    }
    record.driving = driving_displacement(observation, record.driving);
    std::sort(cut_offs.begin(), cut_offs.end());
    spdlog::info(
        "the ends' displacement is smoothed over {:.3g} to {:.3g} {}, by sqrt(2) less than has the least error that "
        "noise and measured displacement let expect, but for the longest",
        cut_offs.front(), cut_offs.back(), test.units.length);
  }
  record.driving = identification::without_leaning(specimen, std::move(record.driving));
  return record;
}

double longest_cut_off(const identification::Specimen& specimen) {
  const Eigen::VectorXd across = specimen.volume.nodes(specimen.loaded, 1 - specimen.axis);
  return 4.0 * (across.maxCoeff() - across.minCoeff());
}

Eigen::MatrixXd driving_displacement(const Observation& observation, Eigen::MatrixXd displacement) {
  Eigen::Index first = 0;
  for (const auto& face : observation.faces) {
    const Eigen::Index unknowns = face.dic->cameras().unknowns();
    displacement.middleRows(first, unknowns) =
        correlation::smooth(measure_of(face), displacement.middleRows(first, unknowns), face.driving_cut_off);
    first += unknowns;
  }
  return displacement;
}

Eigen::MatrixXd driving_noise(const Observation& observation, int draws) {
  Eigen::Index unknowns = 0;
  for (const auto& face : observation.faces) unknowns += face.dic->cameras().unknowns();
  Eigen::MatrixXd all(unknowns, draws);
  unknowns = 0;
  for (const auto& face : observation.faces) {
    const auto measure = measure_of(face);
    Eigen::MatrixXd noise = correlation::noise_draws(measure, noise_of_pair(observation, face), draws);
    if (auto cut_offs = face.driving_cut_off; !cut_offs.empty()) {
      if (const double cut_off = median(cut_offs); cut_off > 0.0) noise = correlation::smooth(measure, noise, cut_off);
    }
    all.middleRows(unknowns, noise.rows()) = noise;
    unknowns += noise.rows();
  }
  return all;
}

namespace {

/// `part` on the diagonal of `whole`, from its row `first` on.
void put(const Eigen::SparseMatrix<double>& part, Eigen::Index first, std::vector<Eigen::Triplet<double>>& whole) {
  for (int column = 0; column < part.outerSize(); ++column)
    for (Eigen::SparseMatrix<double>::InnerIterator entry(part, column); entry; ++entry)
      whole.emplace_back(static_cast<int>(first + entry.row()), static_cast<int>(first) + column, entry.value());
}

}  // namespace

identification::ImageData make_image_data(const Observation& observation, const io::Case& test) {
  identification::ImageData data;
  std::vector<double> sigma;
  for (const auto& face : observation.faces)
    for (std::size_t c = 0; c < face.rig->views.size(); ++c) sigma.push_back(motion_noise(observation, face, c));
  data.noise = joint_noise(sigma);
  // M and the scale: the trace of each camera's M over the squared scale of its image is that of the squared gradients.
  auto weights = std::make_shared<std::vector<std::vector<double>>>();  // [faces][cameras]
  std::vector<Eigen::Triplet<double>> entries, held;
  Eigen::Index unknowns = 0;
  double gradients = 0.0;
  for (const auto& face : observation.faces) {
    const auto& cameras = face.dic->cameras();
    auto& own = weights->emplace_back();
    for (int c = 0; c < cameras.size(); ++c) {
      own.push_back(sigma.size() == 1
                        ? 1.0
                        : std::pow(data.noise / motion_noise(observation, face, static_cast<std::size_t>(c)), 2));
      const Eigen::VectorXd diagonal = cameras[c].M().diagonal();
      double in_plane = 0.0;
      for (Eigen::Index i = 0; i < diagonal.size(); ++i)
        if (i % cameras.dofs_per_node() < 2) in_plane += diagonal[i];
      gradients += own.back() * in_plane / std::abs(cameras[c].pixels_per_length().determinant());
    }
    put(cameras.sum_of_M(own), unknowns, entries);
    if (const auto continued = face.dic->held(); continued.size() > 0) put(continued, unknowns, held);
    unknowns += cameras.unknowns();
  }
  data.M.resize(unknowns, unknowns);
  data.M.setFromTriplets(entries.begin(), entries.end());
  if (!held.empty()) {
    data.held.resize(unknowns, unknowns);
    data.held.setFromTriplets(held.begin(), held.end());
  }
  data.pixels_per_length = std::sqrt(data.M.diagonal().sum() / gradients);
  // The splines of the frames that this rank judges are kept while they take less than 2 GB.
  auto kept = std::make_shared<std::map<std::pair<int, int>, imaging::BSpline>>();  // of a frame and a camera
  auto size = std::make_shared<std::size_t>(0);
  data.evaluate = [&observation, &test, kept, size, weights, unknowns](int t, const Eigen::VectorXd& displacement,
                                                                       const Communicator& group) {
    constexpr std::size_t budget = 2'000'000'000;
    const auto place = static_cast<std::size_t>(observation.places[static_cast<std::size_t>(t)]);
    identification::ImageEvaluation all{
        .b = Eigen::VectorXd::Zero(unknowns), .squares = 0.0, .pixels = 0.0, .element_rms = {}};
    Eigen::Index first = 0;
    for (std::size_t k = 0; k < observation.faces.size(); ++k) {
      const auto& face = observation.faces[k];
      const auto& cameras = face.dic->cameras();
      Eigen::VectorXd squares = Eigen::VectorXd::Zero(cameras.elements()), pixels = squares;
      for (int c = 0; c < cameras.size(); ++c) {
        const int camera = face.rig->cameras[static_cast<std::size_t>(c)];
        const double weight = (*weights)[k][static_cast<std::size_t>(c)];
        imaging::BSpline fresh;
        const imaging::BSpline* spline = nullptr;
        collectively(group, [&] {
          if (const auto found = kept->find({t, camera}); found != kept->end()) {
            spline = &found->second;
            return;
          }
          fresh = face.dic->spline(imaging::read_image(test.cameras[static_cast<std::size_t>(camera)].images[place]));
          *size += 4UL * static_cast<std::size_t>(fresh.width()) * static_cast<std::size_t>(fresh.height());
          spline = *size < budget ? &kept->emplace(std::pair{t, camera}, std::move(fresh)).first->second : &fresh;
        });
        const auto seen = cameras[c].evaluate(*spline, displacement.segment(first, cameras.unknowns()), group,
                                              correlation::Gradient::reference, correlation::Precision::full,
                                              off_epipolar(observation, k, c, static_cast<std::size_t>(t)));
        all.b.segment(first, cameras.unknowns()) += weight * seen.b;
        all.squares += weight * seen.squares, all.pixels += seen.pixels;
        squares += weight * seen.element_squares, pixels += seen.element_pixels;
      }
      all.element_rms.conservativeResize(all.element_rms.size() + cameras.elements());
      all.element_rms.tail(cameras.elements()) = (squares.array() / pixels.array().max(1.0)).sqrt();
      first += cameras.unknowns();
    }
    return all;
  };
  return data;
}

namespace {

/// What the load cell reads of the frames of the reference [frames, force].
Eigen::VectorXd readings_of_reference(const io::Case& test) {
  const auto& reference = test.cameras.front().reference;
  Eigen::VectorXd force(std::ssize(reference));
  std::transform(reference.begin(), reference.end(), force.begin(),
                 [&](int number) { return test.load(test.index_of(number)).force; });
  return force;
}

}  // namespace

std::optional<loop::FieldData::Reading> reading_at_rest(const Eigen::VectorXd& force,
                                                        const std::optional<double>& noise) {
  const auto readings = static_cast<double>(force.size());
  if (noise && readings > 0) return loop::FieldData::Reading{force.mean(), *noise / std::sqrt(readings)};
  if (readings < 3 || (force.array() == force[0]).all()) return {};
  const double of_few = loop::normal_as_student(off_zero, readings - 1.0) / off_zero;
  return loop::FieldData::Reading{force.mean(), of_few * force_noise(force, 0.0) / std::sqrt(readings)};
}

std::optional<loop::FieldData::Reading> force_at_rest(const io::Case& test) {
  if (test.loads.records.empty()) return {};
  return reading_at_rest(readings_of_reference(test), test.loads.noise);
}

std::string doubt_of_zero(const std::optional<loop::FieldData::Reading>& at_rest, const io::Case& test) {
  const bool declared = test.effects.contains("force_zero") || test.effects.contains("preload");
  if (declared || !at_rest || !(std::abs(at_rest->value) > off_zero * at_rest->deviation)) return {};
  return fmt::format(
      "the load record reads {:.4g} +- {:.2g} {} while the reference was taken, where displacement and "
      "simulated force are zero: a zero of the load cell, or a load that the specimen bore already",
      at_rest->value, at_rest->deviation, test.units.force);
}

double force_noise(const Eigen::VectorXd& at_rest, double largest) {
  if (at_rest.size() > 2)
    if (const double squares = (at_rest.array() - at_rest.mean()).square().sum(); squares > 0.0)
      return std::sqrt(squares / static_cast<double>(at_rest.size() - 1));
  return 1e-3 * largest;
}

double force_noise(const Observation& observation, const io::Case& test) {
  if (test.loads.records.empty()) return INFINITY;
  if (test.loads.noise) return *test.loads.noise;
  double largest = 0.0;
  for (int place : observation.places) largest = std::max(largest, std::abs(test.load(place).force));
  return force_noise(readings_of_reference(test), largest);
}

}  // namespace imic3d::app
