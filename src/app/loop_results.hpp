#pragma once
// results.h5 of imic3d loop, with results.xdmf beside it where there is a surface: what the figures
// (tools/plot_loop.py) are drawn from. Rank 0 only.
//
// case/, program/      as in every results file (io/run_results.hpp)
// loop/                frames [F], held_out [F], before/ and after/ {chi, null_chi [F]}; of images and fields time,
// force, before/force, after/force [F];
//                      of several tests and of curves frame_names [F]; of several tests tests [T], first_frames [T]
// surface/, loop/before/displacement, loop/after/displacement [F,n,3], loop/remainder/   of the surface; with cameras
// on both faces in front/ and back/ curves/              names, groups, held_out [K], and of each curve NNNN/{strain,
// measured, before, after} [rows]

#include <filesystem>
#include <span>

#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/curve_experiment.hpp"
#include "loop_report.hpp"

namespace imic3d::app {

io::ResultsFile write_loop_fields(const std::filesystem::path& folder, const io::Case& test,
                                  const loop::FieldExperiment& experiment, const loop::Report& report,
                                  const LoopFields& fields);

/// A curve as it was measured and predicted.
struct LoopCurve {
  std::string name, group;
  bool held_out = false;
  Eigen::VectorXd strain, measured, before, after;
};
io::ResultsFile write_loop_curves(const std::filesystem::path& folder, const io::Case& test,
                                  const loop::Experiment& experiment, const loop::Report& report,
                                  const std::vector<LoopCurve>& curves);

/// Of several tests what all have in common; `first_frames`: of each test among all.
io::ResultsFile write_loop_tests(const std::filesystem::path& folder, const io::Case& all,
                                 const loop::Experiment& experiment, const loop::Report& report,
                                 const std::vector<int>& first_frames);

}  // namespace imic3d::app
