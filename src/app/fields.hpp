#pragma once
// Displacement fields that another program correlated, as the loop takes them.

#include "imic3d/identification/specimen.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/loop/field_experiment.hpp"

namespace imic3d::app {

/// The points of all frames, brought to the nodes of the specimen's face by least squares:
///
///   U_t = argmin sum over points |d - N U|^2 / inflation + w U^T C U,   M = N^T N / inflation + w C,
///
/// C the curvature's energy, w such that only waves shorter than two distances of the points are held by it. What a
/// subset is the mean of, its neighbours share: inflation = max(1, (subset/distance)^2). Points that a frame lacks are
/// left out of all. Throws InputError where the points do not cover the mesh.
[[nodiscard]] loop::FieldData imported_fields(const io::Case& test, const identification::Specimen& specimen);

}  // namespace imic3d::app
