#include "light.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/imaging/compression.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/loop/statistics.hpp"
#include "loop_summary.hpp"
#include "rig.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

loop::Scene scene_of(const ObservedFace& face, const Observation& seen, const io::Case& test, int frames) {
  loop::Scene scene;
  scene.surface = &face.dic->cameras().surface();
  loop::measure(scene, *scene.surface);
  scene.time.resize(frames);
  for (int t = 0; t < frames; ++t) scene.time[t] = time_of(test, seen.places[static_cast<std::size_t>(t)]);
  scene.start_time = time_of(test, seen.places.front() - 1), scene.reference_time = reference_time(test);
  scene.force = Eigen::VectorXd::Ones(frames);
  scene.dynamic = face.rig->views.front().reference.dynamic();
  return scene;
}

/// Without static frames: what explains the quietest frame.
double noise_of(const loop::LightCamera& camera) {
  double least = INFINITY;
  for (const auto& frame : camera.frames) {
    Eigen::VectorXd ratio =
        frame.squares.array() /
        ((1.0 - camera.optics.absorbed) * (frame.frame_noise.array() + camera.optics.level / camera.optics.references));
    least = std::min(least, std::sqrt(median(ratio)));
  }
  return least;
}

/// What is left, cell by cell and frame by frame, over its rms under the null.
nlohmann::json map_of(const loop::LightExperiment& experiment, const loop::Report& report) {
  const auto& model = report.final;
  const Eigen::VectorXd left = model.ground->weight.undone(model.fit.residual);
  const Eigen::MatrixXd null = model.ground->weight.undone(model.ground->null);
  const Eigen::VectorXd rms =
      (null.rowwise().squaredNorm() / static_cast<double>(null.cols())).cwiseSqrt().cwiseMax(1e-300);
  double largest = 0.0;
  Eigen::VectorXd of_null = Eigen::VectorXd::Zero(null.cols());
  std::vector<double> all;
  nlohmann::json map;
  for (std::size_t k = 0; k < experiment.cameras().size(); ++k) {
    const auto& optics = experiment.cameras()[k].optics;
    for (Eigen::Index c = 0; c < optics.cells(); ++c)
      for (std::size_t t = 0; t < experiment.frame_numbers().size(); ++t) {
        const auto rows = experiment.rows_of(k, c, static_cast<int>(t));
        const double scale = 1.0 / std::sqrt(static_cast<double>(rows.size()));
        const double value = scale * left(rows).cwiseQuotient(rms(rows)).norm();
        of_null = of_null.cwiseMax(
            scale * (rms(rows).cwiseInverse().asDiagonal() * null(rows, Eigen::all)).colwise().norm().transpose());
        all.push_back(value);
        if (value <= largest) continue;
        largest = value;
        const auto& at = optics.middle[static_cast<std::size_t>(c)];
        map = {{"largest", value},
               {"camera", optics.camera},
               {"frame", experiment.frame_numbers()[t]},
               {"place", {at[0], at[1]}}};
      }
  }
  const double limit = loop::quantile(of_null, 0.99);
  map["limit"] = limit;
  map["share_beyond_limit"] =
      static_cast<double>(std::count_if(all.begin(), all.end(), [&](double value) { return value > limit; })) /
      static_cast<double>(std::max<std::size_t>(1, all.size()));
  return map;
}

}  // namespace

void check_light_effects(const io::Case& test, const mesh::Mesh& surface) {
  const auto declared = declared_effects(test, true);
  if (declared.empty()) return;
  if (test.cameras.empty())
    throw InputError("effects." + declared.front().effect, "declared for a test without images",
                     "cameras, whose grey levels it acts on");
  loop::Scene scene;
  scene.surface = &surface;
  loop::measure(scene, surface);
  scene.dynamic = imaging::read_header(test.cameras.front().images.front()).depth == 16 ? 65535.0 : 255.0;
  for (const auto& effect : loop::light_effects()) {
    const auto description = effect->describe(scene);
    for (const auto& q : description.quantities)
      for (const auto& one : declared)
        if ((one.effect == loop::key_of(description.name) ||
             one.effect.ends_with("_" + loop::key_of(description.name))) &&
            one.quantity == q.name && one.value && (*one.value < q.lower || *one.value > q.upper))
          throw InputError(
              "effects." + one.effect + "." + q.name, fmt::format("{:.6g}", *one.value),
              fmt::format("a number from {:.6g} to {:.6g} [{}]", q.lower, q.upper, unit_in(q.unit, test.units)));
  }
}

LightFindings look_at_light(const Observation& seen, const io::Case& test, int frames,
                            const std::function<void(const ImageShown&)>& synthetic, const loop::LoopOptions& options,
                            const std::function<void(const std::string&)>& say) {
  std::vector<loop::LightCamera> cameras;
  std::vector<loop::LightStatistics> statistics;
  std::vector<std::vector<std::size_t>> place(seen.faces.size());  // of a face's cameras in `cameras`
  std::vector<Eigen::Index> first_unknown;
  Eigen::Index unknowns = 0;
  LightFindings findings;
  std::size_t all_cameras = 0;
  for (std::size_t k = 0; k < seen.faces.size(); ++k) {
    const auto& face = seen.faces[k];
    const loop::Scene scene = scene_of(face, seen, test, frames);
    std::vector<double> noise;
    for (const int number : face.rig->cameras) noise.push_back(seen.camera_noise[static_cast<std::size_t>(number)]);
    for (auto& its : loop::LightStatistics::of_face(*face.whole, face.rig->views, seen.references, noise, scene))
      statistics.push_back(std::move(its));
    for (std::size_t c = 0; c < face.rig->views.size(); ++c) {
      const auto number = static_cast<std::size_t>(face.rig->cameras[c]);
      const loop::LightStatistics& its = statistics[cameras.size()];
      loop::LightCamera camera{its.optics(), scene, {}, static_cast<int>(k)};
      camera.optics.compressed = imaging::block_excess(imaging::read_image(test.cameras[number].images.front())) > 0.0;
      camera.optics.camera = test.cameras[number].name;
      auto& listed = findings.json["cameras"][camera.optics.camera];
      for (int t = 0; t < frames; ++t) {
        const auto& frame = seen.frames[static_cast<std::size_t>(t)];
        const auto image = imaging::read_image(
            test.cameras[number].images[static_cast<std::size_t>(seen.places[static_cast<std::size_t>(t)])]);
        camera.frames.push_back(its.frame(image, frame.displacement.segment(unknowns, face.dic->cameras().unknowns()),
                                          off_epipolar(seen, k, static_cast<int>(c), static_cast<std::size_t>(t))));
        const auto& of_camera = frame.cameras[all_cameras + c];
        listed["rms"].push_back(of_camera.rms);
        if (camera.optics.gain_and_offset_fitted)
          listed["gain"].push_back(of_camera.gain), listed["offset"].push_back(of_camera.offset);
        listed["saturated"].push_back(camera.frames.back().saturated / std::max(1.0, camera.frames.back().pixels));
        findings.rms += of_camera.rms * of_camera.rms;
      }
      if (!face.rig->noise_is_measured[c]) camera.optics.noise = noise_of(camera);
      place[k].push_back(cameras.size());
      cameras.push_back(std::move(camera));
    }
    all_cameras += face.rig->views.size();
    unknowns += face.dic->cameras().unknowns();
  }
  findings.rms = std::sqrt(findings.rms / static_cast<double>(frames * static_cast<int>(cameras.size())));
  std::vector<int> numbers;
  for (int t = 0; t < frames; ++t)
    numbers.push_back(test.frames[static_cast<std::size_t>(seen.places[static_cast<std::size_t>(t)])]);
  const auto learned = [&] {
    std::vector<std::vector<loop::LightFrame>> made(statistics.size(),
                                                    std::vector<loop::LightFrame>(static_cast<std::size_t>(frames)));
    synthetic([&](std::size_t face, int camera, int t, const imaging::Image& image, const Eigen::VectorXd& U) {
      const std::size_t k = place[face][static_cast<std::size_t>(camera)];
      made[k][static_cast<std::size_t>(t)] = statistics[k].frame(image, U);
    });
    return made;
  };
  loop::LightExperiment experiment(std::move(cameras), numbers, options.held_out, declared_effects(test, true), learned,
                                   [&](std::string unit) { return unit_in(std::move(unit), test.units); });
  const auto report = loop::close_loop(experiment, options, say);
  findings.verdict = report.verdict;
  findings.sentence = report.sentence;
  const auto in_set = [&](const std::string& name) {
    // of all cameras or of one
    return std::any_of(report.set.begin(), report.set.end(), [&](int k) {
      return experiment.candidates()[static_cast<std::size_t>(k)].name.ends_with(name);
    });
  };
  const double share = experiment.share_of_gain_and_offset(), with_gradient = experiment.share_of_gain_and_offset(true);
  const bool found = report.verdict != loop::Verdict::nothing_found,
             unexplained = report.verdict == loop::Verdict::unexplained;
  findings.gradient = !test.dic.local_brightness && found &&
                      (in_set("light gradient") || (unexplained && share < 0.5 && with_gradient > 0.5));
  findings.gain_or_offset = !test.dic.brightness && !test.dic.local_brightness && found &&
                            (in_set("light gain") || in_set("light offset") || (unexplained && share > 0.5));
  auto listed = std::move(findings.json["cameras"]);
  const Eigen::MatrixXd noise = experiment.frame_noise();
  for (Eigen::Index k = 0; k < noise.rows(); ++k)
    listed[experiment.cameras()[static_cast<std::size_t>(k)].optics.camera]["relative_noise"] =
        std::vector<double>(noise.row(k).begin(), noise.row(k).end());
  for (std::size_t k = 0; found && k < place.size(); ++k)
    findings.frame_noise.emplace_back(
        (noise(place[k], Eigen::all).colwise().squaredNorm() / static_cast<double>(place[k].size()))
            .cwiseSqrt()
            .transpose());
  findings.json = loop_summary(experiment, report);
  findings.json["cameras"] = listed;
  findings.json["residual"] = {{"rms", findings.rms}, {"unit", "grey level"}};
  findings.json["share_of_gain_and_offset"] = share, findings.json["share_with_gradient"] = with_gradient;
  findings.json["map"] = map_of(experiment, report);
  if (const auto& map = findings.json["map"]; report.verdict == loop::Verdict::unexplained && map.contains("place"))
    findings.sentence +=
        fmt::format(" It is {:.1f} times the noise about ({:.3g}, {:.3g}) in frame {}.", map["largest"].get<double>(),
                    map["place"][0].get<double>(), map["place"][1].get<double>(), map["frame"].get<int>());
  if (found && experiment.images_compressed())
    findings.sentence +=
        " The images were compressed: noise level and aliasing, which that looks like, were no candidates; it may be "
        "that instead.";
  findings.json["sentence"] = findings.sentence;
  return findings;
}

}  // namespace imic3d::app
