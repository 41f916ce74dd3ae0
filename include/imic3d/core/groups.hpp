#pragma once
// Ranks shared out among tasks that run side by side: which groups to make, and what they do with their time.

#include <functional>
#include <string>
#include <vector>

#include "imic3d/core/parallel.hpp"

namespace imic3d {

/// The group that a rank belongs to: consecutive ranks, the numbers of two groups differ by one at most.
[[nodiscard]] int group_of_rank(int rank, int ranks, int groups);

/// Tasks of equal size for groups of ranks.
struct GroupCosts {
  int tasks = 1;        ///< the groups take them side by side
  double serial = 0.0;  ///< a task takes serial + (1 - serial)/p on p ranks of what it takes on one
  int before = 0;       ///< tasks of the same size that the first group does before, while the others wait
};

/// Groups of consecutive ranks as GroupLayout makes them, and the time that they will take.
struct GroupPlan {
  std::vector<int> ranks, tasks;  ///< of each group
  std::vector<double> idle;       ///< part of the time that each group will wait
  double time = 0.0;              ///< in times of one task on one rank
  [[nodiscard]] int groups() const { return static_cast<int>(ranks.size()); }
};

/// `groups` = 0 takes as many as end first (the fewest of those, since each group has the operators in its own memory);
/// more groups than ranks are as many as ranks.
[[nodiscard]] GroupPlan plan_groups(int ranks, const GroupCosts& costs, int groups = 0);

/// "3 groups of 2, 2, 1 ranks"
[[nodiscard]] std::string to_text(const GroupPlan& plan);

/// What a group of ranks did with its time [s].
struct GroupTime {
  int ranks = 0;
  double busy = 0.0, idle = 0.0;
};

/// Measures how long the groups of a layout wait for each other.
class GroupClock {
 public:
  explicit GroupClock(const GroupLayout& layout) : layout_(layout) {}
  /// `collectively` over the layout's world, timed.
  void side_by_side(const std::function<void()>& work);
  /// Of each group, as its root measured. Collective over the world.
  [[nodiscard]] std::vector<GroupTime> times() const;

 private:
  const GroupLayout& layout_;
  double busy_ = 0.0, idle_ = 0.0;
};

/// "3 groups of 2, 2, 1 ranks, idle 0 %, 12 %, 3 % of 4.2 s"
[[nodiscard]] std::string to_text(const std::vector<GroupTime>& times);

}  // namespace imic3d
