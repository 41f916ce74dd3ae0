#include "imic3d/identification/gauge.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "imic3d/core/median.hpp"
#include "imic3d/identification/curves.hpp"

namespace imic3d::identification {

using Eigen::Index;
using Eigen::VectorXd;

std::vector<Index> turning_rows(const VectorXd& strain, double play) {
  std::vector<Index> turns;
  Index last = 0;
  double way = 0.0;  // that the strain goes
  for (Index row = 1; row < strain.size(); ++row) {
    const double further = strain[row] - strain[last];
    const bool turned = std::abs(further) > play && way * further <= 0.0;
    if (turned && way != 0.0) turns.push_back(last);
    if (turned || way * further > 0.0) last = row, way = std::copysign(1.0, further);
  }
  return turns;
}

namespace {

/// Least squares y = mean + slope (x - centre).
struct Line {
  double centre, mean, slope, squares;  // squares: sum of (x - centre)^2
  double count;
  Line(const VectorXd& x, const VectorXd& y)
      : centre(x.mean()),
        mean(y.mean()),
        slope((x.array() - centre).matrix().dot(y) / (x.array() - centre).square().sum()),
        squares((x.array() - centre).square().sum()),
        count(static_cast<double>(x.size())) {}
  [[nodiscard]] double at(double x) const { return mean + slope * (x - centre); }
  [[nodiscard]] double variance(double x, double noise) const {
    return noise * noise * (1.0 / count + (x - centre) * (x - centre) / squares);
  }
};

/// Of the rows [from, from + count), if they go at one rate.
std::optional<Line> steady(const VectorXd& x, const VectorXd& y, Index from, Index count, double noise) {
  constexpr double alike = 0.05;
  if (count < 3 || !(x[from + count - 1] > x[from])) return std::nullopt;
  const auto of = [&](Index first, Index size) { return Line(x.segment(first, size), y.segment(first, size)); };
  const Line line = of(from, count);
  const Index half = count / 2 + 1, last = from + count;
  const Line first = of(from, half), second = of(last - half, half);
  const double by_noise =
      noise * std::sqrt(1.0 / first.squares + 1.0 / second.squares);  // of the difference of the two rates
  if (!(std::abs(first.slope - second.slope) < alike * std::abs(line.slope) + 3.0 * by_noise)) return std::nullopt;
  return line;
}

/// Rows, rounded down, whose mean is known to a `part` of what the strain goes in them, if it goes by `step` from one
/// to the next.
Index enough(double step, double noise, double part, Index most) {
  return step > 0.0 ? std::min(most, static_cast<Index>(std::pow(noise / (part * step), 2.0 / 3.0))) : most;
}

/// Where the strain's lines meet between two rows.
struct Corner {
  std::size_t turn;           // its number
  material::BarTurn between;  // if it turned there
  double further, of_lines;   // than the nearer row; by noise
  double interval;            // between the rows
  double better;              // the stress goes with it than with a turn at the row [stress]
  // Of the stress, where its own lines meet:
  double kink = 0.0;            // change of its rate
  double lag = 0.0, if_at_row;  // behind the strain's corner; what of it a turn at the row would make [time]
};

/// Where the rate of the stress changes most near that corner, against the way that the strain went: its lines through
/// `before` and `after` rows of [first, last].
void find_stress(Corner& corner, const VectorXd& time, const VectorXd& stress, Index first, Index last, Index before,
                 Index after, double rate_to, double rate_back) {
  constexpr Index most = 12;  // rows
  const Index next = corner.between.row;
  for (Index at = std::max(next - most, first + before); at <= std::min(next + most, last + 1 - after); ++at) {
    const Line to(time.segment(at - before, before), stress.segment(at - before, before)),
        back(time.segment(at, after), stress.segment(at, after));
    const double kink = std::copysign(1.0, rate_to) * (to.slope - back.slope);
    if (!(kink > corner.kink)) continue;
    corner.kink = kink, corner.lag = (back.at(0.0) - to.at(0.0)) / (to.slope - back.slope) - corner.between.time;
    corner.if_at_row = corner.further * std::max(0.0, back.slope / rate_back - to.slope / rate_to) / kink;
  }
}

/// A force that lags, or rubs, turns as long after (before) the strain at all corners: then the stress of two rows says
/// nothing of where the strain turned, but what is left when that is taken off does - as far as the rows are not as
/// near to all of the corners.
void take_off_lag(std::vector<Corner>& corners, double noise, double beyond_chance) {
  constexpr double least = 0.1;  // of the rows' interval
  const auto count = static_cast<double>(corners.size());
  if (corners.size() < 3 ||
      std::any_of(corners.begin(), corners.end(), [](const Corner& c) { return !(c.kink > 0.0); }))
    return;
  double interval = 0.0, of_noise = 0.0;
  for (const Corner& c : corners)
    interval += c.interval / count, of_noise += 2.2 * noise / (c.kink * count);  // of lines through three rows
  const auto lag_if = [&](double at_row) {                                       // and its mean distance
    std::vector<double> lags;
    for (const Corner& c : corners) lags.push_back(c.lag - at_row * c.if_at_row);
    const double middle = median(lags);
    double distance = 0.0;
    for (double lag : lags) distance += std::abs(lag - middle) / count;
    return std::pair(middle, distance);
  };
  const auto [between, off_between] = lag_if(0.0);
  const auto [at_row, off_at_row] = lag_if(1.0);
  const auto seen = [&](double lag, double off) {
    return std::abs(lag) > std::max(least * interval, 4.0 * std::max(off, of_noise) / std::sqrt(count));
  };
  const bool told = std::abs(off_between - off_at_row) > of_noise / std::sqrt(count);
  const bool lies_between = !told || off_between < off_at_row;
  if (!(lies_between ? seen(between, off_between) : seen(at_row, off_at_row)) || (!told && !seen(at_row, off_at_row)))
    return;
  for (Corner& c : corners) {
    const double left = c.lag - (lies_between ? between : at_row);
    c.better = told ? c.kink * (std::abs(left - c.if_at_row) - std::abs(left)) : 0.0;
    if (std::abs(c.better) < beyond_chance) c.better = lies_between ? 1e-300 : -1e-300;  // in doubt, as the others
  }
}

}  // namespace

double strain_noise(const VectorXd& time, const VectorXd& strain, const VectorXd& stress) {
  constexpr double far = 3.0, of_the_rest = 0.98660;  // root of E z^2 of a standard normal number that is less
  const std::vector<double> strains = distances(time, strain), stresses = distances(time, stress);
  std::vector<double> sizes;
  for (double d : strains) sizes.push_back(std::abs(d));
  double of_strain = sizes.empty() ? 0.0 : median(sizes) / 0.6745;
  for (int iteration = 0; iteration < 20; ++iteration) {
    double squares = 0.0, count = 0.0;
    for (double d : strains)
      if (std::abs(d) < far * of_strain) squares += d * d, count += 1.0;
    of_strain = std::sqrt(squares / std::max(1.0, count)) / of_the_rest;
  }
  if (of_strain <= 1e-12 * strain.cwiseAbs().maxCoeff()) return 0.0;  // of round-off
  const double of_stress = point_noise(time, stress);
  double square = 0.0, against = 0.0, of_the_stress = 0.0, together = 0.0, last = 0.0;
  for (std::size_t i = 0; i < strains.size(); ++i) {
    // What is farther is a corner of the course.
    const bool corner = std::abs(strains[i]) >= far * of_strain;
    const double d = corner ? 0.0 : strains[i] / of_strain,
                 s = corner || !(of_stress > 0.0) ? 0.0 : std::clamp(stresses[i] / of_stress, -far, far);
    square += d * d, against -= 1.5 * d * last, of_the_stress += s * s, together += d * s;
    last = d;
  }
  if (together > 0.5 * std::sqrt(square * of_the_stress)) return 0.0;
  return of_strain * std::sqrt(std::clamp(against / square, 0.0, 1.0));
}

std::vector<material::BarTurn> find_turns(const VectorXd& time, const VectorXd& strain, const VectorXd& stress,
                                          double noise) {
  constexpr double rounded = 0.1, round_off = 1e-9;
  // by the noise of two rows, beyond chance
  const double of_stress = noise_of_course(strain, stress), told = 6.0 * std::sqrt(2.0) * of_stress;
  const std::vector<Index> rows = turning_rows(strain, 8.0 * noise);
  std::vector<material::BarTurn> turns;
  std::vector<Corner> corners;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    // The extreme rows of the neighbouring turns may lie beyond these.
    const Index row = rows[k], first = k > 0 ? rows[k - 1] + 1 : 0,
                last = k + 1 < rows.size() ? rows[k + 1] - 1 : strain.size() - 1;
    const double up = std::abs(strain[row] - strain[row - 1]), down = std::abs(strain[row] - strain[row + 1]);
    const double corner = 0.5 * std::abs(up - down),
                 parabola = up + down > 0.0 ? 0.5 * corner * corner / (up + down) : 0.0;
    turns.push_back({row, false, time[row], strain[row], 0.5 * corner});
    if (first >= row || last <= row) continue;
    const double step_to = std::abs(strain[row] - strain[first]) / static_cast<double>(row - first),
                 step_back = std::abs(strain[row] - strain[last]) / static_cast<double>(last - row);
    // Among rows closer than the noise the largest one is some rows from the turn.
    const Index beside_to = 1 + enough(step_to, noise, 0.5, row - first),
                beside_back = 1 + enough(step_back, noise, 0.5, last - row);
    const Index least_before = std::max<Index>(3, enough(step_to, noise, 0.05, row - first)),
                least_after = std::max<Index>(3, enough(step_back, noise, 0.05, last - row));
    Index before = std::min(std::max<Index>(5, least_before), row - beside_to - first + 1),
          after = std::min(std::max<Index>(5, least_after), last - row - beside_back + 1);
    const Index until = row + beside_back;
    if (before < 3 || after < 3) continue;
    material::BarTurn& turn = turns.back();
    turn.deviation = parabola;
    // A load train that gives way has the gauge go faster while the bar is elastic, which may be fewer rows.
    std::optional<Line> to, back;
    for (++before; !to && before > least_before;)
      --before, to = steady(time, strain, row - beside_to - before + 1, before, noise);
    for (++after; !back && after > least_after;) --after, back = steady(time, strain, until, after, noise);
    if (!to || !back || !(to->slope * back->slope < 0.0)) continue;
    const Index from = row - beside_to - before + 1;
    const double apart = to->slope - back->slope, meet = (back->at(0.0) - to->at(0.0)) / apart, there = to->at(meet);
    if (!(meet > time[row - beside_to] && meet < time[until])) continue;
    const Index next = std::upper_bound(time.begin() + row - beside_to, time.begin() + until, meet) - time.begin();
    if (k > 0 &&
        next - 1 <= (!corners.empty() && corners.back().turn + 1 == k ? corners.back().between.row : turns[k - 1].row))
      continue;
    const bool later = meet - time[next - 1] < time[next] - meet;  // than the nearer row
    const double on_line = later ? to->at(time[next - 1]) : back->at(time[next]), further = std::abs(there - on_line);
    const double of_lines = std::sqrt(
        (back->slope * back->slope * to->variance(meet, noise) + to->slope * to->slope * back->variance(meet, noise)) /
        (apart * apart));
    const Index nearer = later ? next - 1 : next;
    turn = {nearer, false, time[nearer], noise > 0.0 ? on_line : strain[nearer], of_lines};
    if (further < round_off * std::abs(to->slope) * (time[next] - time[next - 1])) continue;
    const auto slope = [&](Index first_row, Index count) {
      return Line(strain.segment(first_row, count), stress.segment(first_row, count)).slope;
    };
    // before a corner of the curve, where it can be
    const Index near_to = std::max<Index>(3, enough(step_to, noise, 0.05, before)),
                near_back = std::max<Index>(3, enough(step_back, noise, 0.05, after));
    const double slope_to = slope(from + before - near_to, near_to), slope_back = slope(until, near_back),
                 change = stress[next] - stress[next - 1];
    const double at_last = to->at(time[next - 1]), at_next = back->at(time[next]);
    const double turned = slope_to * (there - at_last) + slope_back * (at_next - there),
                 straight = (later ? slope_back : slope_to) * (at_next - at_last);
    corners.push_back({.turn = k,
                       .between = {next, true, meet, there, 0.0},
                       .further = further,
                       .of_lines = of_lines,
                       .interval = time[next] - time[next - 1],
                       .better = std::abs(change - straight) - std::abs(change - turned),
                       .if_at_row = 0.0});
    find_stress(corners.back(), time, stress, first, last, near_to, near_back, to->slope, back->slope);
  }
  take_off_lag(corners, of_stress, told);
  double of_all = 0.0;  // one machine turns in one way
  for (const Corner& corner : corners) of_all += corner.better;
  for (const Corner& corner : corners) {
    material::BarTurn& turn = turns[corner.turn];
    const bool went_there = (std::abs(corner.better) < told ? of_all : corner.better) > 0.0;
    if (went_there) turn = corner.between;
    turn.deviation = std::hypot(corner.of_lines, (std::abs(corner.better) < told ? 0.5
                                                  : went_there                   ? rounded
                                                                                 : 0.0) *
                                                     corner.further);
  }
  return turns;
}

namespace {

/// Rows on one line, as far as `noise` lets tell: least squares of y over x, from sums about a row.
class Stretch {
 public:
  Stretch(const VectorXd& x, const VectorXd& y, Index row, double noise) : x_(x), y_(y), row_(row), noise_(noise) {}

  void add(Index at, double sign = 1.0) {
    const double x = x_[at] - x_[row_], y = y_[at] - y_[row_];
    n_ += sign, sx_ += sign * x, sy_ += sign * y, sxx_ += sign * x * x, sxy_ += sign * x * y, syy_ += sign * y * y;
  }
  /// Whether the rows lie on a line.
  [[nodiscard]] bool straight() const {
    const double freedom = n_ - 2.0;
    return syy() - sxy() * slope() < noise_ * noise_ * (freedom + 4.0 * std::sqrt(2.0 * freedom));
  }
  /// Whether another row lies on it.
  [[nodiscard]] bool goes_through(Index at) const {
    const double x = x_[at] - x_[row_] - sx_ / n_;
    return std::abs(y_[at] - y_[row_] - sy_ / n_ - slope() * x) <
           4.0 * noise_ * std::sqrt(1.0 + 1.0 / n_ + x * x / sxx());
  }
  [[nodiscard]] double slope() const { return sxx() > 0.0 ? sxy() / sxx() : 0.0; }
  [[nodiscard]] double here() const { return y_[row_] + sy_ / n_ - slope() * sx_ / n_; }

 private:
  [[nodiscard]] double sxx() const { return sxx_ - sx_ * sx_ / n_; }
  [[nodiscard]] double sxy() const { return sxy_ - sx_ * sy_ / n_; }
  [[nodiscard]] double syy() const { return syy_ - sy_ * sy_ / n_; }

  const VectorXd &x_, &y_;
  Index row_;
  double noise_, n_ = 0.0, sx_ = 0.0, sy_ = 0.0, sxx_ = 0.0, sxy_ = 0.0, syy_ = 0.0;
};

/// The strain at a row of [from, until) by the line through the rows around that lie on it with this one; nothing
/// behind a corner does.
double on_line(const VectorXd& time, const VectorXd& strain, Index row, Index from, Index until, double noise) {
  constexpr double part = 1.0 / 12.0;
  constexpr Index most = 201;
  if (until - from < 3) return strain[row];
  const auto bend = [&](Index first) {
    const auto distance = distances(time.segment(first, 3), strain.segment(first, 3));
    return distance.empty() ? INFINITY : std::abs(distance.front());
  };
  Index first = std::clamp(row - 1, from, until - 3);
  if (bend(first) > 3.0 * noise)
    for (const Index other : {row - 2, row})
      if (other >= from && other <= until - 3 && bend(other) < bend(first)) first = other;
  if (!(bend(first) < 3.0 * noise) || std::abs(strain[first + 2] - strain[first]) >= 2.0 * noise / part)
    return strain[row];
  Stretch line(time, strain, row, noise);
  for (Index at = first; at < first + 3; ++at) line.add(at);
  bool before = true, after = true;  // whether there may be more
  Index last = first + 2;
  while ((before || after) && last - first + 1 < most &&
         std::abs(line.slope()) * (time[last] - time[first]) <
             noise / (part * std::sqrt(static_cast<double>(last - first + 1)))) {
    const bool backwards = before && (!after || row - first <= last - row);
    const Index next = backwards ? first - 1 : last + 1;
    bool& open = backwards ? before : after;
    open = next >= from && next < until && line.goes_through(next);
    if (!open) continue;
    line.add(next);
    open = line.straight();
    if (!open)
      line.add(next, -1.0);
    else
      (backwards ? first : last) = next;
  }
  return line.here();
}

}  // namespace

std::vector<material::BarTurn> find_corners(const VectorXd& time, const VectorXd& strain,
                                            const std::vector<material::BarTurn>& turns, double noise) {
  constexpr Index rows = 4;
  constexpr double alike = 0.02, least = 0.1;
  std::vector<material::BarTurn> corners;
  auto turn = turns.begin();
  for (Index next = rows; next + rows <= strain.size(); ++next) {
    while (turn != turns.end() && turn->row + rows < next) ++turn;
    if (turn != turns.end() && turn->row - rows <= next) continue;
    const Line to(time.segment(next - rows, rows), strain.segment(next - rows, rows)),
        on(time.segment(next, rows), strain.segment(next, rows));
    const double spacing = time[next] - time[next - 1],
                 step = std::max(std::abs(to.slope), std::abs(on.slope)) * spacing,
                 off = std::max(3.0 * noise, alike * step);
    const auto lies_on = [&](const Line& line, Index first) {
      return (strain.segment(first, rows) - time.segment(first, rows).unaryExpr([&](double t) { return line.at(t); }))
                 .cwiseAbs()
                 .maxCoeff() < off;
    };
    if (!(spacing > 0.0) || !(to.squares > 0.0) || !(on.squares > 0.0) || !lies_on(to, next - rows) ||
        !lies_on(on, next))
      continue;
    const double meet = (on.at(0.0) - to.at(0.0)) / (to.slope - on.slope);
    if (!(meet > time[next - 1] && meet < time[next])) continue;
    const double there = to.at(meet),
                 straight = strain[next - 1] + (strain[next] - strain[next - 1]) * (meet - time[next - 1]) / spacing;
    if (std::abs(there - straight) > std::max(4.0 * noise, least * step))
      corners.push_back({next, true, meet, there, 0.0, false});
  }
  return corners;
}

VectorXd smooth_strain(const VectorXd& time, const VectorXd& strain, const std::vector<material::BarTurn>& turns,
                       double noise) {
  VectorXd smooth = strain;
  if (noise == 0.0) return smooth;
  Index from = 0;
  for (std::size_t k = 0; k <= turns.size(); ++k) {
    const Index until = k == turns.size() ? strain.size() : turns[k].between ? turns[k].row : turns[k].row + 1;
    for (Index row = from; row < until; ++row) smooth[row] = on_line(time, strain, row, from, until, noise);
    if (k < turns.size() && !turns[k].between) smooth[until - 1] = turns[k].strain;
    for (Index row = from; row < until; ++row) {  // nothing goes beyond the turns
      if (k < turns.size() && turns[k].back)
        smooth[row] = turns[k].strain > strain[from] ? std::min(smooth[row], turns[k].strain)
                                                     : std::max(smooth[row], turns[k].strain);
      if (k > 0 && turns[k - 1].back)
        smooth[row] = turns[k - 1].strain > strain[until - 1] ? std::min(smooth[row], turns[k - 1].strain)
                                                              : std::max(smooth[row], turns[k - 1].strain);
    }
    from = until;
  }
  return smooth;
}

Eigen::MatrixXd TurnMemory::errors(double noise) const {
  return slopes * (deviation.array().square() + noise * noise).sqrt().matrix().asDiagonal();
}

TurnMemory memory_of_turns(const material::BarHistory& history, double noise, const VectorXd& nominal,
                           const std::function<VectorXd(const material::BarHistory&)>& stress) {
  VectorXd course(static_cast<Index>(history.turns.size()) + 2);
  course[0] = history.strain[0], course.tail(1) = history.strain.tail(1);
  for (std::size_t k = 0; k < history.turns.size(); ++k) course[static_cast<Index>(k) + 1] = history.turns[k].strain;
  std::vector<std::size_t> turns;
  for (const Index at : turning_rows(course, 4.0 * noise))
    if (const auto turn = static_cast<std::size_t>(at) - 1; noise > 0.0 || history.turns[turn].deviation > 0.0)
      turns.push_back(turn);
  const auto count = static_cast<Index>(turns.size());
  TurnMemory memory{.slopes = Eigen::MatrixXd::Zero(history.strain.size(), count), .deviation = VectorXd::Zero(count)};
  for (Index k = 0; k < count; ++k) {
    material::BarHistory moved = history;
    material::BarTurn& turn = moved.turns[turns[static_cast<std::size_t>(k)]];
    memory.deviation[k] = turn.deviation;
    const double step = std::max(1e-6, std::hypot(noise, turn.deviation));
    const Index after = turn.between ? turn.row : turn.row + 1;
    const Index at = static_cast<Index>(turns[static_cast<std::size_t>(k)]) + 1;
    (turn.between ? turn.strain : moved.strain[turn.row]) += std::copysign(step, course[at] - course[at - 1]);
    const VectorXd other = stress(moved);
    if (other.size() == 0) continue;
    const Index rows = history.strain.size() - after;
    memory.slopes.col(k).tail(rows) = (other - nominal).tail(rows) / step;
  }
  return memory;
}

Eigen::Index spread_stamps(Eigen::VectorXd& time) {
  std::vector<Eigen::Index> first;  // row of each stamp, and the end
  double tick = std::numeric_limits<double>::infinity();
  for (Eigen::Index row = 0; row < time.size(); ++row) {
    if (row > 0 && time[row] == time[row - 1]) continue;
    if (row > 0) tick = std::min(tick, time[row] - time[row - 1]);
    first.push_back(row);
  }
  const Eigen::Index shared = time.size() - std::ssize(first);
  if (shared == 0 || first.size() < 2) return 0;
  const std::size_t last = first.size() - 1;
  first.push_back(time.size());
  const auto count = [&](std::size_t k) { return first[k + 1] - first[k]; };
  for (std::size_t k = 0; k <= last; ++k) {
    const Eigen::Index beside = k == 0      ? count(1)
                                : k == last ? count(last - 1)
                                            : 0,
                       rows = std::max(count(k), beside),
                       missing = k == 0 ? rows - count(0) : 0;  // the record begins within the stamp
    for (Eigen::Index i = 0; i < count(k); ++i)
      time[first[k] + i] += tick * static_cast<double>(missing + i) / static_cast<double>(rows);
  }
  return shared;
}

}  // namespace imic3d::identification
