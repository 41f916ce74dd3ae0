#pragma once
// Communicators, groups of ranks that work side by side, and errors that every rank must see alike.

#include <mpi.h>

#include <exception>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace imic3d {

/// Rank and size of a communicator that somebody else owns.
struct Communicator {
  MPI_Comm handle = MPI_COMM_WORLD;
  [[nodiscard]] int rank() const;
  [[nodiscard]] int size() const;
  [[nodiscard]] bool is_root() const { return rank() == 0; }
  void barrier() const;
  void sum(std::span<double> values) const;  ///< in place, over all ranks
  [[nodiscard]] double sum(double value) const;
  [[nodiscard]] double max(double value) const;
  [[nodiscard]] bool all(bool value) const;
  void broadcast(std::span<double> values, int root = 0) const;
  void broadcast(std::string& text, int root = 0) const;
};

/// Runs `work` on every rank of `communicator` without skipping a collective: an exception that any rank throws is
/// re-thrown on all of them (InputError and ConvergenceError keep their type), so that nobody waits for ever.
/// `work` itself must not contain a collective operation after the place where only some ranks can fail.
void collectively(const Communicator& communicator, const std::function<void()>& work);

/// Splits a communicator into groups of consecutive ranks that run side by side.
/// With fewer ranks than tasks a group takes several tasks, one after another.
class GroupLayout {
 public:
  /// `groups` = 0 chooses min(size, tasks); more groups than ranks are as many as ranks (plan_groups chooses by cost).
  GroupLayout(Communicator world, int tasks, int groups = 0);
  ~GroupLayout();
  GroupLayout(const GroupLayout&) = delete;
  GroupLayout& operator=(const GroupLayout&) = delete;

  [[nodiscard]] Communicator world() const { return world_; }
  [[nodiscard]] Communicator group() const { return group_; }  ///< this rank's group
  [[nodiscard]] int groups() const { return groups_; }
  [[nodiscard]] int index() const { return index_; }  ///< number of this rank's group

 private:
  Communicator world_, group_;
  int groups_ = 1, index_ = 0;
};

}  // namespace imic3d
