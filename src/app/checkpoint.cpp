#include "checkpoint.hpp"

#include <fmt/format.h>

#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/log.hpp"

namespace imic3d::app {

namespace {

namespace id = identification;
using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using io::Checkpoint;

MatrixXd column(const std::vector<double>& values) {
  return Eigen::Map<const VectorXd>(values.data(), static_cast<Index>(values.size()));
}
std::vector<double> values_of(const MatrixXd& column) { return {column.data(), column.data() + column.size()}; }

MatrixXd columns(const std::vector<VectorXd>& vectors) {
  MatrixXd matrix(vectors.empty() ? 0 : vectors.front().size(), static_cast<Index>(vectors.size()));
  for (std::size_t j = 0; j < vectors.size(); ++j) matrix.col(static_cast<Index>(j)) = vectors[j];
  return matrix;
}
std::vector<VectorXd> vectors_of(const MatrixXd& matrix) {
  std::vector<VectorXd> vectors;
  for (Index j = 0; j < matrix.cols(); ++j) vectors.emplace_back(matrix.col(j));
  return vectors;
}

// Frames of a series; those that are kept already do not change any more.
std::string frame_name(const std::string& at, std::size_t t) { return fmt::format("{}frames/{:06d}", at, t); }

void put(Checkpoint& into, const std::string& at, const correlation::DicSeries& series, std::size_t first) {
  into.put(at + "starts", columns(series.starts));
  into.put(at + "lost", column({series.lost.begin(), series.lost.end()}));
  into.put(at + "round", series.round);
  into.put(at + "left_out", column({series.left_out.begin(), series.left_out.end()}));
  into.put(at + "done", static_cast<double>(series.frames.size()));
  if (!series.frames.empty()) {
    const auto& frame = series.frames.front();
    into.put(at + "unknowns", static_cast<double>(frame.displacement.size()));
    into.put(at + "elements", static_cast<double>(frame.element_rms.size()));
    into.put(at + "cameras", static_cast<double>(frame.cameras.size()));
  }
  for (std::size_t t = first; t < series.frames.size(); ++t)
    into.put(frame_name(at, t), correlation::numbers_of(series.frames[t]));
}
correlation::DicSeries series_of(const Checkpoint& from, const std::string& at) {
  correlation::DicSeries series;
  series.starts = vectors_of(from.matrix(at + "starts"));
  for (const double lost : values_of(from.matrix(at + "lost"))) series.lost.push_back(lost > 0.5 ? 1 : 0);
  series.round = from.count(at + "round");
  for (const double left_out : values_of(from.matrix(at + "left_out")))
    series.left_out.push_back(left_out > 0.5 ? 1 : 0);
  for (int t = 0; t < from.count(at + "done"); ++t)
    series.frames.push_back(correlation::frame_of(from.matrix(frame_name(at, static_cast<std::size_t>(t))),
                                                  from.count(at + "unknowns"), from.count(at + "elements"),
                                                  from.count(at + "cameras")));
  return series;
}

void put(Checkpoint& into, const std::string& at, const std::vector<id::Iterate>& iterates) {
  into.put(at + "count", static_cast<double>(iterates.size()));
  for (std::size_t i = 0; i < iterates.size(); ++i) {
    const auto& one = iterates[i];
    into.put(fmt::format("{}{}/parameters", at, i), column(one.parameters));
    into.put(fmt::format("{}{}/numbers", at, i),
             column({one.eta, one.displacement_rms, one.image_rms, one.force_rms, one.cost,
                     static_cast<double>(one.frames), static_cast<double>(one.increments)}));
    into.put(fmt::format("{}{}/message", at, i), one.message);
  }
}
std::vector<id::Iterate> iterates_of(const Checkpoint& from, const std::string& at) {
  std::vector<id::Iterate> iterates;
  for (int i = 0; i < from.count(at + "count"); ++i) {
    const auto numbers = values_of(from.matrix(fmt::format("{}{}/numbers", at, i)));
    iterates.push_back({.parameters = values_of(from.matrix(fmt::format("{}{}/parameters", at, i))),
                        .eta = numbers.at(0),
                        .displacement_rms = numbers.at(1),
                        .image_rms = numbers.at(2),
                        .force_rms = numbers.at(3),
                        .cost = numbers.at(4),
                        .frames = static_cast<int>(numbers.at(5)),
                        .increments = static_cast<int>(numbers.at(6)),
                        .message = from.text(fmt::format("{}{}/message", at, i))});
  }
  return iterates;
}

void put(Checkpoint& into, const std::string& at, const id::Covariance& covariance) {
  for (const auto& [name, part] : {std::pair{"image", &covariance.image},
                                   {"force", &covariance.force},
                                   {"boundary", &covariance.boundary},
                                   {"calibration", &covariance.calibration},
                                   {"total", &covariance.total}})
    into.put(at + name, *part);
}
id::Covariance covariance_of(const Checkpoint& from, const std::string& at) {
  id::Covariance covariance;
  for (const auto& [name, part] : {std::pair{"image", &covariance.image},
                                   {"force", &covariance.force},
                                   {"boundary", &covariance.boundary},
                                   {"calibration", &covariance.calibration},
                                   {"total", &covariance.total}})
    *part = from.matrix(at + name);
  return covariance;
}

void put(Checkpoint& into, const std::string& at, const id::FinerIncrements& finer) {
  into.put(at + "number", static_cast<double>(finer.number));
  into.put(at + "parameters", column(finer.parameters));
  for (const auto& [name, part] : {std::pair{"endless", &finer.endless}, {"first", &finer.first}}) {
    into.put(fmt::format("{}{}/surface", at, name), part->surface);
    into.put(fmt::format("{}{}/reaction", at, name), part->reaction);
  }
  into.put(at + "unsure", finer.unsure);
}
id::FinerIncrements finer_increments_of(const Checkpoint& from, const std::string& at) {
  return {.number = from.count(at + "number"),
          .parameters = values_of(from.matrix(at + "parameters")),
          .endless = {from.matrix(at + "endless/surface"), from.matrix(at + "endless/reaction")},
          .first = {from.matrix(at + "first/surface"), from.matrix(at + "first/reaction")},
          .unsure = from.matrix(at + "unsure")};
}

void put(Checkpoint& into, const std::string& at, const id::StagePoint& point) {
  put(into, at + "iterates/", point.iterates);
  into.put(at + "converged", point.converged ? 1.0 : 0.0);
  into.put(at + "frames", static_cast<double>(point.linear.frames));
  into.put(at + "surface", point.linear.surface);
  into.put(at + "reaction", point.linear.reaction);
  into.put(at + "message", point.linear.message);
  into.put(at + "free", static_cast<double>(point.linear.sensitivity.size()));
  for (std::size_t j = 0; j < point.linear.sensitivity.size(); ++j)
    into.put(fmt::format("{}sensitivity/{}", at, j), point.linear.sensitivity[j]);
  into.put(at + "force_sensitivity", columns(point.linear.force_sensitivity));
  put(into, at + "finer/", point.finer);
  into.put(at + "noise/parameters", column(point.noise.parameters));
  into.put(at + "noise/difference", point.noise.difference);
  into.put(at + "noise/unknown", point.noise.unknown);
  put(into, at + "noise/covariance/", point.noise.covariance);
  const auto& normal = point.normal;
  into.put(at + "matrix", normal.matrix);
  into.put(at + "right", normal.right);
  into.put(at + "sums", column({normal.cost, normal.squares, normal.pixels, normal.distance, normal.force,
                                static_cast<double>(normal.frames)}));
}
id::StagePoint point_of(const Checkpoint& from, const std::string& at) {
  id::StagePoint point;
  point.iterates = iterates_of(from, at + "iterates/");
  point.converged = from.number(at + "converged") > 0.5;
  point.linear.frames = from.count(at + "frames");
  point.linear.surface = from.matrix(at + "surface");
  point.linear.reaction = from.matrix(at + "reaction");
  point.linear.message = from.text(at + "message");
  for (int j = 0; j < from.count(at + "free"); ++j)
    point.linear.sensitivity.push_back(from.matrix(fmt::format("{}sensitivity/{}", at, j)));
  point.linear.force_sensitivity = vectors_of(from.matrix(at + "force_sensitivity"));
  point.finer = finer_increments_of(from, at + "finer/");
  point.noise = {.parameters = values_of(from.matrix(at + "noise/parameters")),
                 .covariance = covariance_of(from, at + "noise/covariance/"),
                 .difference = from.matrix(at + "noise/difference"),
                 .unknown = from.text(at + "noise/unknown")};
  point.normal.matrix = from.matrix(at + "matrix");
  point.normal.right = from.matrix(at + "right");
  const auto sums = values_of(from.matrix(at + "sums"));
  point.normal.cost = sums.at(0), point.normal.squares = sums.at(1), point.normal.pixels = sums.at(2);
  point.normal.distance = sums.at(3), point.normal.force = sums.at(4),
  point.normal.frames = static_cast<int>(sums.at(5));
  return point;
}

void put(Checkpoint& into, const std::string& at, const StageDone& stage) {
  into.put(at + "values", column(stage.values));
  put(into, at + "iterates/", stage.result.iterates);
  into.put(at + "converged", stage.result.converged ? 1.0 : 0.0);
  into.put(at + "message", stage.result.message);
  put(into, at + "finer/", stage.result.finer);
  into.put(at + "difference", stage.result.difference);
  into.put(at + "unknown_noise", stage.result.unknown_noise);
  put(into, at + "covariance/", stage.result.covariance);
}
StageDone stage_of(const Checkpoint& from, const std::string& at) {
  StageDone stage{.values = values_of(from.matrix(at + "values")), .result = {}};
  stage.result.iterates = iterates_of(from, at + "iterates/");
  stage.result.converged = from.number(at + "converged") > 0.5;
  stage.result.message = from.text(at + "message");
  stage.result.finer = finer_increments_of(from, at + "finer/");
  stage.result.difference = from.matrix(at + "difference");
  stage.result.unknown_noise = from.text(at + "unknown_noise");
  stage.result.covariance = covariance_of(from, at + "covariance/");
  return stage;
}

id::Solutions solutions_of(const Checkpoint& from, const std::string& at) {
  id::Solutions solutions;
  for (std::size_t k = 0; k < solutions.size(); ++k) {
    const std::string of = fmt::format("{}{}/", at, k);
    auto& solution = solutions[k];
    solution.parameters = values_of(from.matrix(of + "parameters"));
    for (const double j : values_of(from.matrix(of + "free"))) solution.free.push_back(static_cast<int>(j));
    solution.displacement = vectors_of(from.matrix(of + "displacement"));
    solution.d_displacement.resize(solution.displacement.size());
    for (std::size_t j = 0; j < solution.free.size(); ++j) {
      const auto& derivative = from.matrix(fmt::format("{}derivative/{}", of, j));
      for (Index t = 0; t < derivative.cols(); ++t)
        solution.d_displacement[static_cast<std::size_t>(t)].emplace_back(derivative.col(t));
    }
  }
  return solutions;
}

RunState state_of(const Checkpoint& from) {
  RunState state;
  for (int k = 0; from.has(fmt::format("dic/{}/done", k)); ++k)
    state.dic.push_back(series_of(from, fmt::format("dic/{}/", k)));
  if (from.has("reaction_noise")) state.reaction_noise = from.number("reaction_noise");
  for (int k = 0; from.has(fmt::format("stages/{}/values", k)); ++k)
    state.stages.push_back(stage_of(from, fmt::format("stages/{}/", k)));
  if (from.has("point/converged")) state.point = point_of(from, "point/");
  if (from.has("solutions/0/parameters")) state.solutions = solutions_of(from, "solutions/");
  return state;
}

std::string reached_by(const RunState& state) {
  std::size_t frames = 0, coarse = 0;
  for (const auto& series : state.dic) frames += series.frames.size(), coarse += series.starts.size();
  if (state.stages.empty() && !state.point)
    return frames > 0 ? fmt::format("{} of {} frames correlated", frames, coarse)
                      : fmt::format("{} frames on the coarse levels", coarse);
  return state.point
             ? fmt::format("iteration {} of stage {}", state.point->iterates.size() - 1, state.stages.size() + 1)
             : fmt::format("stage {} done", state.stages.size());
}

}  // namespace

RunCheckpoint::RunCheckpoint(const Communicator& world, const std::filesystem::path& folder, const io::Case& test,
                             bool resume)
    : world_(world),
      file_(
          world, folder / "checkpoint.h5", [&] { return io::fingerprint(test); }, resume) {
  if (!file_.found()) return;
  found_ = state_of(file_.everywhere());
  stages_ = found_.stages.size();
  for (const auto& series : found_.dic) kept_.push_back(series.frames.size());
  spdlog::info("goes on from {}: {}", file_.path().string(), reached_by(found_));
}

void RunCheckpoint::reaction_noise(double noise) {
  if (world_.is_root()) file_.content().put("reaction_noise", noise);
}

void RunCheckpoint::dic(std::size_t face, const correlation::DicSeries& series, std::size_t frames) {
  if (kept_.size() <= face) kept_.resize(face + 1, 0);
  kept_[face] = std::min(kept_[face], series.frames.size());  // a series may begin again, without what was lost
  const bool first_frames = kept_[face] == 0 && !series.frames.empty();
  const auto keep = [&] {
    if (!world_.is_root()) return;
    app::put(file_.content(), fmt::format("dic/{}/", face), series, kept_[face]);
    kept_[face] = series.frames.size();
  };
  try {
    stop_if_asked(world_);
  } catch (const Interrupted&) {
    keep(), file_.write();
    throw;
  }
  if (first_frames || series.frames.size() == frames || file_.due()) keep(), file_.write();
}

void RunCheckpoint::put(const identification::Solutions& solutions) {
  file_.content().erase("solutions/");
  for (std::size_t k = 0; k < solutions.size(); ++k) {
    const std::string of = fmt::format("solutions/{}/", k);
    const auto& solution = solutions[k];
    file_.content().put(of + "parameters", column(solution.parameters));
    file_.content().put(of + "free", column({solution.free.begin(), solution.free.end()}));
    file_.content().put(of + "displacement", columns(solution.displacement));
    for (std::size_t j = 0; j < solution.free.size(); ++j) {
      std::vector<VectorXd> derivative;
      for (const auto& of_frame : solution.d_displacement) derivative.push_back(of_frame.at(j));
      file_.content().put(fmt::format("{}derivative/{}", of, j), columns(derivative));
    }
  }
}

void RunCheckpoint::stage_point(const identification::StagePoint& point, const identification::Solutions& solutions) {
  if (world_.is_root()) {
    file_.content().erase("point/");
    app::put(file_.content(), "point/", point);
    put(solutions);
  }
  file_.write();
  stop_if_asked(world_);
}

void RunCheckpoint::stage_done(const StageDone& stage, const identification::Solutions* solutions) {
  if (world_.is_root()) {
    file_.content().erase("point/");
    file_.content().erase("solutions/");
    app::put(file_.content(), fmt::format("stages/{}/", stages_), stage);
    if (solutions != nullptr) put(*solutions);
  }
  ++stages_;
  file_.write();
  stop_if_asked(world_);
}

}  // namespace imic3d::app
