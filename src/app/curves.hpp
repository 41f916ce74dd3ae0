#pragma once
// The experiments of a case file as a set of curves, and the identification on them.

#include <vector>

#include "imic3d/app/setup.hpp"
#include "imic3d/identification/curves.hpp"

namespace imic3d::app {

/// Strains become logarithmic, stresses the case's unit; every row has its use and every curve its standard deviation:
/// given, else the scatter of the repetitions, else that of the points. Throws InputError.
[[nodiscard]] std::vector<identification::Curve> make_curves(const io::Case& test);

/// The curves of an experiment.
[[nodiscard]] std::vector<const identification::Curve*> of_group(const std::vector<identification::Curve>& curves,
                                                                 const std::string& group);

/// Whether the stress goes against the strain: most of its changes do, by their products (elastic loading and unloading
/// go together, whatever flow does), or it falls first as E would let it rise.
[[nodiscard]] bool falls_with_strain(const identification::Curve& curve, double E);

/// What records say of themselves that is unlikely: units that were forgotten (the stress first rises with the strain
/// by far more or less than the declared E), no clock under a law that depends on the rate, a bar that broke, a stress
/// that is not zero where the record begins, a strain that jumps once, a largest stress that stands, rows that are
/// written twice. Said in the log, too.
[[nodiscard]] std::vector<std::string> doubts_of_curves(const io::Case& test,
                                                        const std::vector<identification::Curve>& curves);

/// Where the standard deviation of an experiment comes from.
[[nodiscard]] std::string deviation_from(const io::ExperimentCase& experiment);

/// imic3d identify on a case with `experiments` and without cameras. Collective; every rank computes the same, rank 0
/// writes.
void identify_curves(const Communicator& world, const CommandOptions& options, const io::Case& test);

/// What `imic3d check` says of the experiments.
void print_experiments(const io::Case& test);

}  // namespace imic3d::app
