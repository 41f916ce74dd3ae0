#pragma once
// What a loop's page plots over the frames.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace imic3d::io {

/// Whether effects were looked for; of an identification alone there is no model before.
[[nodiscard]] bool searched(const nlohmann::json& summary);

/// NaN where there is none.
[[nodiscard]] std::vector<double> numbers(const nlohmann::json& list);

/// The load and below it the error of each frame with what noise alone leaves, the force residual with its noise, the
/// first mode of what remains; held-out frames shaded.
[[nodiscard]] std::string frame_plots(const nlohmann::json& summary);

/// The error of each frame before and after what was added.
[[nodiscard]] std::string chi_plot(const nlohmann::json& summary, const std::string& title);

/// Of bars: the residual of every bar over its strain, before and after.
[[nodiscard]] std::string bar_plots(const nlohmann::json& summary);

}  // namespace imic3d::io
