#include "load_path.hpp"

#include <fmt/format.h>

#include "imic3d/core/error.hpp"

namespace imic3d::mechanics {

namespace {
/// Change of an element's G_t/G or G_s/G (one_point.hpp) above which a step is solved again, and how many times at
/// most.
constexpr double renewed_modulus = 1e-3;
constexpr int renewals = 4;

/// An increment goes on like the last one up to so many times its length.
constexpr double farthest_continued = 20.0;
}  // namespace

LoadPath::LoadPath(ForceBalance& balance, KeptFactors& factors, Newton& newton, PathDerivatives& derivatives,
                   const EquilibriumOptions& options, const Accuracy& accuracy, double start_time)
    : balance_(balance),
      factors_(factors),
      newton_(newton),
      derivatives_(derivatives),
      options_(options),
      accuracy_(accuracy),
      start_time_(start_time) {
  for (OwnedVec* vector :
       {&now_.displacement, &before_.displacement, &now_.change, &before_.change, &found_, &offered_})
    IMIC3D_PETSC(VecDuplicate(balance_.displacement(), vector->put()));
  IMIC3D_PETSC(VecSet(now_.displacement, 0.0));
  IMIC3D_PETSC(VecSet(now_.change, 0.0));
}

void LoadPath::Place::copy(const Place& other) {
  IMIC3D_PETSC(VecCopy(other.displacement, displacement));
  IMIC3D_PETSC(VecCopy(other.change, change));
  load = other.load;
}

int LoadPath::go_to(const LoadStep& step, const Eigen::VectorXd* near, int increments, PathStatus& status) {
  const double begin = previous_ != nullptr ? previous_->time : start_time_;
  const Eigen::VectorXd from = natural(previous_ != nullptr ? &previous_->prescribed : nullptr),
                        to = natural(&step.prescribed), force_from = force_of(previous_), force_to = force_of(&step);
  const Eigen::Index dofs = balance_.numbering().natural_size();
  const bool bent = step.bend[0].size() > 0;
  const std::array<Eigen::VectorXd, 2> bend{natural(bent ? &step.bend[0] : nullptr),
                                            natural(bent ? &step.bend[1] : nullptr)};
  int count = increments, cuts = 0, iterations = 0;
  bool offers = near != nullptr && near->size() == dofs;
  if (offers) balance_.numbering().to_global(*near, offered_);
  factors_.take(frame_, offers || derivatives_.size() > 0);  // what is differentiated will be simulated again
  balance_.assembler().save();
  before_.copy(now_);
  Start start = Start::offered;
  for (int increment = 0; increment < count;) {
    const double target = increment + 1 == count ? 1.0 : static_cast<double>(increment + 1) / count;
    balance_.apply({.prescribed = from + target * (to - from) +
                                  target * (1.0 - target) * ((1.0 - target) * bend[0] - target * bend[1]),
                    .force = force_from + target * (force_to - force_from),
                    .time_increment = (step.time - begin) / count,
                    .frame = frame_,
                    .fraction = target});
    // a change of sign or size matters, not the units: where there are forces, they count
    Eigen::VectorXd load(2 * dofs);
    load << (to - from) / count, (force_to - force_from) / count;
    const double times =
        now_.load.size() > 0 && balance_.optical() == nullptr ? load.dot(now_.load) / now_.load.squaredNorm() : 0.0;
    if (start == Start::offered && !offers) start = Start::continued;
    if (start == Start::continued && !(times > 0.0 && times < farthest_continued)) start = Start::standing;
    place(start, count - increment, times);
    const Outcome outcome = solve(start, iterations);
    if (outcome == Outcome::converged) {
      differentiate(step, target, status);
      commit(load);
      start = Start::offered;
      ++increment;
      continue;
    }
    if (start != Start::standing) {  // a poor beginning is no reason to cut the step
      offers = false;
      start = start == Start::offered ? Start::continued : Start::standing;
      continue;
    }
    if (++cuts > (accuracy_.cuts > 0 ? accuracy_.cuts : options_.max_cuts)) {
      status.limit_point = outcome == Outcome::limit_point;
      status.message = fmt::format(
          "no equilibrium at frame {} of the series (time {:.6g}) in {} increments{}", frame_ + 1, step.time, count,
          status.limit_point ? ": the prescribed force is at or beyond the maximum load that the "
                               "specimen can carry with these parameters"
                             : "");
      break;
    }
    count *= 2;
    increment = 0;
    start = Start::offered;
    balance_.assembler().restore();
    now_.copy(before_);
  }
  status.increments.push_back(count);
  status.total_iterations += iterations;
  previous_ = &step;
  ++frame_;
  return iterations;
}

/// Values of the constrained degrees among all of them, 0 elsewhere or where there are none.
Eigen::VectorXd LoadPath::natural(const Eigen::VectorXd* of_constrained) const {
  Eigen::VectorXd values = Eigen::VectorXd::Zero(balance_.numbering().natural_size());
  const auto& constrained = balance_.constrained();
  if (of_constrained != nullptr)
    for (std::size_t i = 0; i < constrained.size(); ++i)
      values[constrained[i]] = (*of_constrained)[static_cast<Eigen::Index>(i)];
  return values;
}

Eigen::VectorXd LoadPath::force_of(const LoadStep* step) const {
  return step != nullptr && step->force.size() > 0
             ? step->force
             : Eigen::VectorXd(Eigen::VectorXd::Zero(balance_.numbering().natural_size()));
}

/// Takes u to the beginning of an increment; `ahead`: increments to the frame, `times`: the length of one in units of
/// the last one's.
void LoadPath::place(Start start, int ahead, double times) {
  const Vec u = balance_.displacement();
  IMIC3D_PETSC(VecCopy(now_.displacement, u));
  if (start == Start::continued) IMIC3D_PETSC(VecAXPY(u, times, now_.change));
  if (start != Start::offered) return;
  // A parabola through the last increment and the frame's end; a straight line where the load does not go on.
  const double m = ahead;
  const bool goes_on = times > 0.0 && times < farthest_continued;
  const double end = goes_on ? 2.0 / (m * (m + 1.0)) : 1.0 / m;
  IMIC3D_PETSC(VecAXPBY(u, end, 1.0 - end, offered_));
  if (goes_on) IMIC3D_PETSC(VecAXPY(u, (m - 1.0) / (m + 1.0) * times, now_.change));
}

/// Where the hourglass moduli have changed the step is solved again, from where it is, with those that it led to. If
/// they carry no equilibrium, those before stand.
Outcome LoadPath::solve(Start start, int& iterations) {
  const Vec u = balance_.displacement();
  auto outcome = newton_.solve(start, accuracy_, derivatives_.reduction(), iterations);
  for (int again = 0; again < renewals && outcome == Outcome::converged &&
                      balance_.assembler().renew_hourglass_moduli() > renewed_modulus;
       ++again) {
    IMIC3D_PETSC(VecCopy(u, found_));
    if (newton_.solve(Start::continued, accuracy_, derivatives_.reduction(), iterations) == Outcome::converged)
      continue;
    balance_.assembler().restore_hourglass_moduli();
    IMIC3D_PETSC(VecCopy(found_, u));
    return newton_.solve(Start::continued, accuracy_, derivatives_.reduction(), iterations);
  }
  return outcome;
}

void LoadPath::differentiate(const LoadStep& step, double target, PathStatus& status) {
  if (derivatives_.size() == 0) return;
  Eigen::MatrixXd d_prescribed = target * step.d_prescribed;
  Eigen::SparseMatrix<double> d_force = target * step.d_force;
  if (previous_ != nullptr) d_prescribed += (1.0 - target) * previous_->d_prescribed;
  if (step.d_bend[0].size() > 0)
    d_prescribed += target * (1.0 - target) * ((1.0 - target) * step.d_bend[0] - target * step.d_bend[1]);
  if (previous_ != nullptr && d_force.size() > 0) d_force += (1.0 - target) * previous_->d_force;
  if (!derivatives_.differentiate(d_prescribed, d_force, status.derivative_corrections))
    throw ConvergenceError(
        fmt::format("no derivative by the parameters at frame {} of the series (time {:.6g}); with "
                    "identify.sensitivities: perturbed none is needed",
                    frame_ + 1, step.time));
}

/// The increment stands, and the next one begins where it ended.
void LoadPath::commit(const Eigen::VectorXd& load) {
  balance_.assembler().commit();
  IMIC3D_PETSC(VecWAXPY(now_.change, -1.0, now_.displacement, balance_.displacement()));
  IMIC3D_PETSC(VecCopy(balance_.displacement(), now_.displacement));
  now_.load = load;
}

}  // namespace imic3d::mechanics
