// The elements of the simulation are too large: a refined run shows it.
#include <cmath>

#include "effects.hpp"

namespace imic3d::loop {

namespace {

class CoarseMesh final : public Effect {
 public:
  [[nodiscard]] Description describe(const Scene&) const override {
    return {.name = "coarse mesh",
            .link = Link::numerics,
            .quantities = {{.name = "mesh_error",
                            .unit = "-",
                            .description = "part of the way to a mesh of half the element size",
                            .step = 1.0,
                            .size = 1.0,
                            .lower = 0.0,
                            .upper = 3.0}},
            .sentence = "the simulation's mesh is too coarse",
            .confused_with = "hole radius, soft or stiff region",
            .separated_by = "one run with specimen.refine one higher"};
  }
  void numerics(Numerics& made) const override { made.refinements = 1; }
  [[nodiscard]] bool changes_simulation(const Scene&) const override { return true; }
};

}  // namespace

std::shared_ptr<const Effect> coarse_mesh() { return std::make_shared<CoarseMesh>(); }

}  // namespace imic3d::loop
