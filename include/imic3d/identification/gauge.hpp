#pragma once
// What a gauge recorded of the strain: its noise, where the bar turned back, and the course between. A bar that flowed
// until it turned has its yield surface elsewhere if it went further: all of the branch is off by Young's modulus times
// that, far more than by the noise of a row.

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "imic3d/material/bar.hpp"

namespace imic3d::identification {

/// Rows of largest and least strain before it goes back by more than `play`.
[[nodiscard]] std::vector<Eigen::Index> turning_rows(const Eigen::VectorXd& strain, double play);

/// Standard deviation of the strain's noise, from the record alone: of the distances of each row to the line through
/// its neighbours in time, as far as those of neighbouring rows are against each other, as they are for noise (-2/3;
/// Rice 1984), but not where the rate changes from row to row. 0 if the stress goes with them: then the bar moved so.
[[nodiscard]] double strain_noise(const Eigen::VectorXd& time, const Eigen::VectorXd& strain,
                                  const Eigen::VectorXd& stress);

/// Turns of a test [rows: time, strain, stress] of more than eight times the strain's `noise`. Where the strain goes at
/// one rate before and at one after (alike in both halves of five rows, of the four or three of them that are next to
/// the turn, or of as many as noise asks for, to 5 % and what that makes of it) it turned where the two lines meet, if
/// the stress does not change rather as on the straight way from row to row; the deviation is what the noise makes of
/// the lines, and a tenth of the way from the row to there, as corners are rounded - one half of it where the noise of
/// the stress lets both be: then all turns together tell. Where the stress's own corners lie behind (before) those of
/// the strain by one time at three turns and more, as a delayed force or friction puts them, that is taken off first.
/// Elsewhere it turned at a row, and further by what the parabola through the three rows goes further, as a deviation;
/// where there are too few rows, by half of what a corner between them would.
[[nodiscard]] std::vector<material::BarTurn> find_turns(const Eigen::VectorXd& time, const Eigen::VectorXd& strain,
                                                        const Eigen::VectorXd& stress, double noise = 0.0);

/// Where the strain goes on at another rate between two rows, as from a ramp to a hold: where the lines through four
/// rows before and four after meet, of which no row is off by more than noise or a fiftieth of the longer step, if that
/// is a tenth of it away from the straight way. A law that depends on the rate has a stress of its own for each of the
/// two. Not beside a turn.
[[nodiscard]] std::vector<material::BarTurn> find_corners(const Eigen::VectorXd& time, const Eigen::VectorXd& strain,
                                                          const std::vector<material::BarTurn>& turns,
                                                          double noise = 0.0);

/// Strain between the `turns` by the line through the rows around, of least squares: so many that the noise of their
/// mean is a twelfth of what the strain goes in them, and none that is not on it (four standard deviations, and as many
/// of what the line leaves of all): the course of a ramp is not that of the hold behind it. Rows that are further apart
/// than that stay. Noise of steps as short as itself is no noise of the stress alone: whenever the strain seems to turn
/// back the simulated bar unloads, and it flows by the largest of many numbers.
[[nodiscard]] Eigen::VectorXd smooth_strain(const Eigen::VectorXd& time, const Eigen::VectorXd& strain,
                                            const std::vector<material::BarTurn>& turns, double noise);

/// What the stress at each row is off by if the strain turned elsewhere.
struct TurnMemory {
  Eigen::MatrixXd slopes;     ///< d(stress)/d(strain of a turn) at the rows after it [rows x turns, stress]
  Eigen::VectorXd deviation;  ///< of the turns, beside the noise of a row [turns]
  /// What that and a `noise` of the strain make of the rows [rows x turns, stress].
  [[nodiscard]] Eigen::MatrixXd errors(double noise) const;
};
/// Of turns that are more than four times the `noise` of the strain, where these or the noise are uncertain; `nominal`
/// is the stress of this history [rows], `stress` that of another one, or empty where the law cannot follow it.
[[nodiscard]] TurnMemory memory_of_turns(const material::BarHistory& history, double noise,
                                         const Eigen::VectorXd& nominal,
                                         const std::function<Eigen::VectorXd(const material::BarHistory&)>& stress);

/// Rows whose clock is coarser than they are: those of one stamp (n of them) follow one another by its tick over n, the
/// tick being the least step of the clock; of the first and the last stamp, of which the record holds a part, as those
/// of the next one do. Returns how many rows shared the stamp of the row before. `time`: [rows, time], not descending.
Eigen::Index spread_stamps(Eigen::VectorXd& time);

}  // namespace imic3d::identification
