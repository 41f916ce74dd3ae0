#include "imic3d/app/observation.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <set>

#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/correlation/lost_places.hpp"
#include "imic3d/imaging/noise.hpp"
#include "rig.hpp"

namespace imic3d::app {

namespace {

using identification::Face;

/// Nodes of a face on the two ends, where the mesh stops and the specimen goes on.
std::vector<int> nodes_of_ends(const identification::Specimen& specimen, const Face& face) {
  std::set<int> ends;
  const auto& from_surface = specimen.displacement_from_surface;
  for (auto column = static_cast<int>(face.first_unknown); column < face.first_unknown + face.unknowns(); ++column)
    if (from_surface.outerIndexPtr()[column + 1] > from_surface.outerIndexPtr()[column])
      ends.insert((column - static_cast<int>(face.first_unknown)) / face.components);
  return {ends.begin(), ends.end()};
}

/// The correlation of a face, without some of its elements.
std::shared_ptr<const correlation::GlobalDic> make_dic(const io::Case& test, const Rig& rig, int components,
                                                       const std::vector<int>& ends, std::vector<char> left_out) {
  std::vector<correlation::View> views = rig.views;
  if (views.size() == 1) views.front().noise = 0.0;  // a weight of one, exactly
  return std::make_shared<const correlation::GlobalDic>(
      rig.surface, std::move(views), components,
      correlation::DicOptions{.pyramid_levels = test.dic.pyramid_levels,
                              .max_iterations = test.dic.max_iterations,
                              .tolerance = test.dic.tolerance,
                              .regularisation = test.dic.regularisation.value_or(0.0),
                              .low_pass = test.dic.low_pass,
                              .border = test.dic.border,
                              .cut_nodes = ends,
                              .brightness = test.dic.brightness,
                              .local_brightness = test.dic.local_brightness,
                              .groups = test.dic.groups,
                              .left_out = std::move(left_out)});
}

/// The frames with what is left in all elements of a face at their displacement.
std::vector<correlation::DicFrame> as_whole(const ObservedFace& face, std::vector<correlation::DicFrame> frames,
                                            const std::vector<std::vector<std::filesystem::path>>& files,
                                            const Communicator& world) {
  const auto& cameras = face.whole->cameras();
  const Eigen::Index elements = cameras.elements();
  Eigen::MatrixXd rms = Eigen::MatrixXd::Zero(elements * cameras.size(), static_cast<Eigen::Index>(frames.size()));
  collectively(world, [&] {
    for (Eigen::Index t = world.rank(); t < rms.cols(); t += world.size()) {
      std::vector<imaging::BSpline> g;
      for (const auto& of_camera : files)
        g.push_back(face.whole->spline(imaging::read_image(of_camera[static_cast<std::size_t>(t)])));
      const auto seen =
          cameras.evaluate(g, frames[static_cast<std::size_t>(t)].displacement, Communicator{MPI_COMM_SELF},
                           correlation::Gradient::reference,
                           face.dic->cameras().off_epipolar(frames[static_cast<std::size_t>(t)].epipolar));
      for (int c = 0; c < cameras.size(); ++c)
        rms.col(t).segment(c * elements, elements) = seen.cameras[static_cast<std::size_t>(c)].element_rms;
    }
  });
  world.sum(std::span(rms.data(), static_cast<std::size_t>(rms.size())));
  for (std::size_t t = 0; t < frames.size(); ++t)
    for (int c = 0; c < cameras.size(); ++c)
      frames[t].cameras[static_cast<std::size_t>(c)].element_rms =
          rms.col(static_cast<Eigen::Index>(t)).segment(c * elements, elements);
  return frames;
}

/// What is said of elements that are left out.
std::string in_words(const mesh::Mesh& surface, const std::vector<char>& left_out, const std::string& length) {
  std::vector<std::string> places;
  for (const auto& patch : correlation::patches(surface, left_out)) {
    Eigen::RowVector2d middle = Eigen::RowVector2d::Zero();
    for (const int e : patch)
      for (int i = 0; i < 4; ++i)
        middle += surface.nodes.row(surface.cells(e, i)).head<2>() / (4.0 * static_cast<double>(patch.size()));
    places.push_back(fmt::format("{} about ({:.3g}, {:.3g}) {}", patch.size(), middle[0], middle[1], length));
  }
  return fmt::format(
      "{} of {} elements of the surface, {}, show the reference's speckle no more in some frames (paint that came off, "
      "a reflection): they are left out of all",
      std::count(left_out.begin(), left_out.end(), 1), left_out.size(), fmt::join(places, ", "));
}

/// The frames of all faces as one: unknowns and elements one after the other.
correlation::DicFrame joined(const std::vector<correlation::DicFrame>& faces) {
  if (faces.size() == 1) return faces.front();
  correlation::DicFrame all = faces.front();
  double squares = 0.0, coefficient = 0.0;
  all.pixels = all.dropped = 0.0;
  Eigen::Index unknowns = 0, elements = 0, modes = 0;
  for (const auto& face : faces)
    unknowns += face.displacement.size(), elements += face.element_rms.size(), modes += face.epipolar.size();
  all.displacement.resize(unknowns), all.element_rms.resize(elements), all.epipolar.resize(modes), all.cameras.clear();
  unknowns = elements = modes = all.hardly_seen = 0;
  for (const auto& face : faces) {
    all.displacement.segment(unknowns, face.displacement.size()) = face.displacement;
    all.element_rms.segment(elements, face.element_rms.size()) = face.element_rms;
    all.epipolar.segment(modes, face.epipolar.size()) = face.epipolar;
    unknowns += face.displacement.size(), elements += face.element_rms.size(), modes += face.epipolar.size();
    all.converged = all.converged && face.converged, all.lost = all.lost || face.lost;
    all.iterations = std::max(all.iterations, face.iterations);
    squares += face.pixels * face.rms * face.rms, coefficient += face.pixels * face.coefficient;
    all.pixels += face.pixels, all.dropped += face.dropped, all.hardly_seen += face.hardly_seen;
    all.cameras.insert(all.cameras.end(), face.cameras.begin(), face.cameras.end());
  }
  all.rms = std::sqrt(squares / std::max(1.0, all.pixels)), all.coefficient = coefficient / std::max(1.0, all.pixels);
  return all;
}

}  // namespace

Observation observe(const io::Case& test, const identification::Specimen& specimen) {
  Observation observation;
  const auto& reference = test.cameras.front().reference;
  observation.references = static_cast<int>(reference.size());
  int last = -1;
  for (int number : reference) last = std::max(last, test.index_of(number));
  for (int place = last + 1; place < static_cast<int>(test.frames.size()); ++place) observation.places.push_back(place);
  if (observation.places.empty())
    throw InputError("cameras.reference", "no frame comes after the reference", "frames before the last one");
  observation.camera_noise.assign(test.cameras.size(), 0.0);
  observation.noise_is_measured = true;
  for (const Face& face : specimen.faces) {
    ObservedFace seen;
    seen.rig = std::make_shared<Rig>(make_rig(test, face.back, face.surface.mesh));
    seen.ends = nodes_of_ends(specimen, face);
    seen.dic = seen.whole = make_dic(test, *seen.rig, face.components, seen.ends, {});
    for (std::size_t c = 0; c < seen.rig->views.size(); ++c) {
      measure_noise(*seen.rig, c, seen.dic->correlation(static_cast<int>(c)).quadrature());
      doubt_saturation(test, *seen.rig, c, seen.dic->correlation(static_cast<int>(c)).quadrature());
      doubt_bare_places(test, *seen.rig, c, seen.dic->correlation(static_cast<int>(c)).quadrature(),
                        seen.dic->noise_response().level);
      observation.camera_noise[static_cast<std::size_t>(seen.rig->cameras[c])] = seen.rig->views[c].noise;
      observation.noise_is_measured = observation.noise_is_measured && seen.rig->noise_is_measured[c];
    }
    observation.faces.push_back(std::move(seen));
  }
  if (observation.noise_is_measured) observation.noise = joint_noise(observation.camera_noise);
  return observation;
}

Observation on_mesh(const Observation& seen, const io::Case& test, const identification::Specimen& specimen) {
  Observation there = seen;
  for (std::size_t k = 0; k < specimen.faces.size(); ++k) {
    auto& face = there.faces[k];
    const mesh::Mesh& surface = specimen.faces[k].surface.mesh;
    face.rig = std::make_shared<Rig>(*face.rig);
    face.rig->surface = surface, face.ends = nodes_of_ends(specimen, specimen.faces[k]);
    face.dic = face.whole = make_dic(test, *face.rig, specimen.faces[k].components, face.ends, {});
  }
  for (auto& frame : there.frames) frame.epipolar.resize(0);
  for (std::size_t k = 0; k < specimen.faces.size(); ++k) {
    const auto& before = seen.faces[k].dic->cameras();
    const auto& after = there.faces[k].dic->cameras();
    if (before.epipolar_modes() == 0 || after.epipolar_modes() == 0) continue;
    const Eigen::SparseMatrix<double> onto = identification::between(before.surface(), after.surface(), 2);
    for (std::size_t t = 0; t < there.frames.size(); ++t) {
      std::vector<correlation::InImage> off;
      for (int c = 0; c < before.size(); ++c)
        off.push_back(Eigen::VectorXd(onto * off_epipolar(seen, k, c, t).reshaped<Eigen::RowMajor>())
                          .reshaped<Eigen::RowMajor>(after.nodes(), 2));
      const Eigen::VectorXd own = after.epipolar_of(off);
      auto& epipolar = there.frames[t].epipolar;
      epipolar.conservativeResize(epipolar.size() + own.size()), epipolar.tail(own.size()) = own;
    }
  }
  return there;
}

/// What helps where elements have too few pixels for the speckle in them to tell how each of their nodes moves; else
/// empty.
std::string small_elements(double pixels) {
  constexpr double enough = 36.0;  // six on a side
  if (pixels >= enough) return {};
  return fmt::format(
      "an element of the surface has {:.0f} pixels in the mean, where {:g} and more are wanted: a coarser mesh, or "
      "dic.regularisation (waves shorter than some elements) helps",
      pixels, enough);
}

namespace {
/// The residual that noise of one grey level makes in pure DIC.
double residual_of_unit_noise(const Observation& seen, const ObservedFace& face) {
  return face.dic->noise_response().level * std::sqrt(1.0 + 1.0 / seen.references);
}

/// What the DIC leaves in the best frame of camera `c` of a face, as noise of one image; `first`: cameras of the faces
/// before it.
double noise_of_best_frame(const Observation& seen, const ObservedFace& face, std::size_t first, std::size_t c) {
  double smallest = INFINITY;
  for (const auto& frame : seen.frames) smallest = std::min(smallest, frame.cameras[first + c].rms);
  return smallest / residual_of_unit_noise(seen, face);
}

/// No static frames: what the DIC leaves in a camera's best frame is noise of that frame and of the reference.
void noise_of_best_frames(Observation& observation) {
  std::size_t first = 0;
  for (const auto& face : observation.faces) {
    for (std::size_t c = 0; c < face.rig->cameras.size(); ++c) {
      if (face.rig->noise_is_measured[c]) continue;
      observation.camera_noise[static_cast<std::size_t>(face.rig->cameras[c])] =
          noise_of_best_frame(observation, face, first, c);
    }
    first += face.rig->cameras.size();
  }
  observation.noise = joint_noise(observation.camera_noise);
}

/// How far the ends of the mesh lie outside all images of their face, the farthest node of them [px].
double ends_outside(const Observation& observation, const correlation::DicFrame& frame) {
  double farthest = 0.0;
  Eigen::Index first = 0;
  for (const auto& face : observation.faces) {
    const auto& cameras = face.dic->cameras();
    Eigen::VectorXd least = Eigen::VectorXd::Constant(static_cast<Eigen::Index>(face.ends.size()), INFINITY);
    for (int c = 0; c < cameras.size(); ++c) {
      const auto& image = face.rig->views[static_cast<std::size_t>(c)].reference;
      const correlation::InImage at =
          cameras[c].positions() + cameras[c].pixel_displacement(frame.displacement.segment(first, cameras.unknowns()));
      for (Eigen::Index i = 0; i < least.size(); ++i) {
        const double column = at(face.ends[static_cast<std::size_t>(i)], 0),
                     row = at(face.ends[static_cast<std::size_t>(i)], 1);
        least[i] =
            std::min(least[i], std::max({0.0, -column, column - (image.width - 1), -row, row - (image.height - 1)}));
      }
    }
    if (least.size() > 0) farthest = std::max(farthest, least.maxCoeff());
    first += cameras.unknowns();
  }
  return farthest;
}

/// The images of a frame that have one grey level throughout.
std::vector<std::string> pictures_of_nothing(const io::Case& test, int place) {
  std::vector<std::string> files;
  for (const auto& camera : test.cameras) {
    const auto& file = camera.images[static_cast<std::size_t>(place)];
    try {
      if (imaging::of_one_level(imaging::read_image(file))) files.push_back(file.filename().string());
    } catch (const InputError&) {  // an image that has become unreadable says nothing, and takes no results away
    }
  }
  return files;
}

/// What is said of the frames whose displacement is not known, and why it may be so.
struct Unknown {
  io::Frames lost, outside, leaving;
  double farthest = 0.0, left = 0.0;  // of an end [px]; of the mesh's pixels
  std::vector<std::string> of_one_level;
  double pixels_of_element = INFINITY;

  void see(int number, const correlation::DicFrame& frame) {
    constexpr double many = 0.01;
    const double all = frame.pixels + frame.dropped;
    pixels_of_element =
        std::min(pixels_of_element, all / static_cast<double>(std::max<Eigen::Index>(1, frame.element_rms.size())));
    if (frame.dropped <= many * all || (frame.lost && frame.dropped <= 0.5 * all))
      return;  // where a lost frame's mesh lies means nothing
    leaving.push_back(number), left = std::max(left, frame.dropped / all);
  }

  [[nodiscard]] std::string said(std::size_t frames) const {
    std::vector<std::string> parts;
    if (!lost.empty())
      parts.push_back(fmt::format("{} of {} frames take no part, their correlation was lost or did not converge: {}",
                                  lost.size(), frames, io::to_text(lost)));
    if (!outside.empty())
      parts.push_back(
          fmt::format("{} of {} frames take no part, an end of the mesh, whose motion drives the simulation, lies up "
                      "to {:.1f} px outside the image: {}",
                      outside.size(), frames, farthest, io::to_text(outside)));
    if (!leaving.empty())
      parts.push_back(fmt::format("up to {:.0f} % of the mesh's pixels have left the image in the frames {}",
                                  100.0 * left, io::to_text(leaving)));
    if (!of_one_level.empty())
      parts.push_back(fmt::format("of one grey level throughout: {}", fmt::join(of_one_level, ", ")));
    if (const std::string small = small_elements(pixels_of_element); !lost.empty() && !small.empty())
      parts.push_back(small);
    return fmt::format("{}", fmt::join(parts, "; "));
  }
};

}  // namespace

correlation::InImage off_epipolar(const Observation& seen, std::size_t face, int camera, std::size_t t) {
  const Eigen::VectorXd& epipolar = seen.frames[t].epipolar;
  if (epipolar.size() == 0) return {};
  Eigen::Index first = 0;
  for (std::size_t k = 0; k < face; ++k) first += seen.faces[k].dic->cameras().epipolar_modes();
  const auto& cameras = seen.faces[face].dic->cameras();
  return cameras.off_epipolar(camera, epipolar.segment(first, cameras.epipolar_modes()));
}

double residual_of_noise(const Observation& seen, const ObservedFace& face, std::size_t camera) {
  return seen.camera_noise[static_cast<std::size_t>(face.rig->cameras[camera])] * residual_of_unit_noise(seen, face);
}

double beyond_noise(const Observation& seen, const correlation::DicFrame& frame) {
  double sum = 0.0;
  std::size_t first = 0;
  for (const auto& face : seen.faces) {
    for (std::size_t c = 0; c < face.rig->cameras.size(); ++c)
      sum += std::pow(frame.cameras[first + c].rms / residual_of_noise(seen, face, c), 2);
    first += face.rig->cameras.size();
  }
  return std::sqrt(sum / static_cast<double>(first));
}

double beyond_noise(const Observation& seen) {
  std::vector<double> frames;
  for (const auto& frame : seen.frames) frames.push_back(beyond_noise(seen, frame));
  const double typical = median(std::move(frames));
  return std::isfinite(typical) ? std::max(1.0, typical) : 1.0;
}

Eigen::VectorXd frame_noise(const Observation& seen) {
  Eigen::VectorXd noise(seen.frames.size());
  for (Eigen::Index t = 0; t < noise.size(); ++t)
    noise[t] = std::max(1.0, beyond_noise(seen, seen.frames[static_cast<std::size_t>(t)]));
  if (!noise.allFinite()) return Eigen::VectorXd::Ones(noise.size());
  return noise / beyond_noise(seen);
}

void correlate(Observation& observation, const io::Case& test, const Communicator& world,
               const std::function<void(int, const correlation::DicFrame&)>& done, CorrelationProgress progress) {
  const auto frames = observation.places.size();
  std::vector<std::vector<correlation::DicFrame>> of_face;
  progress.known.resize(observation.faces.size());
  std::vector<std::string> left_out;
  for (std::size_t k = 0; k < observation.faces.size(); ++k) {
    auto& face = observation.faces[k];
    std::vector<std::vector<std::filesystem::path>> files;
    for (const int c : face.rig->cameras) {
      files.emplace_back();
      for (int place : observation.places)
        files.back().push_back(test.cameras[static_cast<std::size_t>(c)].images[static_cast<std::size_t>(place)]);
    }
    correlation::DicSeries known = std::move(progress.known[k]);
    // Found lost first where the correlation went astray, which takes what lies around it along; then where the motion
    // without these does not carry the reference.
    for (constexpr int rounds = 2;;) {
      const std::vector<char> without = known.left_out;
      const int round = known.round;
      face.dic = without.empty() ? face.whole
                                 : make_dic(test, *face.rig, face.whole->cameras().dofs_per_node(), face.ends, without);
      auto series = face.dic->run(
          world, files,
          [&](int t, const correlation::DicFrame& frame) {
            if (done && observation.faces.size() == 1) done(observation.places[static_cast<std::size_t>(t)], frame);
          },
          std::move(known),
          [&](const correlation::DicSeries& reached) {
            if (progress.reached) progress.reached(k, reached);
          });
      std::vector<char> lost;
      if (round < rounds)
        lost = correlation::lost_elements(face.whole->cameras(),
                                          round == 0 ? series : as_whole(face, series, files, world));
      if (lost.empty() || lost == without) {
        if (!without.empty()) left_out.push_back(in_words(face.rig->surface, without, test.units.length));
        of_face.push_back(std::move(series));
        break;
      }
      spdlog::info("{} of {} elements could not be correlated: the frames are correlated again without them",
                   std::count(lost.begin(), lost.end(), 1), lost.size());
      known = {};
      known.left_out = std::move(lost), known.round = round + 1;
    }
  }
  io::Frames numbers;
  for (const int place : observation.places) numbers.push_back(test.frames[static_cast<std::size_t>(place)]);
  observation.doubts.clear();
  for (std::size_t k = 0; k < of_face.size(); ++k)
    if (auto doubt = doubt_off_epipolar(test, *observation.faces[k].rig, observation.faces[k].dic->cameras(), numbers,
                                        of_face[k]);
        !doubt.empty())
      observation.doubts.push_back(std::move(doubt));
  for (const auto& doubt : observation.doubts) spdlog::warn("{}", doubt);
  observation.frames.clear();
  for (std::size_t t = 0; t < frames; ++t) {
    std::vector<correlation::DicFrame> faces;
    for (auto& series : of_face) faces.push_back(std::move(series[t]));
    observation.frames.push_back(joined(faces));
    if (done && faces.size() > 1) done(observation.places[t], observation.frames.back());
  }
  // A frame whose displacement is not known drives no simulation and judges none.
  constexpr double outside = 1.0;  // [px]
  std::vector<int> kept;
  std::vector<correlation::DicFrame> known;
  Unknown unknown;
  for (std::size_t t = 0; t < frames; ++t) {
    auto& frame = observation.frames[t];
    const int place = observation.places[t], number = test.frames[static_cast<std::size_t>(place)];
    unknown.see(number, frame);
    if (!frame.converged || frame.lost) {
      unknown.lost.push_back(number);
      for (auto& file : pictures_of_nothing(test, place)) unknown.of_one_level.push_back(std::move(file));
    } else if (const double by = ends_outside(observation, frame); by > outside) {
      unknown.outside.push_back(number), unknown.farthest = std::max(unknown.farthest, by);
    } else {
      kept.push_back(place);
      known.push_back(std::move(frame));
    }
  }
  if (known.empty()) throw ConvergenceError("no frame could be correlated with the reference: " + unknown.said(frames));
  if (auto said = unknown.said(frames); !said.empty()) left_out.push_back(std::move(said));
  observation.left_out = fmt::format("{}", fmt::join(left_out, "; "));
  if (!observation.left_out.empty()) spdlog::warn("{}", observation.left_out);
  observation.places = std::move(kept);
  observation.frames = std::move(known);
  if (!observation.noise_is_measured) noise_of_best_frames(observation);
}

namespace {

/// Frames of the reference that differ by more than frames under load do from their mean once their motion is known, or
/// during which the record changes.
std::vector<std::string> moving_references(const io::Case& test, const Observation& seen) {
  constexpr double by_much = 1.4, loaded = 0.05;
  std::vector<std::string> found;
  std::size_t first = 0;
  for (const auto& face : seen.faces) {
    for (std::size_t c = 0; c < face.rig->cameras.size(); ++c) {
      const auto& camera = test.cameras[static_cast<std::size_t>(face.rig->cameras[c])];
      if (!face.rig->noise_is_measured[c] || face.rig->statics[c].size() < 2 || camera.noise) continue;
      const double left = noise_of_best_frame(seen, face, first, c), noise = face.rig->views[c].noise;
      if (noise > by_much * left)
        found.push_back(fmt::format(
            "cameras.{}.reference: these frames differ by {:.3g} grey levels, where {:.2g} are left of a frame under "
            "load: did the specimen move, was it loaded, or did the light change between them?",
            camera.name, noise, left));
    }
    first += face.rig->cameras.size();
  }
  if (test.loads.records.empty()) return found;
  double low = INFINITY, high = -INFINITY, largest = 0.0;
  for (const int number : test.cameras.front().reference) {
    const double force = test.load(test.index_of(number)).force;
    low = std::min(low, force), high = std::max(high, force);
  }
  for (const int place : seen.places) largest = std::max(largest, std::abs(test.load(place).force));
  if (high - low > loaded * largest)
    found.push_back(fmt::format(
        "cameras.{}.reference: the load record goes from {:.4g} to {:.4g} {} in these frames, of {:.4g}: the reference "
        "is the mean of frames in which nothing moves",
        test.cameras.front().name, low, high, test.units.force, largest));
  return found;
}

}  // namespace

std::vector<std::string> doubts_of(const io::Case& test, const Observation& seen) {
  auto doubts = test.doubts;
  for (const auto& face : seen.faces) doubts.insert(doubts.end(), face.rig->doubts.begin(), face.rig->doubts.end());
  if (!seen.left_out.empty()) doubts.push_back(seen.left_out);
  doubts.insert(doubts.end(), seen.doubts.begin(), seen.doubts.end());
  for (const std::string& one : moving_references(test, seen)) {
    doubts.push_back(one);
    spdlog::warn("{}", one);
  }
  if (auto doubt = doubt_of_zero(force_at_rest(test), test); !doubt.empty()) {
    spdlog::warn("{}", doubt);
    doubts.push_back(std::move(doubt));
  }
  return doubts;
}

}  // namespace imic3d::app
