#include "imic3d/io/loads.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "delimited.hpp"
#include "imic3d/core/error.hpp"
#include "named_columns.hpp"

namespace imic3d::io {

namespace {

/// Reads the rows of one file and collects what is wrong with them.
class LoadsReader {
 public:
  LoadsReader(const std::filesystem::path& file, const LoadColumns& columns, double force_scale)
      : has_frames_(!columns.image.empty()), has_force_(!columns.force.empty()), force_scale_(force_scale) {
    std::vector<std::string> wanted = {columns.time};
    if (has_frames_) frame_ = wanted.size(), wanted.push_back(columns.image);
    if (has_force_) force_ = wanted.size(), wanted.push_back(columns.force);
    table_ = read_named_columns(file, wanted, "a load record (.csv) with a header row", {columns.image_file});
  }

  std::vector<LoadRecord> read() {
    std::vector<LoadRecord> records;
    for (const auto& row : table_.rows) {
      LoadRecord record;
      record.line = row.line;
      record.frame = has_frames_ ? frame_of(row) : static_cast<int>(records.size());
      record.time = time_of(row);
      if (has_force_) record.force = force_scale_ * number(row, force_);
      if (const auto& image = row.text.back(); !image.empty())
        record.image = (table_.file.parent_path() / image).lexically_normal();
      records.push_back(record);
    }
    table_.refuse();
    if (records.empty()) throw InputError(table_.file.string(), "no rows", "one row for each frame");
    return records;
  }

 private:
  int frame_of(const NamedColumns::Row& row) {
    const auto frame = parsed<int>(row.text[frame_]);
    if (!frame || *frame < 0) {
      table_.mistake(row, frame_, "a frame number (an integer from 0)");
      return -1;
    }
    if (const auto [it, is_new] = line_of_frame_.try_emplace(*frame, row.line); !is_new) {
      table_.mistake(row, frame_, fmt::format("a frame once (it stands in line {} too)", it->second));
    } else if (last_frame_ && *frame < *last_frame_) {
      table_.mistake(row, frame_, "ascending frames", fmt::format("{} after {}", *frame, *last_frame_));
    }
    last_frame_ = frame;
    return *frame;
  }

  double time_of(const NamedColumns::Row& row) {
    const double time = number(row, 0);
    if (last_time_ && time < *last_time_)
      table_.mistake(row, 0, "a time that does not decrease", fmt::format("{} after {}", row.text[0], last_time_text_));
    if (std::isfinite(time)) last_time_ = time, last_time_text_ = row.text[0];
    return time;
  }

  double number(const NamedColumns::Row& row, std::size_t column) {
    const double value = table_.number(row, column).value_or(std::nan(""));
    if (!std::isfinite(value)) table_.mistake(row, column, "a finite number");
    return value;
  }

  bool has_frames_, has_force_;
  double force_scale_;
  NamedColumns table_;
  // places of the columns; the time is the first, the image's file the last one
  std::size_t frame_ = 0, force_ = 0;
  std::map<int, int> line_of_frame_;
  std::optional<int> last_frame_;
  std::optional<double> last_time_;
  std::string last_time_text_;
};

}  // namespace

std::vector<LoadRecord> read_loads(const std::filesystem::path& file, const LoadColumns& columns, double force_scale) {
  return LoadsReader(file, columns, force_scale).read();
}

std::vector<LoadRecord> at_frames(const std::vector<LoadRecord>& record, std::vector<LoadRecord> frames) {
  const auto is_beyond = [&](const LoadRecord& frame) {
    return record.empty() || frame.time < record.front().time || frame.time > record.back().time;
  };
  std::erase_if(frames, is_beyond);
  for (auto& frame : frames) {
    const auto after = std::upper_bound(record.begin(), record.end(), frame.time,
                                        [](double time, const LoadRecord& row) { return time < row.time; });
    const auto& before = *std::prev(after);
    frame.line = before.line;
    frame.force = after == record.end() ? before.force
                                        : before.force + (frame.time - before.time) / (after->time - before.time) *
                                                             (after->force - before.force);
  }
  return frames;
}

void remove_lag(std::vector<LoadRecord>& records, double lag) {
  if (lag == 0.0) return;
  const std::vector<LoadRecord> read = records;
  for (std::size_t i = 0; i < read.size(); ++i) {
    double slope = 0.0, weights = 0.0;  // the nearer neighbour's slope counts more: exact for a parabola
    for (const bool after : {false, true}) {
      if (after ? i + 1 == read.size() : i == 0) continue;
      const auto& other = read[after ? i + 1 : i - 1];
      const double step = other.time - read[i].time;
      if (step == 0.0) continue;
      slope += (other.force - read[i].force) / step / std::abs(step);
      weights += 1.0 / std::abs(step);
    }
    if (weights > 0.0) records[i].force += lag * slope / weights;
  }
}

}  // namespace imic3d::io
