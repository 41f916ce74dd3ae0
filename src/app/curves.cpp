#include "curves.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <set>
#include <span>

#include "imic3d/app/output.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/identification/gauge.hpp"
#include "imic3d/io/curve_report.hpp"

namespace imic3d::app {

namespace id = identification;

namespace {

/// The rows of a record but those that repeat the one before, its time included.
std::vector<Eigen::Index> rows_once(const io::CurveTable& table) {
  std::vector<Eigen::Index> rows;
  for (Eigen::Index row = 0; row < table.stress.size(); ++row)
    if (row == 0 || table.time.size() == 0 || table.time[row] != table.time[row - 1] ||
        table.strain[row] != table.strain[row - 1] || table.stress[row] != table.stress[row - 1])
      rows.push_back(row);
  return rows;
}

id::Curve make_curve(const io::ExperimentCase& experiment, std::size_t file) {
  const io::CurveTable& table = experiment.tables[file];
  const auto place = [&](Eigen::Index row) { return fmt::format("{} row {}", experiment.files[file].string(), row); };
  id::Curve curve;
  curve.name = experiment.files[file].stem().string();
  curve.group = experiment.name;
  curve.engineering = experiment.engineering_stress;
  curve.history.direction = experiment.direction;
  curve.history.strain = experiment.strain_scale * table.strain;
  if (experiment.engineering_strain) {
    for (Eigen::Index row = 0; row < curve.history.strain.size(); ++row)
      if (!(curve.history.strain[row] > -1.0))
        throw InputError(place(row), fmt::format("engineering strain {}", curve.history.strain[row]),
                         "a number above -1");
    curve.history.strain = curve.history.strain.array().log1p();
  }
  curve.stress = experiment.stress_scale * table.stress;

  const std::vector<Eigen::Index> row_of = rows_once(table);  // of the file
  curve.repeated_rows = table.stress.size() - std::ssize(row_of);
  if (curve.repeated_rows > 0) {
    curve.stress = Eigen::VectorXd(curve.stress(row_of));
    curve.history.strain = Eigen::VectorXd(curve.history.strain(row_of));
  }
  Eigen::Index rows = curve.stress.size(), largest = 0;
  if (experiment.until_maximum) {
    const Eigen::VectorXd force = curve.engineering
                                      ? curve.stress
                                      : Eigen::VectorXd(curve.stress.array() * (-curve.history.strain.array()).exp());
    force.cwiseAbs().maxCoeff(&largest);
    rows = largest + 1;
    curve.stress.conservativeResize(rows);
    curve.history.strain.conservativeResize(rows);
  }
  curve.history.time = Eigen::VectorXd::LinSpaced(rows, 0.0, static_cast<double>(rows - 1));
  if (table.time.size() > 0) curve.history.time = experiment.time_scale * table.time(row_of).head(rows);
  if (experiment.rate)
    for (Eigen::Index row = 1; row < rows; ++row)
      curve.history.time[row] = curve.history.time[row - 1] +
                                std::abs(curve.history.strain[row] - curve.history.strain[row - 1]) / *experiment.rate;
  for (Eigen::Index row = 1; row < rows; ++row)
    if (curve.history.time[row] < curve.history.time[row - 1])
      throw InputError(place(row_of[static_cast<std::size_t>(row)]),
                       fmt::format("time {} after {}", curve.history.time[row], curve.history.time[row - 1]),
                       "a time that does not decrease");
  if (table.time.size() > 0 && !experiment.rate)
    if (const auto shared = id::spread_stamps(curve.history.time); shared > 0)
      spdlog::info("{}: {} of {} rows have the time of the row before: they are spread evenly over the clock's tick",
                   experiment.files[file].string(), shared, rows);
  if (!experiment.monotonic) id::read_gauge(curve, table.time.size() > 0);

  bool reached = false;
  double largest_strain = 0.0, back = 0.0;
  for (Eigen::Index row = 0; row < rows; ++row) {
    double& strain = curve.history.strain[row];
    const bool turned_back = experiment.monotonic && strain < largest_strain;
    if (turned_back) back = std::max(back, largest_strain - strain);
    if (turned_back) strain = largest_strain;
    largest_strain = std::max(largest_strain, strain);
    reached = reached || std::abs(strain) >= experiment.from;
    const bool held =
        experiment.held_out || std::binary_search(experiment.held_out_rows.begin(), experiment.held_out_rows.end(),
                                                  static_cast<int>(row_of[static_cast<std::size_t>(row)]));
    curve.use.push_back(!reached || turned_back ? id::Curve::not_judged
                        : held                  ? id::Curve::held_out
                                                : id::Curve::fitted);
  }
  const auto own = fmt::format("experiments.{} {}", curve.group, curve.name);
  if (!reached)
    throw InputError(
        own, fmt::format("from: {}, which no row reaches", experiment.from),
        fmt::format("a strain below the bar's largest, {:.4g}", curve.history.strain.cwiseAbs().maxCoeff()));
  if (back > 0.5 * largest_strain)
    throw InputError(own,
                     fmt::format("monotonic, and a strain that goes back by {:.4g} from {:.4g}", back, largest_strain),
                     "a bar that is pulled only: what turns back is taken for noise");
  return curve;
}

/// Marks the rows of a bar that broke as not judged: those in which it carries less than half of what it did, where its
/// strain did not go back as it does when it is unloaded.
void leave_out_what_broke(id::Curve& curve, double E) {
  const double largest = curve.stress.cwiseAbs().maxCoeff();
  Eigen::Index end = curve.stress.size();
  while (end > 0 && curve.use[static_cast<std::size_t>(end - 1)] == id::Curve::not_judged) --end;
  Eigen::Index first = end, carried = end - 1;
  while (first > 0 && std::abs(curve.stress[first - 1]) < 0.1 * largest) --first;
  while (carried >= 0 && std::abs(curve.stress[carried]) < 0.5 * largest) --carried;
  if (first >= end || carried < 0 || carried >= first) return;
  const double fallen = curve.stress[carried] - curve.stress[first],
               back = curve.history.strain[carried] - curve.history.strain[first];
  if (back / (fallen / E) >= 1.0 / 3.0) return;
  curve.broken_from = carried + 1;
  std::fill(curve.use.begin() + carried + 1, curve.use.end(), id::Curve::not_judged);
}

/// results.h5: parameters, and what was measured and predicted of each curve.
void write_results(const std::filesystem::path& folder, const io::Case& test, const io::CurveRun& run) {
  auto h5 = io::ResultsFile::create(folder / "results.h5");
  io::store_case(h5, test, versions());
  std::vector<std::string> names, units, curves, groups;
  std::vector<double> initial, values, deviations;
  for (const auto& p : run.parameters)
    names.push_back(p.name), units.push_back(p.unit), initial.push_back(p.start), values.push_back(p.value),
        deviations.push_back(p.deviation);
  h5.store_texts("identification/parameters", names, "names of the parameters");
  h5.store_texts("identification/units", units, "units of the parameters");
  const std::string unit = "see identification/units";
  h5.store("identification/initial", {names.size()}, initial, unit, "values in the case file");
  h5.store("identification/values", {names.size()}, values, unit, "identified values");
  h5.store("identification/standard_deviation", {names.size()}, deviations, unit,
           "standard deviation; NaN where a parameter was not free");
  for (const auto& one : run.curves) {
    const auto store = [&, at = fmt::format("curves/{:04d}/", curves.size())](
                           const char* name, const Eigen::VectorXd& numbers, const std::string& of, const char* what) {
      const auto size = static_cast<std::size_t>(numbers.size());
      h5.store(at + name, {size}, std::span<const double>(numbers.data(), size), of, what);
    };
    store("time", one.time, run.time_unit, "time");
    store("strain", one.strain, "-", "logarithmic strain");
    store("measured", one.measured, run.stress_unit,
          one.engineering ? "measured engineering stress" : "measured true stress");
    store("predicted", one.predicted, run.stress_unit, "predicted stress");
    h5.store(fmt::format("curves/{:04d}/use", curves.size()), {one.use.size()},
             std::vector<int>(one.use.begin(), one.use.end()), "-", "0: not judged, 1: fitted, 2: held out");
    curves.push_back(one.name), groups.push_back(one.group);
  }
  h5.store_texts("curves/names", curves, "name of each curve");
  h5.store_texts("curves/groups", groups, "the experiment that it belongs to");
  h5.start();
}

double relative(double a, double b) { return b != 0.0 ? a / std::abs(b) : std::nan(""); }

}  // namespace

std::string deviation_from(const io::ExperimentCase& experiment) {
  return experiment.noise ? "given" : experiment.files.size() > 1 ? "repetitions" : "points";
}

std::vector<id::Curve> make_curves(const io::Case& test) {
  std::vector<id::Curve> curves;
  std::vector<Mistake> mistakes;
  const auto E = test.material.parameters.find("E");
  for (const auto& experiment : test.experiments) {
    const std::size_t first = curves.size();
    for (std::size_t file = 0; file < experiment.files.size(); ++file) try {
        curves.push_back(make_curve(experiment, file));
        if (E != test.material.parameters.end()) leave_out_what_broke(curves.back(), E->second.value);
      } catch (const InputError& error) {
        mistakes.insert(mistakes.end(), error.mistakes().begin(), error.mistakes().end());
      }
    if (!mistakes.empty()) continue;
    const double between = id::scatter(of_group(curves, experiment.name));
    for (std::size_t k = first; k < curves.size(); ++k) {
      curves[k].deviation = experiment.noise ? *experiment.noise : between > 0.0 ? between : id::point_noise(curves[k]);
      curves[k].estimated = !experiment.noise && !(between > 0.0);
      if (!(curves[k].deviation > 0.0))
        throw InputError(experiment.files[k - first].string(), "no noise to be seen in the points",
                         "experiments.noise: a standard deviation, or repetitions");
    }
  }
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
  for (std::size_t k = 0, file = 0; k < curves.size(); ++k, ++file) {
    if (k > 0 && curves[k].group != curves[k - 1].group) file = 0;
    const auto& own = curves[k];
    const auto place = fmt::format("experiments.{} {}", own.group, own.name);
    if (falls_with_strain(own, E != test.material.parameters.end() ? E->second.value : 0.0))
      mistakes.push_back({place, "a stress that falls where the strain grows",
                          "stress and strain of one sign, both positive in tension; a negative strain_scale or "
                          "stress_scale turns one"});
    for (std::size_t other = k - file; other < k; ++other)
      if (curves[other].stress.size() == own.stress.size() && curves[other].stress == own.stress &&
          curves[other].history.strain == own.history.strain)
        mistakes.push_back({place, fmt::format("the numbers of {} once more", curves[other].name),
                            "bars that were measured, each once"});
  }
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
  std::size_t fitted = 0, most_free = 0;
  for (const auto& curve : curves)
    fitted += static_cast<std::size_t>(std::count(curve.use.begin(), curve.use.end(), id::Curve::fitted));
  for (const auto& stage : test.identify.stages) most_free = std::max(most_free, stage.free.size());
  if (fitted == 0)
    throw InputError("experiments", "no row to fit: all are held out, or come before `from`",
                     "rows that are fitted, more than there are free parameters");
  if (fitted <= most_free)
    throw InputError("experiments", fmt::format("{} rows to fit, {} free parameters", fitted, most_free),
                     "more rows than free parameters");
  return curves;
}

namespace {
constexpr int most_weighings = 4;

bool alike(const std::vector<double>& a, const std::vector<double>& b) {
  return std::equal(a.begin(), a.end(), b.begin(),
                    [](double x, double y) { return std::abs(x - y) <= 0.02 * std::max(x, y); });
}

void say_strain_noise(const id::CurveSet& set, const std::vector<double>& noise) {
  for (std::size_t k = 0; k < noise.size(); ++k)
    if (noise[k] > 0.0)
      spdlog::info("  {}: a noise of the strain of {:.2g} is seen, and weighs where the curve is steep",
                   set.curves()[k].name, noise[k]);
}
}  // namespace

void identify_curves(const Communicator& world, const CommandOptions& options, const io::Case& test) {
  const auto start = std::chrono::steady_clock::now();
  Material material = make_material(test);
  id::CurveSet set(material.law, make_curves(test));
  const auto folder = output_folder(test, options, world);
  const std::vector<double> first = material.values;
  spdlog::info("{}: {} curves, {} rows, law {}", test.title, set.curves().size(), set.measured().size(),
               material.law->name());

  io::CurveRun run;
  run.doubts = doubts_of_curves(test, set.curves());
  std::set<int> all_free, at_bounds;
  std::vector<double> strain_noise(set.curves().size(), 0.0);
  const auto n = static_cast<Eigen::Index>(material.values.size());
  Eigen::VectorXd deviation = Eigen::VectorXd::Constant(n, std::nan("")), noise_deviation = deviation;
  run.covariance = Eigen::MatrixXd::Constant(n, n, std::nan(""));
  for (std::size_t k = 0; k < test.identify.stages.size(); ++k) {
    const auto& names = test.identify.stages[k].free;
    std::vector<int> free;
    for (const auto& name : names) free.push_back(material.index(name));
    spdlog::info("stage {}: {}", k + 1, fmt::join(names, ", "));
    const auto report = [&](const id::CurveIterate& at) {
      std::string values;
      for (const int j : free)
        values += fmt::format("{} {:.6g}  ", material.information[static_cast<std::size_t>(j)].name,
                              at.parameters[static_cast<std::size_t>(j)]);
      spdlog::info("  {}eta {:.1e}  chi {:.4g}", values, at.eta, at.chi);
      run.iterations.push_back(at.parameters);
      run.chi.push_back(at.chi);
    };
    const id::CurveFitOptions solver{.max_iterations = test.identify.max_iterations, .eta = test.identify.eta};
    auto fit = id::fit(set, material.information, material.values, free, solver, report);
    for (int pass = 0; pass < most_weighings; ++pass) {
      const auto before = std::exchange(strain_noise, set.weigh(fit.parameters));
      if (alike(before, strain_noise)) break;
      say_strain_noise(set, strain_noise);
      fit = id::fit(set, material.information, fit.parameters, free, solver, report);
    }
    if (!fit.converged) {
      run.doubts.push_back(fmt::format("stage {} did not converge in {} iterations: eta is still {:.2e}", k + 1,
                                       fit.iterates.size() - 1, fit.iterates.back().eta));
      spdlog::warn("  {}", run.doubts.back());
    }
    run.converged = run.converged && fit.converged;
    material.values = fit.parameters;
    put_block(run.covariance, free, fit.covariance);
    for (std::size_t i = 0; i < free.size(); ++i) {
      const auto j = static_cast<Eigen::Index>(i);
      noise_deviation[free[i]] = std::sqrt(fit.noise_covariance(j, j));
      deviation[free[i]] = std::sqrt(fit.covariance(j, j));
      all_free.insert(free[i]);
      at_bounds.erase(free[i]);
    }
    at_bounds.insert(fit.at_bounds.begin(), fit.at_bounds.end());
  }

  const auto doubt = [&](std::string text) {
    spdlog::warn("{}", text);
    run.doubts.push_back(std::move(text));
  };
  std::vector<std::string> together;
  for (const int j : all_free) {
    const auto& name = material.information[static_cast<std::size_t>(j)].name;
    if (at_bounds.contains(j))
      doubt(fmt::format("{} ended on a bound, {:.6g}: the curves pull it beyond, or do not show it", name,
                        material.values[static_cast<std::size_t>(j)]));
    else if (std::isinf(deviation[j]))
      together.push_back(name);
    else if (!std::isfinite(deviation[j]))
      doubt(fmt::format("{} is not determined: the fitted rows do not show it", name));
  }
  if (!together.empty())
    doubt(
        fmt::format("{} are not determined: the fitted rows show a combination of them alone. Other rows or bars may "
                    "tell them apart, or one of them is better held fixed",
                    fmt::join(together, ", ")));
  for (auto& unlikely : unlikely_values(test, material, material.values)) run.doubts.push_back(std::move(unlikely));
  const Eigen::VectorXd predicted = set.predict(material.values);
  run.title = test.title, run.law = material.law->name(), run.stress_unit = io::stress_unit(test.units),
  run.time_unit = test.units.time;
  run.case_file = test.file.string(), run.case_text = test.text, run.versions = versions();
  for (std::size_t j = 0; j < material.values.size(); ++j) {
    const auto k = static_cast<Eigen::Index>(j);
    const bool is_free = all_free.contains(static_cast<int>(j));
    run.parameters.push_back({material.information[j].name, material.information[j].unit,
                              material.information[j].effect, first[j], material.values[j], deviation[k],
                              noise_deviation[k], is_free, at_bounds.contains(static_cast<int>(j))});
  }
  for (const auto& experiment : test.experiments) {
    const auto members = of_group(set.curves(), experiment.name);
    double sum = 0.0, of_strain = 0.0;
    for (std::size_t k = 0; k < set.curves().size(); ++k)
      if (set.curves()[k].group == experiment.name)
        sum += set.curves()[k].deviation, of_strain += strain_noise[k] / static_cast<double>(members.size());
    const auto of = [&](bool fitted) {
      const auto m = id::misfit(set, predicted, experiment.name, fitted);
      return io::CurveRun::Misfit{m.rows, m.stress, m.chi, m.typical};
    };
    run.groups.push_back({experiment.name, deviation_from(experiment), static_cast<int>(members.size()),
                          sum / static_cast<double>(members.size()), of_strain,
                          members.size() > 1 ? id::scatter(members) : std::nan(""), of(true), of(false)});
  }
  constexpr double beyond_scatter = 3.0;
  for (const auto& g : run.groups)
    if (g.fitted.stress > beyond_scatter * g.floor)
      doubt(fmt::format(
          "experiments.{}: {:.3g} {} are left (rms), where its bars differ by {:.3g}: something is missing, "
          "and the parameters make up for it (imic3d loop)",
          g.name, g.fitted.stress, run.stress_unit, g.floor));
  constexpr double beyond_noise = 1.5;
  for (const auto& g : run.groups)
    if (g.curves == 1 && g.fitted.rows > 0 && g.fitted.chi > beyond_noise)
      doubt(fmt::format(
          "experiments.{}: {:.2g} times what its noise is is left (rms): something is missing, and the "
          "parameters, whose standard deviations are those of the noise alone, make up for it (imic3d loop)",
          g.name, g.fitted.chi));
  for (const auto& curve : set.curves()) {
    const auto response = material::pull_bar(*material.law, material.values, curve.history);
    run.curves.push_back({curve.name, curve.group, curve.engineering, curve.history.time, curve.history.strain,
                          curve.stress, curve.engineering ? response.engineering : response.kirchhoff, curve.use});
  }
  run.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  collectively(world, [&] {
    if (!world.is_root()) return;
    write_results(folder, test, run);
    io::write_curve_results(folder, run);
    fmt::print("\n{}\n", test.title);
    for (const auto& p : run.parameters)
      fmt::print("  {:10} {:14.6g} {:14} {}\n", p.name, p.value, p.unit,
                 p.at_bound ? "(on a bound)"
                 : std::isfinite(p.deviation)
                     ? fmt::format("+- {:.2g} ({:.1f} %)", p.deviation, 100.0 * relative(p.deviation, p.value))
                 : p.free ? "(not determined)"
                          : "(fixed)");
    fmt::print("  measured - predicted, rms (and typical) [{}]\n    {:28} {:>6} {:>14} {:>16} {:>16}\n",
               run.stress_unit, "experiment", "curves", "between them", "fitted", "held out");
    for (const auto& g : run.groups) {
      const auto misfit = [](const io::CurveRun::Misfit& m) {
        return m.rows > 0 ? fmt::format("{:.3g} ({:.3g})", m.stress, m.typical) : std::string("-");
      };
      fmt::print("    {:28} {:6} {:>14} {:>16} {:>16}\n", g.name, g.curves,
                 std::isfinite(g.floor) ? fmt::format("{:.3g}", g.floor) : "-", misfit(g.fitted), misfit(g.held_out));
    }
    fmt::print("  {:.1f} s; report: {}\n", run.seconds, (folder / "report.html").string());
  });
  if (!run.converged) throw ConvergenceError("not all stages converged; their results are written");
}

void print_experiments(const io::Case& test) {
  for (const auto& experiment : test.experiments) {
    Eigen::Index rows = 0;
    for (const auto& table : experiment.tables) rows += table.strain.size();
    fmt::print("  experiment   {}: {} curve{}, {} rows{}\n", experiment.name, experiment.files.size(),
               experiment.files.size() == 1 ? "" : "s", rows,
               experiment.held_out                ? ", held out"
               : experiment.held_out_rows.empty() ? ""
                                                  : ", rows " + io::to_text(experiment.held_out_rows) + " held out");
  }
}

}  // namespace imic3d::app
