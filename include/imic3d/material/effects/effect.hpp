#pragma once
// What an effect of material/extended_j2.hpp is: a struct with its name, its parameters and one or two formulas of
// them.
//
// Sizes have a null value at which the effect is absent; shapes say how it acts. The formulas take `p`, the values of
// the effect's own parameters in their order, as numbers or dual numbers. To add one: write its file here, one line
// into effects/list.hpp, and its place in ExtendedJ2.

#include <span>
#include <string>
#include <vector>

#include "imic3d/core/parameter.hpp"
#include "imic3d/material/tensor.hpp"

namespace imic3d::material::effects {}
