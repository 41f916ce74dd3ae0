#include <algorithm>

#include "imic3d/core/error.hpp"
#include "imic3d/core/groups.hpp"
#include "imic3d/core/interrupt.hpp"

namespace imic3d {

int Communicator::rank() const {
  int value = 0;
  MPI_Comm_rank(handle, &value);
  return value;
}

int Communicator::size() const {
  int value = 1;
  MPI_Comm_size(handle, &value);
  return value;
}

void Communicator::barrier() const { MPI_Barrier(handle); }

void Communicator::sum(std::span<double> values) const {
  // MPI counts are 32-bit: long vectors go in pieces.
  constexpr std::size_t piece = 1U << 28U;
  for (std::size_t begin = 0; begin < values.size(); begin += piece)
    MPI_Allreduce(MPI_IN_PLACE, values.data() + begin, static_cast<int>(std::min(piece, values.size() - begin)),
                  MPI_DOUBLE, MPI_SUM, handle);
}

double Communicator::sum(double value) const {
  MPI_Allreduce(MPI_IN_PLACE, &value, 1, MPI_DOUBLE, MPI_SUM, handle);
  return value;
}

double Communicator::max(double value) const {
  MPI_Allreduce(MPI_IN_PLACE, &value, 1, MPI_DOUBLE, MPI_MAX, handle);
  return value;
}

bool Communicator::all(bool value) const {
  int flag = value ? 1 : 0;
  MPI_Allreduce(MPI_IN_PLACE, &flag, 1, MPI_INT, MPI_MIN, handle);
  return flag == 1;
}

void Communicator::broadcast(std::span<double> values, int root) const {
  constexpr std::size_t piece = 1U << 28U;
  for (std::size_t begin = 0; begin < values.size(); begin += piece)
    MPI_Bcast(values.data() + begin, static_cast<int>(std::min(piece, values.size() - begin)), MPI_DOUBLE, root,
              handle);
}

void Communicator::broadcast(std::string& text, int root) const {
  auto length = static_cast<unsigned long long>(text.size());
  MPI_Bcast(&length, 1, MPI_UNSIGNED_LONG_LONG, root, handle);
  text.resize(length);
  MPI_Bcast(text.data(), static_cast<int>(length), MPI_CHAR, root, handle);
}

namespace {
enum Kind : int { fine = 0, other = 1, convergence = 2, input = 3, interruption = 4 };
}

void collectively(const Communicator& communicator, const std::function<void()>& work) {
  int kind = fine;
  std::string message;
  std::exception_ptr mine;
  try {
    work();
  } catch (const InputError& error) {
    kind = input, message = error.what(), mine = std::current_exception();
  } catch (const ConvergenceError& error) {
    kind = convergence, message = error.what(), mine = std::current_exception();
  } catch (const Interrupted& error) {
    kind = interruption, message = error.what(), mine = std::current_exception();
  } catch (const std::exception& error) {
    kind = other, message = error.what(), mine = std::current_exception();
  }
  // The lowest rank that failed speaks for all.
  int speaker = kind == fine ? communicator.size() : communicator.rank();
  MPI_Allreduce(MPI_IN_PLACE, &speaker, 1, MPI_INT, MPI_MIN, communicator.handle);
  if (speaker == communicator.size()) return;
  MPI_Bcast(&kind, 1, MPI_INT, speaker, communicator.handle);
  communicator.broadcast(message, speaker);
  if (communicator.rank() == speaker) std::rethrow_exception(mine);
  if (kind == input) throw InputError({Mistake{message, "", ""}});
  if (kind == convergence) throw ConvergenceError(message);
  if (kind == interruption) throw Interrupted(message);
  throw std::runtime_error(message);
}

GroupLayout::GroupLayout(Communicator world, int tasks, int groups) : world_(world) {
  const int size = world.size();
  groups_ = std::clamp(groups > 0 ? groups : tasks, 1, size);
  index_ = group_of_rank(world.rank(), size, groups_);
  MPI_Comm_split(world.handle, index_, world.rank(), &group_.handle);
}

GroupLayout::~GroupLayout() { MPI_Comm_free(&group_.handle); }

}  // namespace imic3d
