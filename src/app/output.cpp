#include "imic3d/app/output.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "imic3d/app/program.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/report.hpp"
#include "rig.hpp"

namespace imic3d::app {

namespace {

constexpr double unlikely_force = 2.0;   // of the noise, left by a model
constexpr double wrong_force = 50.0;     // the same, where it is rather the data
constexpr double unlikely_change = 2.0;  // in standard deviations
// of pure DIC, over that of noise: what few pixels an element and large strains add is less
constexpr double unlikely_residual = 2.0;
// the same where a gain and an offset are most of what is beyond noise
constexpr double unlikely_light = 1.1;

std::span<const double> span_of(const auto& matrix) { return {matrix.data(), static_cast<std::size_t>(matrix.size())}; }

double von_mises(const Eigen::Matrix<double, 1, 6>& s) {
  const double a = s[0] - s[1], b = s[1] - s[2], c = s[2] - s[0];
  return std::sqrt(0.5 * (a * a + b * b + c * c) + 3.0 * s.tail<3>().squaredNorm());
}

void write_fields(io::ResultsFile& file, std::size_t place, const identification::Specimen& specimen,
                  const mechanics::FrameState& state, double force) {
  std::vector<double> equivalent;
  for (Eigen::Index cell = 0; cell < state.cauchy_stress.rows(); ++cell)
    equivalent.push_back(von_mises(state.cauchy_stress.row(cell)));
  std::array<double, 3> reaction{};
  for (int node : specimen.loaded)
    for (std::size_t i = 0; i < 3; ++i)
      reaction[i] += specimen.section_factor * state.internal[3 * node + static_cast<int>(i)];
  io::write_simulation_frame(file, place,
                             {.displacement = span_of(state.displacement),
                              .cauchy_stress = span_of(state.cauchy_stress),
                              .von_mises = equivalent,
                              .plastic_strain = span_of(state.plastic_strain),
                              .reaction = reaction,
                              .force = force});
}

/// Places in the record to look at: the last fitted frame, the last one held out before it, the first one at which the
/// force has fallen by 5 % from its peak, and the last one.
std::set<int> telling_frames(const identification::Record& record, const io::Case& test, int simulated) {
  const auto among = [](const io::Frames& numbers, int number) {
    return std::find(numbers.begin(), numbers.end(), number) != numbers.end();
  };
  std::set<int> telling;
  int fitted = -1, held_out = -1, peak = 0;
  for (int t = 0; t < simulated; ++t) {
    const int number = record.frames[static_cast<std::size_t>(t)];
    if (std::any_of(test.identify.stages.begin(), test.identify.stages.end(),
                    [&](const auto& stage) { return among(stage.frames, number); }) &&
        !among(test.identify.held_out, number))
      fitted = t;
    if (std::abs(record.force[t]) > std::abs(record.force[peak])) peak = t;
  }
  for (int t = 0; t < fitted; ++t)
    if (among(test.identify.held_out, record.frames[static_cast<std::size_t>(t)])) held_out = t;
  int fallen = peak;
  while (fallen < simulated && std::abs(record.force[fallen]) > 0.95 * std::abs(record.force[peak])) ++fallen;
  for (int t : {fitted, held_out, fallen, simulated - 1})
    if (t >= 0 && t < simulated) telling.insert(t);
  return telling;
}

/// Of the squares of the residual of pure DIC that noise does not explain, in the first camera: how much a gain and an
/// offset do, f - g(x + u) = a + b f.
double share_of_light(const io::Case& test, const Observation& seen, std::size_t t) {
  const auto& face = seen.faces.front();
  const auto& correlation = face.dic->correlation();
  const auto& camera = test.cameras[static_cast<std::size_t>(face.rig->cameras.front())];
  const auto image = face.dic->spline(imaging::read_image(camera.images[static_cast<std::size_t>(seen.places[t])]));
  const std::vector<float> residual = correlation.residual(
      image, seen.frames[t].displacement.head(face.dic->cameras().unknowns()), off_epipolar(seen, 0, 0, t));
  const auto& grey = correlation.quadrature().f;
  double n = 0.0, f = 0.0, r = 0.0, ff = 0.0, fr = 0.0, rr = 0.0;
  for (std::size_t p = 0; p < residual.size(); ++p) {
    if (!std::isfinite(residual[p])) continue;
    n += 1.0, f += grey[p], r += residual[p], ff += grey[p] * grey[p], fr += grey[p] * residual[p],
        rr += residual[p] * residual[p];
  }
  const double explained = r * r / n + std::pow(fr - f * r / n, 2) / std::max(ff - f * f / n, 1e-300);
  return explained / std::max(rr - n * std::pow(residual_of_noise(seen, face, 0), 2), 1e-300);
}

/// What the residual of pure DIC, far beyond noise, lets suspect; else empty.
std::string unlikely_correlation(const io::Case& test, const Observation& seen) {
  std::vector<double> beyond;
  for (const auto& frame : seen.frames) beyond.push_back(beyond_noise(seen, frame));
  const double typical = beyond_noise(seen);
  const std::string much = fmt::format(
      "the correlation alone leaves {:.2f} times the residual that noise explains (median of the frames)", typical);
  if (typical > unlikely_light && !test.dic.brightness && !test.dic.local_brightness) {
    constexpr std::size_t looked_at = 8;
    std::vector<double> shares;
    for (std::size_t t = 0; t < beyond.size(); t += 1 + beyond.size() / looked_at) {
      if (beyond[t] <= unlikely_light) continue;
      try {
        shares.push_back(share_of_light(test, seen, t));
      } catch (const InputError&) {  // an image that has become unreadable says nothing, and takes no results away
      }
    }
    if (const double share = shares.empty() ? 0.0 : median(shares); share > 0.5)
      return fmt::format(
          "{}, and {:.0f} % of what is beyond noise is a gain and an offset: the light changes{}, and may move the "
          "parameters by more than their standard deviations; dic.brightness (or dic.local_brightness) takes that part "
          "off",
          much, 100.0 * std::min(share, 1.0), share < 0.8 ? ", or the focus" : "");
  }
  if (typical < unlikely_residual) {
    io::Frames worse;
    for (std::size_t t = 0; t < beyond.size(); ++t)
      if (beyond[t] >= unlikely_residual) worse.push_back(test.frames[static_cast<std::size_t>(seen.places[t])]);
    if (worse.empty()) return {};
    return fmt::format(
        "in {} of {} frames the correlation leaves more than {:g} times the residual that noise explains, up to {:.2f} "
        "times: {}. They weigh as if that were noise, which it is not: what changed the picture there (paint that "
        "flakes, the focus, light, a motion that the mesh cannot follow) may still move the parameters by more than "
        "their standard deviations",
        worse.size(), beyond.size(), unlikely_residual, *std::max_element(beyond.begin(), beyond.end()),
        io::to_text(worse));
  }
  return much + fmt::format(
                    ": the standard deviations hold it as if it were noise, alike in no two frames, which it may not "
                    "be. A motion that the mesh cannot follow (a finer one helps), {}, or frames that lost it",
                    test.dic.local_brightness ? "another change of the picture than its light"
                    : test.dic.brightness     ? "light that does not change alike everywhere (dic.local_brightness)"
                                              : "light that changes (dic.brightness, dic.local_brightness)");
}

}  // namespace

std::map<std::string, std::string> versions() {
  std::map<std::string, std::string> result = {{"git_revision", revision()}};
  std::istringstream lines(version_text());
  for (std::string line; std::getline(lines, line);) {
    const auto space = line.find(' ');
    result[line.substr(0, space)] = line.substr(space + 1);
  }
  return result;
}

nlohmann::json to_json(const GroupTimes& times) {
  nlohmann::json json = nlohmann::json::object();
  for (const auto& [what, groups] : times)
    for (const GroupTime& time : groups)
      json[what].push_back(
          {{"ranks", time.ranks}, {"busy", io::quantity(time.busy, "s")}, {"idle", io::quantity(time.idle, "s")}});
  return json;
}

std::string not_converged(std::size_t stage, const StageSummary& summary) {
  return fmt::format("stage {} did not converge in {} iterations: {}", stage + 1, summary.iterations,
                     summary.eta > 0.0
                         ? fmt::format("eta is still {:.2e}", summary.eta)
                         : "none was left after the force was weighed anew or load increments were taken off");
}

void say(const GroupTimes& times) {
  for (const auto& [what, groups] : times)
    if (!groups.empty()) spdlog::info("{}: {}", what, to_text(groups));
}

RunOutput::RunOutput(const Communicator& world, std::filesystem::path folder, const io::Case& test,
                     const identification::Specimen& specimen, const Material& material, const Observation& seen)
    : folder_(std::move(folder)), test_(test), specimen_(specimen), seen_(seen) {
  collectively(world, [&] {
    if (!world.is_root()) return;
    io::RunPlan plan;
    plan.versions = versions();
    plan.volume = &specimen.volume;
    plan.surface = &specimen.surface.mesh;
    plan.parameters = material.information;
    file_ = io::create_results(folder_, test, plan);
    for (const auto& face : seen.faces)
      for (std::size_t c = 0; c < face.rig->views.size(); ++c) {
        const auto& camera = test.cameras[static_cast<std::size_t>(face.rig->cameras[c])];
        const auto& positions = face.dic->correlation(static_cast<int>(c)).positions();  // [nodes x 2]
        std::vector<double> pixels;
        for (Eigen::Index i = 0; i < positions.rows(); ++i)
          pixels.insert(pixels.end(), {positions(i, 0), positions(i, 1)});
        io::draw_mesh_on_image(
            folder_ / (test.cameras.size() == 1 ? "mesh_on_image.png" : fmt::format("mesh_on_{}.png", camera.name)),
            camera.images[static_cast<std::size_t>(test.index_of(camera.reference.front()))], face.rig->surface,
            pixels);
      }
  });
}

void RunOutput::dic_frame(int place, const correlation::DicFrame& frame) {
  if (!file_) return;
  const bool known = frame.converged && !frame.lost;  // else its displacement means nothing: better none
  const Eigen::VectorXd nothing =
      Eigen::VectorXd::Constant(frame.displacement.size(), std::numeric_limits<double>::quiet_NaN());
  io::write_dic_frame(*file_, static_cast<std::size_t>(place),
                      span_of(specimen_.three_components(known ? frame.displacement : nothing)), frame.rms,
                      span_of(frame.element_rms));
}

void RunOutput::noise(double sigma) {
  if (file_) io::write_noise(*file_, sigma * seen_.faces.front().dic->noise_response().level);
}

void RunOutput::iteration(int stage, int iteration, const identification::Iterate& at) {
  if (file_) io::write_iteration(*file_, stage, iteration, at.parameters, at.eta, at.image_rms);
}

void RunOutput::identified(const std::vector<double>& values, const Eigen::MatrixXd& covariance,
                           const std::set<int>& on_bound) {
  if (file_) io::write_identified(*file_, values, span_of(covariance), on_bound);
}

void RunOutput::simulation_frame(int place, const mechanics::FrameState& state) {
  if (file_) write_fields(*file_, static_cast<std::size_t>(place), specimen_, state, std::nan(""));
}

void RunOutput::model(const Communicator& world, const identification::ImageData& images,
                      const identification::Record& record, const identification::Path& shown,
                      const identification::Path& driven) {
  const Eigen::Index elements = specimen_.surface.mesh.cells.rows();
  for (int t = 0; t < static_cast<int>(record.frames.size()); ++t) {
    const auto place = static_cast<std::size_t>(seen_.places[static_cast<std::size_t>(t)]);
    if (file_ && t < driven.frames) file_->write("frames/force_predicted", place, std::span(&driven.reaction[t], 1));
    if (t >= shown.frames) continue;
    Eigen::VectorXd all = Eigen::VectorXd::Zero(elements + 1);
    collectively(world, [&] {
      if (t % world.size() != world.rank()) return;
      const auto answer = images.evaluate(t, shown.surface.col(t), Communicator{MPI_COMM_SELF});
      all.head(elements) = answer.element_rms;
      all[elements] = std::sqrt(answer.squares / std::max(1.0, answer.pixels));
    });
    world.sum(std::span(all.data(), static_cast<std::size_t>(all.size())));
    if (file_) io::write_model_residual(*file_, place, all[elements], {all.data(), static_cast<std::size_t>(elements)});
  }
  collectively(world, [&] {
    if (!file_) return;
    for (const int t : telling_frames(record, test_, shown.frames)) draw_residual(t, record, shown);
  });
}

void RunOutput::draw_residual(int t, const identification::Record& record, const identification::Path& shown) const {
  const auto place = static_cast<std::size_t>(seen_.places[static_cast<std::size_t>(t)]);
  const int number = record.frames[static_cast<std::size_t>(t)];
  for (std::size_t k = 0; k < seen_.faces.size(); ++k) {
    const auto& face = specimen_.faces[k];
    const auto& dic = *seen_.faces[k].dic;
    for (std::size_t c = 0; c < seen_.faces[k].rig->views.size(); ++c) {
      const auto camera = static_cast<std::size_t>(seen_.faces[k].rig->cameras[c]);
      const auto image = dic.spline(imaging::read_image(test_.cameras[camera].images[place]));
      const double sigma = seen_.camera_noise[camera] * dic.noise_response().level;
      const auto map = [&](const Eigen::MatrixXd& displacement) {
        return residual_map(dic, static_cast<int>(c), image,
                            displacement.col(t).segment(face.first_unknown, face.unknowns()), sigma,
                            off_epipolar(seen_, k, static_cast<int>(c), static_cast<std::size_t>(t)));
      };
      const ResidualMap above = map(shown.surface), below = map(record.surface_displacement);
      constexpr int gap = 12;
      std::vector<double> both = above.values;
      both.resize(both.size() + static_cast<std::size_t>(gap * above.columns), std::nan(""));
      both.insert(both.end(), below.values.begin(), below.values.end());
      const std::string name = test_.cameras.size() == 1 ? "" : test_.cameras[camera].name;
      io::draw_map(folder_ / fmt::format("residual_{}{}frame_{:04d}.png", name, name.empty() ? "" : "_", number), both,
                   above.columns, 2 * above.rows + gap,
                   {.legend = fmt::format("{}{}residual of the model (above) and of pure DIC (below), frame {} [sigma]",
                                          name, name.empty() ? "" : ": ", number),
                    .lower = -5.0,
                    .upper = 5.0});
    }
  }
}

void RunOutput::freed_at_once(const Material& material, const std::vector<int>& free,
                              const identification::FreedAtOnce& at_once) {
  std::vector<double> changes(material.values.size(), std::nan("")), deviations = changes;
  std::vector<std::string> all, moving;
  in_turn_ = true;
  for (std::size_t i = 0; i < free.size(); ++i) {
    const auto j = static_cast<std::size_t>(free[i]);
    const auto k = static_cast<Eigen::Index>(i);
    const auto& info = material.information[j];
    changes[j] = at_once.step[k], deviations[j] = std::sqrt(std::max(0.0, at_once.noise.covariance.total(k, k)));
    all.push_back(info.name);
    if (std::abs(changes[j]) >
        std::max(unlikely_change * deviations[j], test_.identify.eta * std::abs(material.values[j])))
      moving.push_back(fmt::format("{} by {:.2g} {}", info.name, changes[j], info.unit));
    spdlog::info("  {} {:+.2g} (+- {:.2g}) {}", info.name, changes[j], deviations[j], info.unit);
  }
  if (file_) io::write_freed_at_once(*file_, changes, deviations);
  if (moving.empty()) return;
  doubts_.push_back(fmt::format(
      "stages found the parameters one after another, each as if the others were known. Free at once {} would change "
      "by more than {:g} standard deviations: {}. What a stage held fixed was off (a last stage that frees all of them "
      "tells), or the model errs otherwise in other frames (its mesh; an effect that imic3d loop finds)",
      fmt::join(all, ", "), unlikely_change, fmt::join(moving, ", ")));
  spdlog::warn("{}", doubts_.back());
}

void RunOutput::moved_by(Finer finer, const Material& material, const std::vector<int>& free,
                         const Eigen::VectorXd& moved, const Eigen::MatrixXd& covariance) {
  std::vector<double> changes(material.values.size(), std::nan(""));
  std::vector<std::string> all, moving;
  for (std::size_t i = 0; i < free.size(); ++i) {
    const auto& info = material.information[static_cast<std::size_t>(free[i])];
    const double change = moved[static_cast<Eigen::Index>(i)],
                 deviation = std::sqrt(std::max(0.0, covariance(free[i], free[i])));
    changes[static_cast<std::size_t>(free[i])] = change;
    all.push_back(fmt::format("{} by {:+.2g} {}", info.name, change, info.unit));
    if (std::abs(change) >
        std::max(deviation, test_.identify.eta * std::abs(material.values[static_cast<std::size_t>(free[i])])))
      moving.push_back(fmt::format("{} by {:+.2g} {} ({:.1f} standard deviations)", info.name, change, info.unit,
                                   std::abs(change) / deviation));
  }
  spdlog::info("{} would change {}", finer == Finer::mesh ? "the mesh refined once" : "a simulation in space",
               fmt::join(all, ", "));
  if (file_) io::write_change(*file_, finer == Finer::mesh ? "refined_mesh" : "in_space", changes);
  if (moving.empty()) return;
  const std::string why =
      finer == Finer::mesh
          ? fmt::format("the mesh is coarse: refined once (specimen.refine: {}) it", test_.specimen.refine + 1)
          : "the specimen is thick for plane stress: a simulation in space (specimen.kinematics: 3d)";
  doubts_.push_back(fmt::format("{} would change {}, which no standard deviation holds", why, fmt::join(moving, ", ")));
  spdlog::warn("{}", doubts_.back());
}

void RunOutput::before_checks() {
  if (!file_) return;
  const std::vector<std::string> doubts{
      "the run was not finished when this was written: other doubts, and what a finer mesh or a simulation in space "
      "would change, are missing"};
  auto json = io::summary(*file_);
  json["doubts"] = doubts;
  io::write_json(folder_ / "result.json", json);
  io::write_report(folder_ / "report.html", *file_, io::pictures_in(folder_), doubts);
}

void RunOutput::finish(const Material& material, const Eigen::MatrixXd& covariance,
                       const std::vector<StageSummary>& stages, double force_left, double seconds,
                       const GroupTimes& groups) {
  if (!file_) return;
  auto json = io::summary(*file_);
  auto doubts = doubts_of(test_, seen_);
  doubts.insert(doubts.end(), doubts_.begin(), doubts_.end());
  if (auto doubt = unlikely_correlation(test_, seen_); !doubt.empty()) {
    spdlog::warn("{}", doubt);
    doubts.push_back(std::move(doubt));
  }
  for (auto& doubt : unlikely_values(test_, material, material.values)) doubts.push_back(std::move(doubt));
  if (force_left > unlikely_force) {
    const std::string of_the_record =
        force_left > wrong_force ? " So much is left where images belong to other forces (their order, the clocks, a "
                                   "frame that is missing), the mesh lies elsewhere on the image, or a unit is another "
                                   "one."
                                 : "";
    doubts.push_back(fmt::format(
        "the model leaves {:.3g} {} of the force (rms of the fitted frames), {:.1f} times its noise.{} What it lacks "
        "(a finer mesh{}, an effect that imic3d loop finds{}) may move the parameters by more than their standard "
        "deviations, which are those of noise alone",
        json["/fitted/force_rms_difference/value"_json_pointer].get<double>(), test_.units.force, force_left,
        of_the_record,
        test_.identify.steps_per_frame > 0 ? ", more load increments between frames: identify.steps_per_frame: auto"
                                           : "",
        test_.identify.functional != "force_driven"
            ? "; or a mesh that is turned against the specimen by a tenth of a degree, which driven ends take for shear"
            : ""));
    spdlog::warn("{}", doubts.back());
  }
  for (std::size_t k = 0; k < stages.size(); ++k)
    if (!stages[k].converged)
      doubts.push_back(not_converged(k, stages[k]) +
                       ", and the parameters are where it stopped (a start nearer to them, identify.max_iterations, "
                       "fewer parameters free)");
  for (const auto& stage : stages)
    if (!stage.unknown_noise.empty())
      doubts.push_back(
          fmt::format("the standard deviations of {} hold no noise that acts through the simulation, of load record "
                      "and driven ends: {}",
                      fmt::join(stage.free, ", "), stage.unknown_noise));
  for (std::size_t k = 0; k < stages.size(); ++k) {
    std::vector<std::string> unseen;
    for (std::size_t j = 0; j < stages[k].free.size(); ++j)
      if (const auto i = static_cast<Eigen::Index>(j); std::isinf(stages[k].covariance.total(i, i)))
        unseen.push_back(stages[k].free[j]);
    if (unseen.empty()) continue;
    doubts.push_back(
        fmt::format("{} not determined: the frames of stage {} do not show {}. Other frames of it may, or the "
                    "parameter is better held fixed",
                    fmt::join(unseen, ", "), k + 1, unseen.size() > 1 ? "them, at least not apart" : "it"));
    spdlog::warn("{}", doubts.back());
  }
  for (const auto& stage : stages) {
    if (stage.unsure.size() == 0) continue;
    std::vector<std::string> moved;
    for (std::size_t j = 0; j < stage.free.size(); ++j)
      moved.push_back(fmt::format("{} by {:.2g}", stage.free[j], stage.unsure[static_cast<Eigen::Index>(j)]));
    doubts.push_back(
        fmt::format("{} instead of {} load increments between two frames still move {}: what they err by was taken off "
                    "no better than that; frames that are nearer to one another would tell",
                    stage.increments, stage.increments / 2, fmt::join(moved, ", ")));
    spdlog::warn("{}", doubts.back());
  }
  if (!doubts.empty()) json["doubts"] = doubts;
  for (const auto& stage : stages) {
    json["stages"].push_back({{"free", stage.free},
                              {"iterations", stage.iterations},
                              {"steps_per_frame", stage.increments},
                              {"converged", stage.converged},
                              {"message", stage.message}});
    for (std::size_t j = 0; j < stage.free.size(); ++j) {
      const auto deviation = [&](const Eigen::MatrixXd& of) {
        return std::sqrt(of(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(j)));
      };
      auto& of_parameter = json["stages"].back()["standard_deviation"][stage.free[j]];
      of_parameter = {{"images", deviation(stage.covariance.image)},
                      {"total", deviation(stage.covariance.total)}};  // null: not determined
      if (test_.identify.noise_draws == 0) continue;
      of_parameter["force"] = deviation(stage.covariance.force);
      of_parameter["boundary"] = deviation(stage.covariance.boundary);
      of_parameter["calibration"] = deviation(stage.covariance.calibration);
    }
  }
  json["noise"] = {
      {"image", io::quantity(seen_.noise, "grey level")},
      {"smoothed_image", io::quantity(seen_.noise * seen_.faces.front().dic->noise_response().level, "grey level")},
      {"image_is_measured", seen_.noise_is_measured}};
  for (std::size_t c = 0; c < test_.cameras.size() && test_.cameras.size() > 1; ++c)
    json["noise"]["cameras"][test_.cameras[c].name] = io::quantity(seen_.camera_noise[c], "grey level");
  json["time"] = io::quantity(seconds, "s");
  if (auto times = to_json(groups); !times.empty()) json["groups"] = std::move(times);
  io::write_json(folder_ / "result.json", json);
  io::draw_pictures(*file_, folder_);
  io::write_report(folder_ / "report.html", *file_, io::pictures_in(folder_), doubts);

  fmt::print("\n{}\n", test_.title);
  for (std::size_t j = 0; j < material.values.size(); ++j) {
    const auto k = static_cast<Eigen::Index>(j);
    const double deviation = std::sqrt(covariance(k, k));
    fmt::print("  {:8} {:14.6g} {:10} {}\n", material.information[j].name, material.values[j],
               material.information[j].unit,
               json["parameters"][material.information[j].name]["on_bound"] == true ? "(on its bound)"
               : std::isinf(deviation)                                              ? "(not determined)"
               : std::isfinite(deviation) ? fmt::format("+- {:.2g} ({}noise alone{})", deviation,
                                                        test_.identify.noise_draws > 0 ? ""
                                                        : test_.identify.functional == "displacement_driven" ||
                                                                test_.identify.functional == "combined"
                                                            ? "images' and force's "
                                                            : "images' ",
                                                        in_turn_ ? ", the others as if known" : "")
                                          : "(fixed)");
  }
  if (test_.identify.noise_draws > 0)
    for (const auto& stage : stages)
      for (std::size_t j = 0; j < stage.free.size(); ++j) {
        const auto k = static_cast<Eigen::Index>(j);
        if (std::isinf(stage.covariance.total(k, k))) continue;
        fmt::print("    noise of {}: images {:.2g}, load record {:.2g}, driven ends {:.2g}, calibration {:.2g}\n",
                   stage.free[j], std::sqrt(stage.covariance.image(k, k)), std::sqrt(stage.covariance.force(k, k)),
                   std::sqrt(stage.covariance.boundary(k, k)), std::sqrt(stage.covariance.calibration(k, k)));
      }
  fmt::print("  {:.0f} s; report: {}\n", seconds, (folder_ / "report.html").string());
}

SimulationOutput::SimulationOutput(const Communicator& world, std::filesystem::path folder, const io::Case& test,
                                   const identification::Specimen& specimen)
    : folder_(std::move(folder)), specimen_(specimen) {
  collectively(world, [&] {
    if (!world.is_root()) return;
    io::RunPlan plan;
    plan.versions = versions();
    plan.volume = &specimen.volume;
    file_ = io::create_results(folder_, test, plan);
    // At rest, unless there is an initial strain, whose state is simulated.
    mechanics::FrameState rest;
    rest.displacement = rest.internal = Eigen::VectorXd::Zero(3 * specimen.volume.nodes.rows());
    rest.cauchy_stress.setZero(specimen.volume.cells.rows(), 6);
    rest.plastic_strain.setZero(specimen.volume.cells.rows());
    write_fields(*file_, 0, specimen_, rest, 0.0);
  });
}

void SimulationOutput::frame(int frame, const mechanics::FrameState& state, double force) {
  if (file_) write_fields(*file_, static_cast<std::size_t>(frame), specimen_, state, force);
}

void SimulationOutput::finish() { finish(nlohmann::json::object()); }

nlohmann::json SimulationOutput::finish(const nlohmann::json& more) {
  if (!file_) return {};
  auto json = io::summary(*file_);
  json.update(more);
  io::write_json(folder_ / "result.json", json);
  return json;
}

}  // namespace imic3d::app
