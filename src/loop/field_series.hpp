#pragma once
// What loop::FieldExperiment simulates: series of frames, of one specimen and law each.

#include <list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/loop/field_experiment.hpp"

namespace imic3d::loop {

/// Law, geometry, numerics and ends of one series.
struct FieldExperiment::Key {
  std::vector<double> specimen;          // values of the effects' parameters that change it or the numerics; empty: as declared
  std::vector<std::string> law_effects;  // beside the declared ones
  auto operator<=>(const Key&) const = default;
};

struct FieldExperiment::Simulation {
  std::vector<double> law;
  Key variant;
  Eigen::MatrixXd driving;      // [2n x frames]
  std::vector<double> loading;  // values of all effects' parameters, for what is driven beyond the surface
  std::vector<int> free{};                    // numbers of the law by which the series is differentiated
  std::vector<Eigen::MatrixXd> directions{};  // and in which `driving` moves
};

/// What a series is differentiated by: a number of the law, or a change of what drives the ends.
struct FieldExperiment::Tangent {
  int parameter = -1;
  Eigen::MatrixXd driving{};
};

struct FieldExperiment::Series {
  Eigen::MatrixXd U;  // of the measured surface [2n x frames]
  Eigen::VectorXd R;  // [frames]; empty if the model could not follow
  std::vector<Eigen::MatrixXd> dU;  // by the numbers of the law, then in the directions
  std::vector<Eigen::VectorXd> dR;
};

struct FieldExperiment::Variant {
  identification::Specimen specimen;
  Eigen::SparseMatrix<double> to_variant, from_variant;  // surface nodes, two components
  std::unique_ptr<identification::ForwardModel> model;
  bool before_test = false;  // an initial strain: the first frame is the specimen at rest
};

struct FieldExperiment::Groups {
  GroupLayout layout;
  std::list<std::pair<Key, Variant>> variants;  // this group's, the last used first
};

}  // namespace imic3d::loop
