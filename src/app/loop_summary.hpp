#pragma once
// What a loop's report says, as numbers and words: the contents of its result.json.

#include <nlohmann/json.hpp>

#include "imic3d/loop/closing.hpp"

namespace imic3d::app {

/// Numbers; null where one is not finite.
[[nodiscard]] nlohmann::json numbers(const Eigen::VectorXd& values);

/// Everything that the report says, machine-readable (docs/loop.md). Rank 0 only.
[[nodiscard]] nlohmann::json loop_summary(const loop::Experiment& experiment, const loop::Report& report);
/// What is printed of a report: the verdict of a search before the sentence.
[[nodiscard]] std::string answer(const loop::Report& report, const std::string& sentence);

}  // namespace imic3d::app
