// The series of frames: one followed into the next on the coarse levels, then all side by side on the finest.

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <future>

#include "imic3d/core/error.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/imaging/pyramid.hpp"
#include "patch_search.hpp"

namespace imic3d::correlation {
namespace {

constexpr int parallel_levels = 2;  // the finest levels, which run over the frames side by side

/// The images of a frame, read by a thread of their own while the frame before is correlated.
class ReadAhead {
 public:
  using Images = std::vector<imaging::Image>;
  /// `read(frame)` for the frames first, first + step, ... below `frames`.
  ReadAhead(std::function<Images(int)> read, int first, int step, int frames)
      : read_(std::move(read)), step_(step), frames_(frames) {
    start(first);
  }
  /// The images of `frame`, which is next in turn. Throws what `read` threw.
  [[nodiscard]] Images take(int frame) {
    Images images = next_.get();
    start(frame + step_);
    return images;
  }

 private:
  void start(int frame) {
    if (frame < frames_) next_ = std::async(std::launch::async, read_, frame);
  }
  std::function<Images(int)> read_;
  int step_, frames_;
  std::future<Images> next_;
};

imaging::Image reduced(imaging::Image image, int times) {
  for (int k = 0; k < times; ++k) image = imaging::half_size(image);
  return image;
}

}  // namespace

// The next frame of a series on the coarse levels, down to `finest`, of which `coarse` are the images; `before` are the
// displacements of the frames before it.
DicFrame GlobalDic::follow(const std::vector<imaging::Image>& coarse, const std::vector<Eigen::VectorXd>& before,
                           int finest) const {
  const Communicator alone{MPI_COMM_SELF};
  const int top = levels() - 1;
  const Level& coarsest = levels_.back();
  std::vector<std::vector<imaging::Image>> pyramid = {coarse};
  for (int level = finest + 1; level <= top; ++level) pyramid.push_back(imaging::half_sizes(pyramid.back()));
  std::vector<std::vector<imaging::BSpline>> splined;
  for (int level = finest; level <= top; ++level)
    splined.push_back(splines(pyramid[static_cast<std::size_t>(level - finest)], level));

  // Start where the motion so far leads, or where the last frame was, whichever matches better.
  std::vector<Eigen::VectorXd> starts;
  if (before.empty()) starts.push_back(Eigen::VectorXd::Zero(coarsest.cameras->unknowns()));
  if (!before.empty()) starts.push_back(before.back());
  if (before.size() > 1) starts.push_back(2.0 * before.back() - before[before.size() - 2]);
  const auto match = [&](const Eigen::VectorXd& U) {
    const JointEvaluation seen = coarsest.cameras->evaluate(splined.back(), U, alone);
    return seen.coefficient * seen.pixels / std::max(1.0, seen.pixels + seen.dropped);
  };
  const Eigen::VectorXd start = *std::max_element(starts.begin(), starts.end(),
                                                  [&](const auto& a, const auto& b) { return match(a) < match(b); });
  DicFrame frame;
  frame.displacement = start;
  solve_level(top, splined.back(), alone, frame);
  // Not a clear match: look for patches everywhere in each camera's image, first those deformed like the last frame;
  // the motions of the images together make a displacement. So too if single elements match badly: a corner of the mesh
  // may have run astray.
  constexpr double clear = 0.8;
  std::vector<double> rms(frame.element_rms.begin(), frame.element_rms.end());
  std::sort(rms.begin(), rms.end());
  const bool astray = rms.back() > 4.0 * rms[rms.size() / 2];
  if (frame.coefficient < clear || frame.lost || astray) {
    for (const Eigen::VectorXd& from : {start, Eigen::VectorXd(Eigen::VectorXd::Zero(start.size()))}) {
      std::vector<std::optional<InImage>> moved;
      for (int c = 0; c < cameras().size(); ++c) {
        const auto k = static_cast<std::size_t>(c);
        const double reach = 0.5 * std::max(coarse[k].width, coarse[k].height) / std::ldexp(1.0, top - finest);
        moved.push_back(search_patches((*coarsest.cameras)[c], coarsest.references[k], pyramid.back()[k], from, reach));
      }
      if (std::none_of(moved.begin(), moved.end(), [](const auto& one) { return one.has_value(); })) continue;
      DicFrame other;
      other.displacement = coarsest.cameras->displacement(moved, from);
      solve_level(top, splined.back(), alone, other);
      if (other.coefficient > frame.coefficient + std::min(0.02, 0.5 * (1.0 - frame.coefficient)))
        frame = std::move(other);
      if (frame.coefficient > clear) break;
    }
  }
  for (int level = top - 1; level >= finest; --level)
    solve_level(level, splined[static_cast<std::size_t>(level - finest)], alone, frame);
  return frame;
}

namespace {
// numbers beside displacement and residuals of the elements
constexpr Eigen::Index of_frame = 10, of_camera = 6;
}  // namespace

Eigen::VectorXd numbers_of(const DicFrame& frame) {
  const Eigen::Index unknowns = frame.displacement.size(), elements = frame.element_rms.size();
  const auto count = static_cast<Eigen::Index>(frame.cameras.size());
  Eigen::VectorXd all(unknowns + elements + of_frame + count * (elements + of_camera) + frame.epipolar.size());
  all.head(unknowns) = frame.displacement;
  all.segment(unknowns, elements) = frame.element_rms;
  all.segment<of_frame>(unknowns + elements) << frame.converged, frame.lost, frame.iterations, frame.rms,
      frame.coefficient, frame.pixels, frame.dropped, frame.gain, frame.offset, frame.hardly_seen;
  for (Eigen::Index c = 0; c < count; ++c) {
    const CameraFrame& own = frame.cameras[static_cast<std::size_t>(c)];
    auto part = all.segment(unknowns + elements + of_frame + c * (elements + of_camera), elements + of_camera);
    part.head(elements) = own.element_rms;
    part.tail<of_camera>() << own.rms, own.coefficient, own.pixels, own.dropped, own.gain, own.offset;
  }
  all.tail(frame.epipolar.size()) = frame.epipolar;
  return all;
}

DicFrame frame_of(const Eigen::VectorXd& numbers, Eigen::Index unknowns, Eigen::Index elements, int cameras) {
  DicFrame frame;
  frame.displacement = numbers.head(unknowns);
  frame.element_rms = numbers.segment(unknowns, elements);
  const double* values = numbers.data() + unknowns + elements;
  frame.converged = values[0] > 0.5, frame.lost = values[1] > 0.5;
  frame.iterations = static_cast<int>(values[2]);
  frame.rms = values[3], frame.coefficient = values[4];
  frame.pixels = values[5], frame.dropped = values[6];
  frame.gain = values[7], frame.offset = values[8];
  frame.hardly_seen = static_cast<int>(values[9]);
  for (Eigen::Index c = 0; c < cameras; ++c) {
    const auto part =
        numbers.segment(unknowns + elements + of_frame + c * (elements + of_camera), elements + of_camera);
    const auto own = part.tail<of_camera>();
    frame.cameras.push_back({.rms = own[0],
                             .coefficient = own[1],
                             .pixels = own[2],
                             .dropped = own[3],
                             .gain = own[4],
                             .offset = own[5],
                             .element_rms = part.head(elements)});
  }
  frame.epipolar = numbers.tail(numbers.size() - (unknowns + elements + of_frame + cameras * (elements + of_camera)));
  return frame;
}

GroupPlan plan_frames(int ranks, int frames, double image_pixels, double mesh_pixels, int groups) {
  return plan_groups(ranks, {.tasks = frames, .serial = image_pixels / (image_pixels + 2.0 * mesh_pixels)}, groups);
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world, const std::vector<std::filesystem::path>& images,
                                     const Done& done) const {
  return run(world, std::vector<std::vector<std::filesystem::path>>{images}, done);
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world, int frames, const Source& source,
                                     const Done& done) const {
  return run(world, frames, SourceOfAll([&source](int frame, int) { return source(frame); }), done);
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world,
                                     const std::vector<std::vector<std::filesystem::path>>& images, const Done& done,
                                     DicSeries known, const Reached& reached) const {
  const auto read = [&](int frame, int camera) {
    return imaging::read_image(images[static_cast<std::size_t>(camera)][static_cast<std::size_t>(frame)]);
  };
  return run(world, static_cast<int>(images.front().size()), SourceOfAll(read), done, std::move(known), reached);
}

std::vector<DicFrame> GlobalDic::run(const Communicator& world, int frames, const SourceOfAll& source, const Done& done,
                                     DicSeries known, const Reached& reached) const {
  const int split = std::min(parallel_levels, levels() - 1);  // the finest of the coarse levels
  const int count = cameras().size();
  const auto read = [&](int frame, int camera) {
    imaging::Image image = source(frame, camera);
    const imaging::ImageHeader& reference = levels_.front().sizes[static_cast<std::size_t>(camera)];
    if (image.width != reference.width || image.height != reference.height)
      throw InputError(image.path.empty() ? fmt::format("frame {}", frame) : image.path.string(),
                       fmt::format("{} x {} pixels", image.width, image.height),
                       fmt::format("{} x {} pixels like the reference image", reference.width, reference.height));
    return image;
  };
  Progress progress(world, "DIC", 2 * frames);

  // Coarse levels in the order of time. Each rank reads and reduces one frame of a batch; all then follow the motion
  // alike, which is cheap and needs no message.
  std::vector<Eigen::VectorXd> trusted;
  for (std::size_t t = 0; t < known.starts.size(); ++t)
    if (known.lost[t] == 0) trusted.push_back(known.starts[t]);
  std::vector<imaging::Image> empty;
  for (const imaging::ImageHeader& size : levels_[static_cast<std::size_t>(split)].sizes)
    empty.emplace_back(size.width, size.height);
  const auto images_of = [&](int frame, int times) {
    std::vector<imaging::Image> images;
    for (int c = 0; c < count; ++c) images.push_back(reduced(read(frame, c), times));
    return images;
  };
  const auto begun = static_cast<int>(known.starts.size());
  ReadAhead coarse_images([&](int frame) { return images_of(frame, split); }, begun + world.rank(), world.size(),
                          frames);
  for (int first = begun; first < frames; first += world.size()) {
    std::vector<imaging::Image> mine = empty;
    collectively(world, [&] {
      if (first + world.rank() < frames) mine = coarse_images.take(first + world.rank());
    });
    for (int frame = first; frame < std::min(frames, first + world.size()); ++frame) {
      std::vector<imaging::Image> coarse = frame - first == world.rank() ? mine : empty;
      for (imaging::Image& image : coarse)
        MPI_Bcast(image.grey.data(), static_cast<int>(image.grey.size()), MPI_FLOAT, frame - first, world.handle);
      const DicFrame followed = follow(coarse, trusted, split);
      known.starts.push_back(followed.displacement);
      known.lost.push_back(followed.lost ? 1 : 0);
      if (!followed.lost) trusted.push_back(followed.displacement);
      progress.update(frame + 1, fmt::format("coarse levels, frame {} of {}", frame + 1, frames));
    }
    if (reached) reached(known);
  }

  // Finer levels: frames over groups of ranks, gathered about every 10 s.
  for (std::size_t frame = 0; frame < known.frames.size(); ++frame)
    if (done) done(static_cast<int>(frame), known.frames[frame]);
  double image_pixels = 0.0, mesh_pixels = 0.0;
  for (int c = 0; c < count; ++c) {
    const imaging::ImageHeader& size = levels_.front().sizes[static_cast<std::size_t>(c)];
    image_pixels += static_cast<double>(size.width) * size.height;
    mesh_pixels += static_cast<double>(correlation(c).quadrature().pixels());
  }
  const GroupLayout layout(world, frames,
                           plan_frames(world.size(), frames, image_pixels, mesh_pixels, options_.groups).groups());
  const int groups = layout.groups();
  GroupClock clock(layout);
  constexpr double period = 10.0;  // [s]
  int in_turn = 1;                 // frames of a group until then
  ReadAhead fine_images([&](int frame) { return images_of(frame, 0); },
                        static_cast<int>(known.frames.size()) + layout.index(), groups, frames);
  while (static_cast<int>(known.frames.size()) < frames) {
    const auto first = static_cast<int>(known.frames.size());
    const int last = first + std::min(frames - first, in_turn * groups);
    const auto begin = std::chrono::steady_clock::now();
    std::vector<DicFrame> mine(static_cast<std::size_t>(last - first));
    clock.side_by_side([&] {
      for (int frame = first + layout.index(); frame < last; frame += groups) {
        std::vector<imaging::Image> images;
        collectively(layout.group(), [&] { images = fine_images.take(frame); });
        DicFrame& result = mine[static_cast<std::size_t>(frame - first)];
        result = correlate(std::move(images), known.starts[static_cast<std::size_t>(frame)], std::max(0, split - 1), 0,
                           layout.group());
        progress.update(frames + frame + 1,
                        fmt::format("frame {} of {}, residual {:.2f} grey levels", frame + 1, frames, result.rms));
      }
    });
    const Eigen::Index unknowns = cameras().unknowns(), elements = cameras().elements();
    for (int frame = first; frame < last; ++frame) {
      Eigen::VectorXd numbers = Eigen::VectorXd::Zero(unknowns + elements + of_frame + count * (elements + of_camera) +
                                                      cameras().epipolar_modes());
      if ((frame - first) % groups == layout.index() && layout.group().is_root())
        numbers = numbers_of(mine[static_cast<std::size_t>(frame - first)]);
      world.sum(std::span(numbers.data(), static_cast<std::size_t>(numbers.size())));
      known.frames.push_back(frame_of(numbers, unknowns, elements, count));
      if (done) done(frame, known.frames.back());
    }
    const double seconds = world.max(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    in_turn =
        static_cast<int>(std::clamp(period * in_turn / std::max(seconds, 1e-9), 1.0, static_cast<double>(frames)));
    known.group_times = clock.times();
    if (reached) reached(known);
  }
  return std::move(known.frames);
}

}  // namespace imic3d::correlation
