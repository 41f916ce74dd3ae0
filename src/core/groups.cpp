#include "imic3d/core/groups.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>

namespace imic3d {

namespace {

GroupPlan plan_of(int ranks, int groups, const GroupCosts& costs) {
  GroupPlan plan;
  plan.ranks.assign(static_cast<std::size_t>(groups), 0);
  for (int rank = 0; rank < ranks; ++rank) ++plan.ranks[static_cast<std::size_t>(group_of_rank(rank, ranks, groups))];
  std::vector<double> busy;
  for (int k = 0; k < groups; ++k) {
    plan.tasks.push_back(costs.tasks / groups + (k < costs.tasks % groups ? 1 : 0));
    const double one = costs.serial + (1.0 - costs.serial) / plan.ranks[static_cast<std::size_t>(k)];
    busy.push_back(one * plan.tasks.back());
    plan.time = std::max(plan.time, busy.back());
    if (k == 0) busy[0] += costs.before * one;
  }
  plan.time += costs.before * (costs.serial + (1.0 - costs.serial) / plan.ranks[0]);
  for (const double own : busy) plan.idle.push_back(plan.time > 0.0 ? 1.0 - own / plan.time : 0.0);
  return plan;
}

std::string groups_of(const std::vector<int>& ranks) {
  const bool one = ranks == std::vector<int>{1};
  return fmt::format("{} group{} of {} rank{}", ranks.size(), ranks.size() == 1 ? "" : "s", fmt::join(ranks, ", "),
                     one ? "" : "s");
}

}  // namespace

int group_of_rank(int rank, int ranks, int groups) {
  return static_cast<int>(static_cast<long>(rank) * groups / ranks);
}

GroupPlan plan_groups(int ranks, const GroupCosts& costs, int groups) {
  if (groups > 0) return plan_of(ranks, std::min(groups, ranks), costs);
  GroupPlan best = plan_of(ranks, 1, costs);
  for (int more = 2; more <= std::min(ranks, costs.tasks); ++more) {
    GroupPlan plan = plan_of(ranks, more, costs);
    if (plan.time < best.time * (1.0 - 1e-9)) best = std::move(plan);
  }
  return best;
}

std::string to_text(const GroupPlan& plan) { return groups_of(plan.ranks); }

void GroupClock::side_by_side(const std::function<void()>& work) {
  const auto begin = std::chrono::steady_clock::now();
  const auto since = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count(); };
  double own = 0.0;
  collectively(layout_.world(), [&] {
    work();
    own = since();
  });
  busy_ += own;
  idle_ += since() - own;
}

std::vector<GroupTime> GroupClock::times() const {
  const auto groups = static_cast<std::size_t>(layout_.groups()), mine = static_cast<std::size_t>(layout_.index());
  std::vector<double> all(3 * groups, 0.0);
  if (layout_.group().is_root())
    all[3 * mine] = layout_.group().size(), all[3 * mine + 1] = busy_, all[3 * mine + 2] = idle_;
  layout_.world().sum(all);
  std::vector<GroupTime> times;
  for (std::size_t k = 0; k < groups; ++k)
    times.push_back({static_cast<int>(std::lround(all[3 * k])), all[3 * k + 1], all[3 * k + 2]});
  return times;
}

std::string to_text(const std::vector<GroupTime>& times) {
  std::vector<int> ranks;
  std::vector<std::string> idle;
  double whole = 0.0;
  for (const auto& time : times) {
    ranks.push_back(time.ranks);
    idle.push_back(fmt::format("{:.0f} %", 100.0 * time.idle / std::max(time.busy + time.idle, 1e-300)));
    whole = std::max(whole, time.busy + time.idle);
  }
  return fmt::format("{}, idle {} of {:.3g} s", groups_of(ranks), fmt::join(idle, ", "), whole);
}

}  // namespace imic3d
