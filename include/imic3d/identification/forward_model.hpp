#pragma once
// The forward chain of the mechanics: parameters -> equilibrium paths, several at once as concurrent groups of ranks.

#include <Eigen/Core>
#include <array>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "imic3d/core/groups.hpp"
#include "imic3d/identification/image_data.hpp"
#include "imic3d/identification/specimen.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "imic3d/mechanics/equilibrium.hpp"

namespace imic3d::identification {

/// What is measured at the simulated frames, in time order (the reference is not among them).
struct Record {
  std::vector<int> frames;               ///< frame numbers as the user knows them
  Eigen::VectorXd time;                  ///< [frames]
  Eigen::VectorXd force;                 ///< measured resultant [frames, force]
  Eigen::MatrixXd surface_displacement;  ///< DIC, on the seen faces (Specimen) [unknowns x frames, length]
  /// the same, smoothed: prescribed on the ends [unknowns x frames, length]
  Eigen::MatrixXd driving;
  double start_time = 0.0;
};

/// One simulated series, what the observations need of it; the same on every rank of the world.
struct Path {
  int frames = 0;            ///< frames that converged
  Eigen::MatrixXd surface;   ///< displacement of the seen faces [unknowns x frames, length]
  Eigen::VectorXd reaction;  ///< resultant on the loaded end, whole section [frames, force]
  bool limit_point = false;
  std::string message;
  int newton_iterations = 0;
  std::vector<int> increments;  ///< load increments that each frame took
  /// derivatives of `surface` by the run's `free` parameters, then in its `directions`
  std::vector<Eigen::MatrixXd> d_surface{};
  std::vector<Eigen::VectorXd> d_reaction{};  ///< and of `reaction`
};

/// The distribution of the external force over the ends (Sec. 3.4), for a measured force of one.
struct ForceDistribution {
  std::vector<int> dofs;  ///< natural degrees of freedom of the ends
  /// nodal forces [dofs x frames] on the simulated part for a resultant of 1 on the whole section
  Eigen::MatrixXd pattern;
  std::vector<Eigen::MatrixXd> d_pattern{};  ///< its derivatives in the run's `directions`
};

/// A direction in which what drives a specimen moves, or its section, for the path's derivatives.
struct Direction {
  Eigen::MatrixXd prescribed;           ///< displacement [constrained dofs x frames, length]
  Eigen::SparseMatrix<double> force{};  ///< external nodal forces [3 * nodes x frames]; empty: they stay
  /// change of each cell's section (mesh::Mesh::section) over it [cells]; empty: it stays
  Eigen::VectorXd section{};
};

/// One of several simulations that run side by side.
struct Run {
  std::vector<double> parameters;
  const ForceDistribution* forces = nullptr;   ///< Control::force and Control::images
  const Eigen::VectorXd* resultant = nullptr;  ///< of the forces [frames, force]; the record's if not given
  /// displacement of the ends, like Record::driving; the record's if not given
  const Eigen::MatrixXd* driving = nullptr;
  /// added to the prescribed displacement [constrained dofs x frames, length]
  const Eigen::MatrixXd* beyond = nullptr;
  /// parameters by which the path is differentiated directly; the forces stay as they are
  std::vector<int> free{};
  /// by which it is differentiated, too; not under Control::images
  std::vector<Direction> directions{};
  /// whether the ends deform straight from frame to frame, not as `bends` says
  bool straight = false;
  int increments = 0;  ///< load increments between two frames at least; 0: the model's
  mechanics::Accuracy accuracy{};
};

/// A series as it was simulated last, the same on every rank: on it the next one starts.
struct Solution {
  std::vector<double> parameters;
  std::vector<int> free;
  std::vector<Eigen::VectorXd> displacement;                 ///< of each frame [3 * nodes, length]
  std::vector<std::vector<Eigen::VectorXd>> d_displacement;  ///< of each frame, by each free parameter
};
using Solutions = std::array<Solution, 3>;  ///< of run 0 under each Control; without frames where there is none

/// How `tasks` simulations with so many unknowns, after `before` others on the first group, are shared out over ranks
/// (`groups` = 0: as ends first, by an estimate of the part of a simulation that more ranks do not make faster,
/// docs/cluster.md).
[[nodiscard]] GroupPlan plan_simulations(int ranks, Eigen::Index unknowns, int tasks, int before, int groups = 0);

class ForwardModel {
 public:
  /// Run and frame; on all ranks of the group that runs it.
  using FrameSink = std::function<void(int run, int frame, const mechanics::FrameState&)>;

  /// `groups`: number of concurrent groups of ranks (0: plan_simulations for `tasks` tasks after `before`).
  ForwardModel(Communicator world, const Specimen& specimen, std::shared_ptr<const material::FiniteStrainLaw> law,
               Record record, mechanics::EquilibriumOptions options, int tasks, int groups, int before = 0);
  ~ForwardModel();
  ForwardModel(const ForwardModel&) = delete;
  ForwardModel& operator=(const ForwardModel&) = delete;

  /// Under Control::images the pull of `images` is weighed against the forces by alpha (Eq. 16, multiplied by
  /// k_0/(1/alpha - 1)). The normalisations are those of one displacement, a uniform stretch v along the axis:
  /// m_0 = v^T P^T M_DIC P v and k_0 = v^T K v with the elastic K of `parameters`, so that at alpha = 1/2 both terms
  /// have the same curvature for a uniform strain. Must be called before simulate(Control::images, …). Collective over
  /// the world.
  void follow_images(const ImageData& images, double alpha, const std::vector<double>& parameters);

  /// Simulates the first `frames` frames of every run, the runs as concurrent groups. All runs take the same load
  /// increments, so that their differences are derivatives: one that needed other increments than the rest is simulated
  /// again. Each starts its frames, on every group alike, from the last solution of run 0 under the same control, taken
  /// along its derivatives to the new parameters where there are any; if there is none, and under Control::images, from
  /// that of the DIC-driven one. `fields`: whether `sink` is shown stress and plastic strain. Collective over the
  /// world.
  std::vector<Path> simulate(Control control, const std::vector<Run>& runs, int frames, const FrameSink& sink = {},
                             bool fields = true);

  /// Sec. 3.4: the reactions of the DIC-driven simulations `runs`, scaled to a resultant of one. Where the load is so
  /// small that noise makes the ratio meaningless, the pattern of the next loaded frame serves (after the last one,
  /// its). `driven` gets the paths.
  std::vector<ForceDistribution> distribute_forces(const std::vector<Run>& runs, int frames, std::vector<Path>& driven);

  /// Whether Run::free and Run::directions may be given: hex8s elements are not differentiated
  /// (mechanics/one_point.hpp).
  [[nodiscard]] bool differentiable() const {
    return specimen_.volume.integration != mesh::Integration::one_point_stabilised;
  }

  /// Where the next simulation under each Control starts, and how a model is put there again. What a simulation gives
  /// depends on it: from elsewhere a frame may need other increments.
  [[nodiscard]] const Solutions& solutions() const;
  void start_from(Solutions solutions);

  [[nodiscard]] const Record& record() const { return record_; }
  [[nodiscard]] const Specimen& specimen() const { return specimen_; }
  [[nodiscard]] int groups() const;
  /// load increments between two frames, of runs that name no other number
  [[nodiscard]] int increments() const;
  /// What the groups did with their time so far. Collective over the world.
  [[nodiscard]] std::vector<GroupTime> group_times() const;
  /// What all simulations took so far, those of all groups together. Collective over the world.
  [[nodiscard]] mechanics::Work work() const;

 private:
  struct Implementation;
  const Specimen& specimen_;
  Record record_;
  std::unique_ptr<Implementation> impl_;
};

}  // namespace imic3d::identification
