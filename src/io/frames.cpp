#include "imic3d/io/frames.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <iterator>
#include <set>

#include "imic3d/core/error.hpp"

namespace imic3d::io {

namespace {

constexpr const char* syntax = " numbers such as 3, \"1-5\", \"0,2,7-9\" or \"10-40:5\"";

int parse_number(std::string_view text, const std::string& whole, const std::string& what) {
  int number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || number < 0 || number > largest_frame)
    throw InputError("", fmt::format("\"{}\"", whole), what + syntax);
  return number;
}

}  // namespace

std::vector<FrameRange> parse_frames(const std::string& text, const std::string& what) {
  std::string compact;
  std::copy_if(text.begin(), text.end(), std::back_inserter(compact), [](char c) { return c != ' '; });
  std::vector<FrameRange> ranges;
  std::string_view rest = compact;
  while (true) {
    const auto comma = rest.find(',');
    std::string_view part = rest.substr(0, comma);
    FrameRange range;
    const auto dash = part.find('-');
    if (dash == std::string_view::npos) {
      range.first = range.last = parse_number(part, text, what);
      range.single = true;
    } else {
      range.first = parse_number(part.substr(0, dash), text, what);
      part.remove_prefix(dash + 1);
      const auto colon = part.find(':');
      range.last = parse_number(part.substr(0, colon), text, what);
      if (colon != std::string_view::npos) range.step = parse_number(part.substr(colon + 1), text, what);
      if (range.last < range.first || range.step < 1) throw InputError("", fmt::format("\"{}\"", text), what + syntax);
    }
    ranges.push_back(range);
    if (comma == std::string_view::npos) return ranges;
    rest.remove_prefix(comma + 1);
  }
}

Frames expand(const std::vector<FrameRange>& ranges) {
  std::vector<char> there;  // ranges may overlap as often as they like
  for (const auto& range : ranges) {
    if (range.last >= static_cast<int>(there.size())) there.resize(static_cast<std::size_t>(range.last) + 1, 0);
    for (int frame = range.first; frame <= range.last; frame += range.step) there[static_cast<std::size_t>(frame)] = 1;
  }
  Frames frames;
  for (std::size_t frame = 0; frame < there.size(); ++frame)
    if (there[frame] != 0) frames.push_back(static_cast<int>(frame));
  return frames;
}

Frames select(const std::vector<FrameRange>& ranges, const Frames& available, const std::string& what) {
  std::set<int> frames;
  for (const auto& range : ranges) {
    const auto before = frames.size();
    for (int frame : available)
      if (frame >= range.first && frame <= range.last && (frame - range.first) % range.step == 0) frames.insert(frame);
    const bool beyond = available.empty() || range.last > available.back();
    const bool nothing =
        frames.size() == before && std::none_of(available.begin(), available.end(), [&](int frame) {
          return frame >= range.first && frame <= range.last && (frame - range.first) % range.step == 0;
        });
    if (range.single && nothing)
      throw InputError("", fmt::format("{} {}", what, range.first),
                       fmt::format("one of the {}s {}", what, to_text(available)));
    if (beyond || nothing)
      throw InputError("", fmt::format("{}s {}-{}", what, range.first, range.last),
                       fmt::format("among the {}s {}", what, to_text(available)));
  }
  return {frames.begin(), frames.end()};
}

std::string to_text(const Frames& frames) {
  std::string text;
  for (std::size_t i = 0; i < frames.size();) {
    std::size_t end = i;
    while (end + 1 < frames.size() && frames[end + 1] == frames[end] + 1) ++end;
    if (!text.empty()) text += ",";
    text += end > i + 1 ? fmt::format("{}-{}", frames[i], frames[end]) : std::to_string(frames[i]);
    i = end > i + 1 ? end + 1 : i + 1;
  }
  return text.empty() ? "(none)" : text;
}

}  // namespace imic3d::io
