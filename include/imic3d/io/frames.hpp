#pragma once
// Frame numbers as a user writes them: "1-5", "0,2,7-9", "10-40:5".

#include <string>
#include <vector>

namespace imic3d::io {

/// Ascending frame numbers.
using Frames = std::vector<int>;

constexpr int largest_frame = 1'000'000;

/// One part of a selection: first to last in steps; a single frame has first = last.
struct FrameRange {
  int first = 0, last = 0, step = 1;
  bool single = false;  ///< written as one number, so this very frame is meant
};

/// Reads "1-5", "0,2,7-9" or "10-40:5". Throws InputError with an empty place (the caller knows it).
[[nodiscard]] std::vector<FrameRange> parse_frames(const std::string& text, const std::string& what = "frame");

/// All numbers of the ranges, ascending and without repetition.
[[nodiscard]] Frames expand(const std::vector<FrameRange>& ranges);

/// Those of the numbers that are in `available` (ascending). Throws InputError with an empty place if a single frame is
/// not there, or a range reaches beyond the last frame or selects nothing.
/// `what`: what is numbered, for the message.
[[nodiscard]] Frames select(const std::vector<FrameRange>& ranges, const Frames& available,
                            const std::string& what = "frame");

/// Short form, e.g. "0-12,14,20".
[[nodiscard]] std::string to_text(const Frames& frames);

}  // namespace imic3d::io
