#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "imic3d/core/error.hpp"
#include "imic3d/io/run_results.hpp"

namespace imic3d::io {

namespace {

using nlohmann::json;

json number_or_null(double value) { return std::isfinite(value) ? json(value) : json(nullptr); }

/// Root mean square over the frames where both series have a number; NaN if there are none.
double rms_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0.0;
  int n = 0;
  for (std::size_t i = 0; i < a.size() && i < b.size(); ++i) {
    if (!std::isfinite(a[i]) || !std::isfinite(b[i])) continue;
    sum += (a[i] - b[i]) * (a[i] - b[i]);
    ++n;
  }
  return n > 0 ? std::sqrt(sum / n) : std::nan("");
}

double rms(const std::vector<double>& values) {
  return rms_difference(values, std::vector<double>(values.size(), 0.0));
}

json parameters(const ResultsFile& file) {
  const auto names = file.read_texts("identification/parameters"), units = file.read_texts("identification/units");
  const auto initial = file.read("identification/initial"), values = file.read("identification/values"),
             deviation = file.read("identification/standard_deviation");
  json table = json::object();
  for (std::size_t i = 0; i < names.size(); ++i)
    table[names[i]] = {{"value", number_or_null(values[i])},
                       {"standard_deviation", number_or_null(deviation[i])},
                       {"initial", number_or_null(initial[i])},
                       {"unit", units[i]}};
  for (std::size_t i = 0; i < names.size(); ++i)
    if (std::isinf(deviation[i])) table[names[i]]["determined"] = false;
  if (file.has("identification/at_once/change")) {
    const auto change = file.read("identification/at_once/change"),
               then = file.read("identification/at_once/standard_deviation");
    for (std::size_t i = 0; i < names.size(); ++i)
      if (std::isfinite(change[i]))
        table[names[i]]["at_once"] = {{"change", change[i]}, {"standard_deviation", then[i]}};
  }
  for (const std::string by : {"refined_mesh", "in_space"})
    if (file.has("identification/" + by + "/change"))
      for (std::size_t i = 0; const auto change : file.read("identification/" + by + "/change")) {
        if (std::isfinite(change)) table[names[i]][by] = {{"change", change}};
        ++i;
      }
  if (file.has("identification/on_bound"))
    for (std::size_t i = 0; const auto mark : file.read_integers("identification/on_bound"))
      table[names[i++]]["on_bound"] = mark > 0;
  return table;
}

json iterations(const ResultsFile& file) {
  const std::string group = "identification/iterations/";
  const auto stage = file.read_integers(group + "stage"), iteration = file.read_integers(group + "iteration");
  json count = json::array();
  for (int i = 0; i < file.read_integers(group + "count")[0]; ++i) {
    const auto row = static_cast<std::size_t>(i), s = static_cast<std::size_t>(stage[row]);
    while (count.size() <= s) count.push_back(0);
    count[s] = std::max(count[s].get<int>(), iteration[row]);
  }
  return count;
}

}  // namespace

json covariance_of(const std::vector<std::string>& names, const Eigen::MatrixXd& covariance) {
  std::vector<Eigen::Index> known;
  for (Eigen::Index i = 0; i < covariance.rows(); ++i)
    if (std::isfinite(covariance(i, i))) known.push_back(i);
  json result;
  for (const Eigen::Index i : known) {
    result["parameters"].push_back(names[static_cast<std::size_t>(i)]);
    std::vector<double> row;
    for (const Eigen::Index j : known) row.push_back(std::isfinite(covariance(i, j)) ? covariance(i, j) : 0.0);
    result["values"].push_back(row);
  }
  return result;
}

json quantity(double value, const std::string& unit) { return {{"value", number_or_null(value)}, {"unit", unit}}; }

json case_summary(const ResultsFile& file) {
  json result = {{"title", file.read_text("case/title")},
                 {"case_file", file.read_text("case/file")},
                 {"case_text", file.read_text("case/text")}};
  for (const auto& name : file.names())
    if (name.starts_with("program/")) result["program"][name.substr(8)] = file.read_text(name);
  return result;
}

json summary(const ResultsFile& file) {
  json result = case_summary(file);
  result["frames"]["number"] = file.shape("frames/number")[0];
  const auto measured = file.read("frames/force_measured"), predicted = file.read("frames/force_predicted");
  if (file.has("fields/frames_done")) {
    result["frames"]["simulated"] = file.frames_done("fields").size();
    result["force_rms_difference"] = quantity(rms_difference(measured, predicted), file.unit("frames/force_measured"));
  }
  if (file.has("dic/frames_done")) {
    result["frames"]["correlated"] = file.frames_done("dic").size();
    result["residual_rms_dic"] = quantity(rms(file.read("residual/rms_dic")), "grey level");
    result["residual_rms_model"] = quantity(rms(file.read("residual/rms_model")), "grey level");
  }
  // The same over the frames that were fitted and over those that were held out.
  const auto use = file.has("frames/use") ? file.read_integers("frames/use") : std::vector<int>{};
  for (const auto& [kind, key] : {std::pair{1, "fitted"}, {2, "held_out"}}) {
    if (std::find(use.begin(), use.end(), kind) == use.end()) continue;
    const auto of_kind = [&, kind = kind](std::vector<double> values) {
      for (std::size_t i = 0; i < values.size(); ++i)
        if (use[i] != kind) values[i] = std::nan("");
      return values;
    };
    if (result.contains("force_rms_difference"))
      result[key]["force_rms_difference"] =
          quantity(rms_difference(of_kind(measured), predicted), file.unit("frames/force_measured"));
    if (result.contains("residual_rms_dic")) {
      result[key]["residual_rms_dic"] = quantity(rms(of_kind(file.read("residual/rms_dic"))), "grey level");
      result[key]["residual_rms_model"] = quantity(rms(of_kind(file.read("residual/rms_model"))), "grey level");
    }
  }
  if (file.has("identification/parameters")) {
    result["parameters"] = parameters(file);
    const auto values = file.read("identification/covariance");
    const auto names = file.read_texts("identification/parameters");
    const auto count = static_cast<Eigen::Index>(names.size());
    if (auto covariance = covariance_of(names, Eigen::Map<const Eigen::MatrixXd>(values.data(), count, count));
        !covariance.is_null())
      result["covariance"] = std::move(covariance);
    result["iterations_per_stage"] = iterations(file);
  }
  return result;
}

void write_text_file(const std::filesystem::path& path, const std::string& text) {
  const std::filesystem::path temporary = fmt::format("{}.{}.part", path.string(), ::getpid());
  const int file = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  bool whole = file >= 0;
  for (std::size_t at = 0; whole && at < text.size();) {
    const auto written = ::write(file, text.data() + at, text.size() - at);
    whole = written > 0 || (written < 0 && errno == EINTR);
    at += written > 0 ? static_cast<std::size_t>(written) : 0;
  }
  whole = whole && ::fsync(file) == 0;
  const int reason = errno;
  if (file >= 0) ::close(file);
  std::error_code error;
  if (whole) std::filesystem::rename(temporary, path, error);
  if (whole && !error) return;
  std::error_code ignored;
  std::filesystem::remove(temporary, ignored);
  throw InputError(path.string(),
                   fmt::format("cannot be written ({})", error ? error.message() : std::strerror(reason)),
                   "a place where results can be written");
}

void write_json(const std::filesystem::path& path, const json& value) { write_text_file(path, value.dump(2) + "\n"); }

}  // namespace imic3d::io
