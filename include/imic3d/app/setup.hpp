#pragma once
// From the case file to the objects that the commands work with.

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "imic3d/app/program.hpp"
#include "imic3d/identification/specimen.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/loop/field_experiment.hpp"
#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::app {

/// The declared material: law, values and bounds in the law's order.
struct Material {
  std::shared_ptr<const material::FiniteStrainLaw> law;
  /// bounds narrowed by the case file, units and scales those of the case
  std::vector<ParameterInfo> information;
  std::vector<double> values;
  /// Place of a parameter in the law's order; throws InputError if the law does not have it.
  [[nodiscard]] int index(const std::string& name) const;
};

/// Reads and checks a case file; `sections` must be there; `images`: so must the image files.
[[nodiscard]] io::Case read_case(const CommandOptions& options, std::vector<std::string> sections, bool images,
                                 bool fields = false, bool several = false);

/// The unit of a parameter (`stress`, `1/stress`, `1/time`, …) in the units of the case.
[[nodiscard]] std::string unit_in(std::string unit, const io::Units& units);

[[nodiscard]] Material make_material(const io::Case& test);
/// What the found `values` of the material's parameters, far from the declared ones, let suspect; said in the log, too.
[[nodiscard]] std::vector<std::string> unlikely_values(const io::Case& test, const Material& material,
                                                       const std::vector<double>& values);

/// The declared law extended by everything that it may lack: what is not declared stands at its null value.
struct ExtendedMaterial : Material {
  std::vector<char> declared;  ///< whether a parameter belongs to the declared law
};
[[nodiscard]] ExtendedMaterial make_extended_material(const io::Case& test);
/// The declared law with these effects beside its own.
[[nodiscard]] std::shared_ptr<const material::FiniteStrainLaw> extended_law(const io::Case& test,
                                                                            const std::vector<std::string>& effects,
                                                                            bool in_space = false);

/// Cameras that look at the front, or at the back, as places in Case::cameras.
[[nodiscard]] std::vector<int> cameras_of(const io::Case& test, bool back);

/// The faces that cameras see. Three components where several cameras see the motion through the face, i.e. one of them
/// is perspective, else two: telecentric ones face the specimen. Throws InputError (what plane stress does not know).
[[nodiscard]] std::vector<identification::SeenFace> seen_faces(const io::Case& test);

/// Reads the mesh, refines it, extrudes it if it is 2D and not in plane stress, and finds the ends and the cameras'
/// faces. `all_components`: three on each face, whatever the cameras see. With `change` it is made differently from
/// what the case file says.
[[nodiscard]] identification::Specimen make_specimen(const io::Case& test, bool all_components = false,
                                                     const loop::MeshChange& change = {});

/// Simulations that an iteration of the identification has: side by side, and before them on the first group (the
/// DIC-driven one that gives the forces). With direct sensitivities one after another on all ranks.
struct SimulationTasks {
  int side_by_side = 1, before = 0;
};
[[nodiscard]] SimulationTasks simulation_tasks(const io::Case& test);

/// Throws InputError if the folder of the results could not be created or written. Creates nothing.
void check_output(const io::Case& test, const CommandOptions& options);

/// Creates the folder of the results, begins the log file in it and returns it. Throws InputError if that cannot be
/// done.
[[nodiscard]] std::filesystem::path output_folder(const io::Case& test, const CommandOptions& options,
                                                  const Communicator& world);

}  // namespace imic3d::app
