#include "imic3d/app/observation.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>
#include <set>

#include "imic3d/core/log.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/imaging/noise.hpp"
#include "imic3d/io/results_file.hpp"
#include "placement.hpp"

namespace imic3d::app {

namespace {
/// Surface nodes of the two ends, where the mesh stops and the specimen goes on.
std::vector<int> nodes_of_ends(const identification::Specimen& specimen) {
  std::set<int> ends;
  const auto& from_surface = specimen.displacement_from_surface;
  for (int column = 0; column < from_surface.outerSize(); ++column)
    if (from_surface.outerIndexPtr()[column + 1] > from_surface.outerIndexPtr()[column]) ends.insert(column / 2);
  return {ends.begin(), ends.end()};
}
}  // namespace

Observation observe(const io::Case& test, const identification::Specimen& specimen) {
  const auto& declared = test.cameras.front();
  Observation observation;
  std::vector<imaging::Image> images;
  int last = -1;
  for (int number : declared.reference) {
    const int place = test.index_of(number);
    images.push_back(imaging::read_image(declared.images[static_cast<std::size_t>(place)]));
    last = std::max(last, place);
  }
  const imaging::Image reference = imaging::average(images);
  observation.references = static_cast<int>(images.size());
  observation.camera = place_camera(declared, specimen.surface.mesh, reference);
  for (int place = last + 1; place < static_cast<int>(test.frames.size()); ++place) observation.places.push_back(place);
  if (observation.places.empty())
    throw InputError("cameras.reference", "no frame comes after the reference", "frames before the last one");

  if (declared.noise) {
    observation.noise = *declared.noise;
    observation.noise_is_measured = true;
  }
  observation.dic = std::make_unique<correlation::GlobalDic>(
      specimen.surface.mesh, observation.camera, reference,
      correlation::DicOptions{.pyramid_levels = test.dic.pyramid_levels,
                              .max_iterations = test.dic.max_iterations,
                              .tolerance = test.dic.tolerance,
                              .regularisation = test.dic.regularisation.value_or(0.0),
                              .low_pass = test.dic.low_pass,
                              .border = test.dic.border,
                              .cut_nodes = nodes_of_ends(specimen),
                              .brightness = test.dic.brightness,
                              .local_brightness = test.dic.local_brightness,
                              .groups = test.dic.groups},
      "cameras.place");
  if (!declared.noise && images.size() > 1) {  // on the specimen: the dark background has another noise
    const auto mask = correlation::footprint(observation.dic->correlation().quadrature(), reference.width, reference.height);
    observation.noise = imaging::noise_of_static_frames(images, &mask);
    observation.noise_is_measured = observation.noise > 0.0;
  }
  return observation;
}

void correlate(Observation& observation, const io::Case& test, const Communicator& world,
               const std::function<void(int, const correlation::DicFrame&)>& done) {
  std::vector<std::filesystem::path> files;
  for (int place : observation.places) files.push_back(test.cameras.front().images[static_cast<std::size_t>(place)]);
  observation.frames = observation.dic->run(world, files, [&](int t, const correlation::DicFrame& frame) {
    if (done) done(observation.places[static_cast<std::size_t>(t)], frame);
  });
  // A frame whose displacement is not known drives no simulation and judges none.
  std::vector<int> kept;
  std::vector<correlation::DicFrame> known;
  std::string left_out;
  for (std::size_t t = 0; t < observation.frames.size(); ++t) {
    if (observation.frames[t].converged && !observation.frames[t].lost) {
      kept.push_back(observation.places[t]);
      known.push_back(std::move(observation.frames[t]));
    } else {
      left_out += fmt::format(" {}", test.frames[static_cast<std::size_t>(observation.places[t])]);
    }
  }
  if (!left_out.empty()) spdlog::warn("frames left out, their correlation was lost or did not converge:{}", left_out);
  if (known.empty()) throw ConvergenceError("no frame could be correlated with the reference");
  observation.places = std::move(kept);
  observation.frames = std::move(known);
  if (observation.noise_is_measured) return;
  // No static frames: what the DIC leaves in its best frame is noise of that frame and of the reference.
  double smallest = INFINITY;
  for (const auto& frame : observation.frames) smallest = std::min(smallest, frame.rms);
  observation.noise = smallest / (observation.dic->noise_response().level * std::sqrt(1.0 + 1.0 / observation.references));
}

std::vector<double> pixels_of_nodes(const Observation& observation, const mesh::Mesh& surface) {
  std::vector<double> pixels;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    const Eigen::Vector2d pixel = observation.camera.project(surface.nodes.row(i).transpose());
    pixels.insert(pixels.end(), {pixel[0], pixel[1]});
  }
  return pixels;
}

std::vector<double> three_components(const Eigen::VectorXd& in_plane) {
  std::vector<double> all;
  for (Eigen::Index i = 0; i < in_plane.size() / 2; ++i) all.insert(all.end(), {in_plane[2 * i], in_plane[2 * i + 1], 0.0});
  return all;
}

namespace {
/// White noise that moves a displacement as much as that of a frame and of the reference [grey level].
double noise_of_pair(const Observation& observation) {
  return observation.noise * observation.dic->motion_noise() * std::sqrt(1.0 + 1.0 / observation.references);
}
}  // namespace

namespace {
/// The displacement of another `imic3d dic` on the same mesh at the frames of the record [2 * surface nodes x frames, length].
Eigen::MatrixXd displacement_of_file(const io::Case& test, const std::vector<int>& places, const identification::Record& record) {
  const auto file = io::ResultsFile::open(test.identify.driving);
  const std::string name = "dic/displacement";
  const Eigen::Index nodes = record.surface_displacement.rows() / 2;
  const auto shape = file.has(name) ? file.shape(name) : std::vector<std::size_t>{};
  if (shape.size() != 3 || shape[0] < test.frames.size() || static_cast<Eigen::Index>(shape[1]) != nodes || shape[2] != 3)
    throw InputError("identify.driving", fmt::format("{}: {} [{}]", test.identify.driving.string(), name, fmt::join(shape, ", ")),
                     fmt::format("{} [{}, {}, 3], of the same mesh and frames", name, test.frames.size(), nodes));
  Eigen::MatrixXd displacement(2 * nodes, record.surface_displacement.cols());
  for (std::size_t t = 0; t < places.size(); ++t) {
    const auto u = file.read(name, static_cast<std::size_t>(places[t]));
    for (Eigen::Index i = 0; i < nodes; ++i)
      displacement.col(static_cast<Eigen::Index>(t)).segment<2>(2 * i) << u[static_cast<std::size_t>(3 * i)], u[static_cast<std::size_t>(3 * i + 1)];
    if (!displacement.col(static_cast<Eigen::Index>(t)).allFinite())
      throw InputError("identify.driving", fmt::format("{}: no displacement at frame {}", test.identify.driving.string(), record.frames[t]), "every frame");
  }
  return displacement;
}
}  // namespace

identification::Record make_record(Observation& observation, const io::Case& test,
                                   const identification::Specimen& specimen) {
  identification::Record record;
  const auto frames = static_cast<Eigen::Index>(observation.places.size());
  record.time.resize(frames);
  record.force.resize(frames);
  record.surface_displacement.resize(observation.frames.front().displacement.size(), frames);
  for (Eigen::Index t = 0; t < frames; ++t) {
    const int place = observation.places[static_cast<std::size_t>(t)];
    const auto& load = test.load(place);
    record.frames.push_back(test.frames[static_cast<std::size_t>(place)]);
    record.time[t] = load.time;
    record.force[t] = load.force;
    record.surface_displacement.col(t) = observation.frames[static_cast<std::size_t>(t)].displacement;
  }
  record.start_time = test.load(observation.places.front() - 1).time;

  // Noise of single nodes on the ends would strain, and might yield, what lies between them: the displacement that drives
  // the simulation is smoothed as far as the noise allows.
  double low = INFINITY, high = -INFINITY;
  for (int node : specimen.loaded) {
    low = std::min(low, specimen.volume.nodes(node, 1 - specimen.axis));
    high = std::max(high, specimen.volume.nodes(node, 1 - specimen.axis));
  }
  const double longest = test.identify.boundary_smoothing.value_or(0.5 * (high - low));
  record.driving = test.identify.driving.empty() ? record.surface_displacement : displacement_of_file(test, observation.places, record);
  if (longest > 0.0) {
    std::vector<double> cut_offs;
    record.driving = correlation::smoothed_within_noise(observation.dic->correlation(), record.driving,
                                                        nodes_of_ends(specimen), noise_of_pair(observation), longest, &cut_offs);
    observation.driving_cut_off = cut_offs;
    std::sort(cut_offs.begin(), cut_offs.end());
    spdlog::info("the ends' displacement is smoothed over {:.3g} to {:.3g} {}, as far as the noise hides it", cut_offs.front(),
                 cut_offs.back(), test.units.length);
  }
  return record;
}

Eigen::MatrixXd driving_displacement(const Observation& observation, Eigen::MatrixXd displacement) {
  std::map<double, std::vector<Eigen::Index>> frames_of;
  for (std::size_t t = 0; t < observation.driving_cut_off.size() && static_cast<Eigen::Index>(t) < displacement.cols(); ++t)
    if (observation.driving_cut_off[t] > 0.0) frames_of[observation.driving_cut_off[t]].push_back(static_cast<Eigen::Index>(t));
  for (const auto& [cut_off, frames] : frames_of)
    displacement(Eigen::all, frames) = correlation::smooth(observation.dic->correlation(), displacement(Eigen::all, frames), cut_off);
  return displacement;
}

Eigen::MatrixXd driving_noise(const Observation& observation, int draws) {
  const auto& correlation = observation.dic->correlation();
  const Eigen::MatrixXd noise = correlation::noise_draws(correlation, noise_of_pair(observation), draws);
  auto cut_offs = observation.driving_cut_off;
  if (cut_offs.empty()) return noise;
  std::nth_element(cut_offs.begin(), cut_offs.begin() + static_cast<std::ptrdiff_t>(cut_offs.size() / 2), cut_offs.end());
  const double median = cut_offs[cut_offs.size() / 2];
  return median > 0.0 ? correlation::smooth(correlation, noise, median) : noise;
}

identification::ImageData make_image_data(const Observation& observation, const io::Case& test) {
  const auto& correlation = observation.dic->correlation();
  identification::ImageData data;
  data.M = correlation.M();
  data.noise = observation.noise * observation.dic->motion_noise();
  data.pixels_per_length = std::sqrt(std::abs(correlation.pixels_per_length().determinant()));
  // The splines of the frames that this rank judges are kept while they take less than 2 GB.
  auto kept = std::make_shared<std::map<int, imaging::BSpline>>();
  data.evaluate = [&observation, &test, kept](int t, const Eigen::VectorXd& displacement, const Communicator& group) {
    constexpr std::size_t budget = 2'000'000'000;
    const auto& files = test.cameras.front().images;
    const int place = observation.places[static_cast<std::size_t>(t)];
    imaging::BSpline fresh;
    const imaging::BSpline* spline = nullptr;
    if (const auto found = kept->find(t); found != kept->end()) {
      spline = &found->second;
    } else {
      fresh = observation.dic->spline(imaging::read_image(files[static_cast<std::size_t>(place)]));
      const std::size_t size = 4UL * static_cast<std::size_t>(fresh.width()) * static_cast<std::size_t>(fresh.height());
      spline = (kept->size() + 1) * size < budget ? &kept->emplace(t, std::move(fresh)).first->second : &fresh;
    }
    const auto seen = observation.dic->correlation().evaluate(*spline, displacement, group);
    return identification::ImageEvaluation{
        .b = seen.b, .squares = seen.squares, .pixels = seen.pixels, .element_rms = seen.element_rms};
  };
  return data;
}

double force_noise(const Observation& observation, const io::Case& test) {
  if (test.loads.noise) return *test.loads.noise;
  const auto& reference = test.cameras.front().reference;
  double mean = 0.0, squares = 0.0, largest = 0.0;
  for (int number : reference) mean += test.load(test.index_of(number)).force / static_cast<double>(reference.size());
  for (int number : reference) squares += std::pow(test.load(test.index_of(number)).force - mean, 2);
  for (int place : observation.places) largest = std::max(largest, std::abs(test.load(place).force));
  const double measured = reference.size() > 2 ? std::sqrt(squares / static_cast<double>(reference.size() - 1)) : 0.0;
  return measured > 0.0 ? measured : 1e-3 * largest;
}

}  // namespace imic3d::app
