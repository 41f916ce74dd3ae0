#include "imic3d/io/loads.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <optional>

#include "delimited.hpp"
#include "imic3d/core/error.hpp"

namespace imic3d::io {

namespace {

constexpr std::size_t most_mistakes = 20;  // of one file; the rest is counted

/// Reads the rows of one file and collects what is wrong with them.
class LoadsReader {
 public:
  LoadsReader(const std::filesystem::path& file, const LoadColumns& columns, double force_scale)
      : file_(file), columns_(columns), force_scale_(force_scale) {}

  std::vector<LoadRecord> read() {
    std::error_code error;
    std::ifstream stream(file_);
    if (!stream || std::filesystem::is_directory(file_, error))
      throw InputError(file_.string(), "cannot be read", "a load record (.csv) with a header row");
    std::string line;
    while (std::getline(stream, line)) {
      ++line_;
      if (line_ == 1 && line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
      if (trimmed(line).empty() || trimmed(line).starts_with('#')) continue;
      if (header_.empty()) {
        read_header(line);
      } else {
        read_row(line);
      }
    }
    if (header_.empty()) throw InputError(file_.string(), "an empty file", "a load record (.csv) with a header row");
    if (mistakes_.empty() && records_.empty()) throw InputError(file_.string(), "no rows", "one row for each frame");
    if (!mistakes_.empty()) {
      if (mistakes_.size() > most_mistakes) {
        const auto more = mistakes_.size() - most_mistakes;
        mistakes_.resize(most_mistakes);
        mistakes_.push_back({file_.string(), fmt::format("{} more mistakes of this kind", more), ""});
      }
      throw InputError(mistakes_);
    }
    return std::move(records_);
  }

 private:
  void read_header(const std::string& line) {
    separator_ = separator_of(line);
    const auto fields = fields_of(line, separator_);
    if (!fields) throw InputError(fmt::format("{}:{}", file_.string(), line_), "a quote that is not closed", "");
    header_ = *fields;
    for (const auto& column : {columns_.image, columns_.time, columns_.force}) {
      const auto count = std::count(header_.begin(), header_.end(), column);
      const auto place = fmt::format("{}:{} column \"{}\"", file_.string(), line_, column);
      if (count == 0)
        mistakes_.push_back({place, "not there", fmt::format("one of \"{}\"", fmt::join(header_, "\", \""))});
      if (count > 1) mistakes_.push_back({place, fmt::format("there {} times", count), "once"});
    }
    if (!mistakes_.empty()) throw InputError(mistakes_);
    image_ = index_of(columns_.image);
    time_ = index_of(columns_.time);
    force_ = index_of(columns_.force);
    image_file_ = index_of(columns_.image_file);
  }

  void read_row(const std::string& line) {
    const auto fields = fields_of(line, separator_);
    if (!fields) {
      mistakes_.push_back({fmt::format("{}:{}", file_.string(), line_), "a quote that is not closed", ""});
      return;
    }
    if (records_.empty() && mistakes_.empty() && are_units(*fields)) return;
    if (fields->size() != header_.size()) {
      mistakes_.push_back({fmt::format("{}:{}", file_.string(), line_), fmt::format("{} fields", fields->size()),
                           fmt::format("{} as in the header", header_.size())});
      return;
    }
    LoadRecord record;
    record.line = line_;
    const auto frame = parsed<int>((*fields)[image_]);
    if (!frame || *frame < 0) mistake(columns_.image, (*fields)[image_], "a frame number (an integer from 0)");
    const auto time = number(columns_.time, (*fields)[time_]);
    const auto force = number(columns_.force, (*fields)[force_]);
    if (frame && *frame >= 0) check_order_of_frame(*frame);
    if (time) check_order_of_time(*time, (*fields)[time_]);
    if (!frame || !time || !force) return;
    record.frame = *frame;
    record.time = *time;
    record.force = *force * force_scale_;
    if (image_file_ < header_.size() && !(*fields)[image_file_].empty())
      record.image = (file_.parent_path() / (*fields)[image_file_]).lexically_normal();
    records_.push_back(record);
  }

  void check_order_of_frame(int frame) {
    if (const auto [it, is_new] = line_of_frame_.try_emplace(frame, line_); !is_new) {
      mistake(columns_.image, std::to_string(frame),
              fmt::format("a frame once (it stands in line {} too)", it->second));
    } else if (last_frame_ && frame < *last_frame_) {
      mistake(columns_.image, fmt::format("{} after {}", frame, *last_frame_), "ascending frames");
    }
    last_frame_ = frame;
  }

  void check_order_of_time(double time, const std::string& text) {
    if (last_time_ && time < *last_time_)
      mistake(columns_.time, fmt::format("{} after {}", text, last_time_text_), "a time that does not decrease");
    last_time_ = time;
    last_time_text_ = text;
  }

  std::optional<double> number(const std::string& column, const std::string& text) {
    const auto value = number_in(text, separator_);
    if (value && std::isfinite(*value)) return value;
    mistake(column, text, "a finite number");
    return std::nullopt;
  }

  void mistake(const std::string& column, std::string found, std::string allowed) {
    mistakes_.push_back(
        {fmt::format("{}:{} column \"{}\"", file_.string(), line_, column), found.empty() ? "nothing" : std::move(found), std::move(allowed)});
  }

  [[nodiscard]] std::size_t index_of(const std::string& column) const {
    return static_cast<std::size_t>(std::find(header_.begin(), header_.end(), column) - header_.begin());
  }

  std::filesystem::path file_;
  LoadColumns columns_;
  double force_scale_;
  char separator_ = ',';
  int line_ = 0;
  std::vector<std::string> header_;
  std::size_t image_ = 0, time_ = 0, force_ = 0, image_file_ = 0;
  std::map<int, int> line_of_frame_;
  std::optional<int> last_frame_;
  std::optional<double> last_time_;
  std::string last_time_text_;
  std::vector<LoadRecord> records_;
  std::vector<Mistake> mistakes_;
};

}  // namespace

std::vector<LoadRecord> read_loads(const std::filesystem::path& file, const LoadColumns& columns, double force_scale) {
  return LoadsReader(file, columns, force_scale).read();
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
