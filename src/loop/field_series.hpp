#pragma once
// What loop::FieldExperiment simulates: series of frames, of one specimen and law each.

#include <algorithm>
#include <list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/core/blocks.hpp"
#include "imic3d/loop/field_experiment.hpp"

namespace imic3d::loop {

/// Law, geometry, numerics and ends of one series.
struct FieldExperiment::Key {
  std::vector<double> specimen;  // values of the effects' parameters that change it; empty: as declared
  Numerics numerics{};
  bool before_test = false;              // an initial strain: the first frame is the specimen at rest
  std::vector<std::string> law_effects;  // beside the declared ones
  bool synthetic = false;                // of a synthetic test: large, few at once
  auto operator<=>(const Key&) const = default;
};

struct FieldExperiment::Simulation {
  std::vector<double> law;
  Key variant;
  Eigen::MatrixXd driving;      // [unknowns x frames]
  std::vector<double> loading;  // values of all effects' parameters, for what is driven beyond the surface
  std::vector<int> free{};      // numbers of the law by which the series is differentiated
  std::vector<Eigen::MatrixXd> directions{};  // and in which `driving` moves
  std::vector<int> uneven{};                  // and shapes of ends that are uneven at depth
  std::vector<Key> sections{};                // and specimens towards whose section it moves
  bool straight = false;                      // identification::Run::straight
};

/// What a series is differentiated by: a number of the law, a change of what drives the ends, a shape in which the ends
/// are uneven at depth, or a change of the section.
struct FieldExperiment::Tangent {
  int parameter = -1;
  Eigen::MatrixXd driving{};
  int uneven = -1;
  std::vector<double> section{};  // values of all parameters, of which those of effects on the section count
};

struct FieldExperiment::Series {
  Eigen::MatrixXd U;  // of the measured faces [unknowns x frames]
  Eigen::VectorXd R;  // [frames]; empty if the model could not follow
  // by the numbers of the law, then in the directions, by uneven ends, by sections
  std::vector<Eigen::MatrixXd> dU;
  std::vector<Eigen::VectorXd> dR;
  identification::Specimen specimen{};  // of a synthetic test, with what its own faces do [unknowns x frames]
  Eigen::MatrixXd surface{};
};

/// The series of a synthetic test: on refined meshes, the finest first; in as many increments on the declared mesh, in
/// `again` times as many, and with ends that go straight from frame to frame; of plane stress also in space, on the
/// declared mesh: thin, which is plane stress by the same elements, and as thick as it is. The first and the last two
/// are driven alike. Empty forces where the model could not follow.
struct FieldExperiment::SyntheticTests {
  std::vector<Series> refined;
  Series few, many, straight, flat, in_space;
};

struct FieldExperiment::Variant {
  identification::Specimen specimen;
  // what drives the ends, from the measured faces; these from its own
  Eigen::SparseMatrix<double> to_variant, from_variant;
  std::unique_ptr<identification::ForwardModel> model;
  bool before_test = false;  // an initial strain: the first frame is the specimen at rest
};

struct FieldExperiment::Groups {
  Groups(const Communicator& world, int groups) : layout(world, 64, groups), halves(world, 2, std::min(groups, 2)) {}
  GroupLayout layout, halves;  // halves: of all ranks, for synthetic tests
  GroupClock clock{layout}, clock_of_halves{halves};
  [[nodiscard]] const GroupLayout& of(const Key& key) const { return key.synthetic ? halves : layout; }
  // This rank's groups', the last used first. Those of synthetic tests by themselves: a rank's half is another group
  // than that of its other series, and all ranks of a group forget the same ones.
  std::list<std::pair<Key, Variant>> variants, synthetic_variants;
};

}  // namespace imic3d::loop
