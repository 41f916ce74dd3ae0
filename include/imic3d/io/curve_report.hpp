#pragma once
// What an identification on stress-strain curves leaves behind beside results.h5: result.json, curves.csv and
// report.html.

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace imic3d::io {

struct CurveRun {
  struct Parameter {
    std::string name, unit, effect;
    double start = 0.0, value = 0.0;
    double deviation = 0.0,
           /// with the scatter of whole curves; of white noise; NaN: not free or on a bound
        noise_deviation = 0.0;
    bool free = false, at_bound = false;
  };
  struct Misfit {
    Eigen::Index rows = 0;
    double stress = 0.0, chi = 0.0,
           typical = 0.0;  ///< rms of measured - predicted; over the standard deviations; robust (median)
  };
  struct Group {
    std::string name, deviation_from;  ///< `given`, the scatter of `repetitions` or `points`
    int curves = 0;
    double deviation = 0.0;  ///< of a row [stress], mean of the curves
    /// of a row's strain, mean of the curves, which weighs where they are steep; 0: none is seen
    double strain_deviation = 0.0;
    double floor =
        /// scatter between repetitions [stress]: no law can do better on all of them; NaN if there is one
        0.0;
    Misfit fitted, held_out;
  };
  struct Curve {
    std::string name, group;
    bool engineering = true;
    Eigen::VectorXd time, strain, measured, predicted;  ///< strain: logarithmic
    std::vector<char> use;                              ///< 0: not judged, 1: fitted, 2: held out
  };
  std::string title, law, stress_unit, time_unit, case_file, case_text;
  std::vector<Parameter> parameters;
  Eigen::MatrixXd covariance;  ///< of all parameters; NaN: not free, on a bound, or of another stage
  std::vector<Group> groups;
  std::vector<Curve> curves;
  std::vector<std::vector<double>> iterations;  ///< parameters after each iteration, all stages
  std::vector<double> chi;                      ///< and chi
  std::map<std::string, std::string> versions;
  bool converged = true;
  std::vector<std::string> doubts;
  double seconds = 0.0;
};

/// Throws InputError if the folder cannot be written.
void write_curve_results(const std::filesystem::path& folder, const CurveRun& run);

}  // namespace imic3d::io
