// What records of bars say of themselves that is unlikely.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "curves.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"

namespace imic3d::app {

namespace id = identification;

namespace {

constexpr double far_from_declared = 20.0;  // a slope over E, or the reverse

/// Stress over strain in the rows below 30 % of the largest stress that come before it, by least squares with an
/// offset; NaN if there are too few.
double first_slope(const id::Curve& curve) {
  const double largest = curve.stress.cwiseAbs().maxCoeff();
  double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
  for (Eigen::Index row = 0; row < curve.stress.size() && std::abs(curve.stress[row]) < 0.3 * largest; ++row) {
    const double strain = curve.history.strain[row], stress = curve.stress[row];
    n += 1.0, x += strain, y += stress, xx += strain * strain, xy += strain * stress;
  }
  const double variance = xx - x * x / n;
  return n >= 2.0 && variance > 0.0 ? (xy - x * y / n) / variance : std::nan("");
}

/// The same, or, of too few rows below that, the slope of the chord to the first row beyond: plasticity makes that
/// less, but by no more than it makes it `much` less than E.
double slope_or_chord(const id::Curve& curve, double E) {
  constexpr double much = 300.0;
  const double slope = first_slope(curve), largest = curve.stress.cwiseAbs().maxCoeff();
  if (std::isfinite(slope)) return slope;
  Eigen::Index row = 0;
  while (row < curve.stress.size() - 1 && std::abs(curve.stress[row] - curve.stress[0]) < 0.3 * largest) ++row;
  const double strain = curve.history.strain[row] - curve.history.strain[0];
  if (strain == 0.0) return std::nan("");
  const double chord = (curve.stress[row] - curve.stress[0]) / strain;
  return std::abs(chord) < E / much || std::abs(chord) > far_from_declared * E ? chord : std::nan("");
}

/// The stress that the record begins with beyond what E makes of its strain, where an elastic bar could have that
/// strain; 0 where noise, or what E is off by, may be it.
double begins_with(const id::Curve& curve, double E) {
  constexpr double noises = 6.0, of_largest = 0.02, of_E = 0.3;
  const double largest = curve.stress.cwiseAbs().maxCoeff(), elastic = E * curve.history.strain[0],
               beyond = curve.stress[0] - elastic;
  if (std::abs(elastic) > 0.3 * largest) return 0.0;
  const double by_chance = std::hypot(noises * id::point_noise(curve), noises * E * curve.strain_noise);
  return std::abs(beyond) > std::max({by_chance, of_largest * largest, of_E * std::abs(elastic)}) ? beyond : 0.0;
}

/// A row before which the strain goes at once as far as it goes in many rows otherwise, and stays.
struct Jump {
  Eigen::Index row;
  double strain, times;  ///< by how much; over that of the rows beside it
};

/// The largest one, of a record with times; nothing where the strain is not as steady as that.
std::optional<Jump> jump_of(const id::Curve& curve) {
  constexpr Eigen::Index beside = 5;
  constexpr double many = 8.0, steady = 3.0, very_steady = 1.5;
  const auto &time = curve.history.time, &strain = curve.history.strain;
  const Eigen::Index rows = strain.size();
  std::optional<Jump> largest;
  for (Eigen::Index row = 1 + beside; row + beside < rows; ++row) {
    const auto rate = [&](Eigen::Index i) { return (strain[i] - strain[i - 1]) / (time[i] - time[i - 1]); };
    std::vector<double> others;
    for (Eigen::Index i = row - beside; i <= row + beside; ++i)
      if (i != row) others.push_back(std::abs(rate(i)));
    const double most = *std::max_element(others.begin(), others.end()), usual = median(others), its = rate(row);
    const double jump = strain[row] - strain[row - 1];
    if (!std::isfinite(its) || !(usual > 0.0) ||
        !(std::abs(its) > (most < very_steady * usual ? 0.5 * many : many) * usual) || !(most < steady * usual) ||
        !(std::abs(jump) > many * curve.strain_noise))
      continue;
    if (!largest || std::abs(jump) > std::abs(largest->strain)) largest = Jump{row, jump, std::abs(its) / usual};
  }
  return largest;
}

/// Rows on end in which the largest stress, or the lowest, stands to the last digit while the strain goes on; 0: few.
Eigen::Index rows_at_the_end_of_scale(const id::Curve& curve) {
  constexpr Eigen::Index few = 10;
  Eigen::Index most = 0;
  for (const double end : {curve.stress.maxCoeff(), curve.stress.minCoeff()}) {
    Eigen::Index first = -1;
    for (Eigen::Index row = 0; row < curve.stress.size(); ++row) {
      if (curve.stress[row] != end || end == 0.0) {
        first = -1;
        continue;
      }
      if (first < 0) first = row;
      if (curve.history.strain[row] != curve.history.strain[first]) most = std::max(most, row - first + 1);
    }
  }
  return most >= few ? most : 0;
}

}  // namespace

std::vector<const id::Curve*> of_group(const std::vector<id::Curve>& curves, const std::string& group) {
  std::vector<const id::Curve*> list;
  for (const auto& curve : curves)
    if (curve.group == group) list.push_back(&curve);
  return list;
}

bool falls_with_strain(const id::Curve& curve, double E) {
  const Eigen::Index last = curve.stress.size() - 1;
  const auto steps = [last](const Eigen::VectorXd& values) -> Eigen::ArrayXd {
    return values.tail(last).array() - values.head(last).array();
  };
  const Eigen::ArrayXd products = steps(curve.history.strain) * steps(curve.stress);
  return products.sum() < -0.5 * products.abs().sum() || (E > 0.0 && first_slope(curve) < -E / far_from_declared);
}

std::vector<std::string> doubts_of_curves(const io::Case& test, const std::vector<id::Curve>& curves) {
  std::vector<std::string> doubts = test.doubts;
  const auto doubt = [&doubts](std::string text) {
    spdlog::warn("{}", text);
    doubts.push_back(std::move(text));
  };
  const auto place = [](const id::Curve& curve) { return fmt::format("experiments.{} {}", curve.group, curve.name); };
  const std::string unit = io::stress_unit(test.units);
  const auto& effects = test.material.effects;
  for (const char* effect : {"rate", "viscosity"})
    for (const auto& experiment : test.experiments)
      if (std::find(effects.begin(), effects.end(), effect) != effects.end() && experiment.columns.time.empty() &&
          !experiment.rate)
        doubt(
            fmt::format("experiments.{}: neither time nor rate is given, and a row is taken for one unit of time: the "
                        "parameters of material.effects: {} are in that unit",
                        experiment.name, effect));
  if (std::find(effects.begin(), effects.end(), "hill") != effects.end() &&
      std::all_of(test.experiments.begin(), test.experiments.end(),
                  [](const auto& experiment) { return experiment.direction == 0.0; }))
    doubt(
        "material.effects: hill, and all experiments lie along the first axis of the material, whose strength alone "
        "they "
        "show: is their direction (experiments[].direction, in degrees) missing?");
  for (const auto& experiment : test.experiments) {
    const auto bars = of_group(curves, experiment.name);
    // Once of all bars; words for the first one of which something is to be said.
    const auto doubt_records = [&](const char* what, const auto& words) {
      std::string first;
      int count = 0;
      for (const auto* curve : bars)
        if (const std::string said = words(*curve); !said.empty() && count++ == 0) first = curve->name + ": " + said;
      if (count > 0)
        doubt(
            fmt::format("experiments.{}: {} of {} records {} ({})", experiment.name, count, bars.size(), what, first));
    };
    doubt_records("have rows that repeat the row before, time included: these are left out",
                  [](const id::Curve& curve) {
                    constexpr double few = 0.02;
                    return static_cast<double>(curve.repeated_rows) > few * static_cast<double>(curve.stress.size())
                               ? fmt::format("{} rows", curve.repeated_rows)
                               : std::string();
                  });
    doubt_records(
        "have a largest stress that stands to the last digit while the strain goes on: was the load cell at the end of "
        "its range?",
        [](const id::Curve& curve) {
          const auto rows = rows_at_the_end_of_scale(curve);
          return rows > 0 ? fmt::format("in {} rows on end", rows) : std::string();
        });
    if (!experiment.columns.time.empty())
      doubt_records(
          "have a strain that jumps once: did the extensometer slip, or change its range? What follows is off "
          "by that",
          [](const id::Curve& curve) {
            const auto jump = jump_of(curve);
            return jump ? fmt::format("before row {} by {:.2g}, {:.0f} times as fast as in the rows beside", jump->row,
                                      jump->strain, jump->times)
                        : std::string();
          });
  }
  const auto declared = test.material.parameters.find("E");
  if (declared == test.material.parameters.end()) return doubts;
  const double E = declared->second.value;
  for (const auto& curve : curves)
    if (curve.broken_from)
      doubt(fmt::format(
          "{}: the stress falls to nothing and the strain does not go back with it, as of a bar that has broken: from "
          "row {} on it is not judged (until: maximum_force says where it ends)",
          place(curve), *curve.broken_from));
  for (const auto& experiment : test.experiments) {
    std::vector<double> slopes;
    for (const auto* curve : of_group(curves, experiment.name))
      if (const double slope = slope_or_chord(*curve, E); std::isfinite(slope)) slopes.push_back(slope);
    const double slope = slopes.empty() ? E : median(std::move(slopes)), ratio = slope / E;
    if (!(ratio > 1.0 / far_from_declared && ratio < far_from_declared)) {
      doubt(fmt::format(
          "experiments.{}: the stress first rises by {:.3g} {} for a strain of 1, where E was declared as {:.4g}: is "
          "the strain in percent (strain_scale: 0.01), or the stress in another unit than {} (stress_unit, of a force "
          "force_unit)?",
          experiment.name, slope, unit, E, unit));
      continue;
    }
    const auto bars = of_group(curves, experiment.name);
    constexpr double longest = 2.0;  // of a metal's or a polymer's logarithmic strain
    double strain = 0.0;
    for (const auto* curve : bars) strain = std::max(strain, curve->history.strain.cwiseAbs().maxCoeff());
    if (strain > longest) {
      doubt(fmt::format(
          "experiments.{}: a bar is drawn to {:.3g} times its length: is the strain in percent (strain_scale: 0.01) or "
          "in microstrain (1e-6)?",
          experiment.name, std::exp(strain)));
      continue;
    }
    int off = 0;
    std::pair<double, std::string> most;
    for (const auto* curve : bars)
      if (const double beyond = begins_with(*curve, E); beyond != 0.0) {
        ++off;
        if (std::abs(beyond) > std::abs(most.first)) most = {beyond, curve->name};
      }
    if (off > 0)
      doubt(fmt::format(
          "experiments.{}: {} of {} records begin with a stress that their strain does not explain, {} by {:+.3g} {}: "
          "a zero of the load cell, a load that the bar bore when the extensometer was set to zero, or rows that are "
          "missing before (imic3d loop looks for force zero and strain zero)",
          experiment.name, off, bars.size(), most.second, most.first, unit));
  }
  return doubts;
}

}  // namespace imic3d::app
