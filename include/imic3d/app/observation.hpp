#pragma once
// What one camera saw: its place, the reference, and the correlation of every frame with it.

#include <memory>
#include <vector>

#include "imic3d/app/setup.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/identification/forward_model.hpp"
#include "imic3d/identification/gauss_newton.hpp"
#include "imic3d/imaging/camera.hpp"

namespace imic3d::app {

/// The images of a test on the surface of its mesh.
struct Observation {
  imaging::TelecentricCamera camera;
  std::unique_ptr<correlation::GlobalDic> dic;
  std::vector<int> places;      ///< frames after the reference, as places in Case::frames
  int references = 1;           ///< images averaged to the reference
  double noise = 0.0;           ///< grey-level noise of one image [grey level]
  bool noise_is_measured = false;  ///< from static frames or given; else estimated from the residual of the DIC
  std::vector<double> driving_cut_off;  ///< waves that the displacement on the ends has lost in each frame [length]
  std::vector<correlation::DicFrame> frames;  ///< one per place, after `correlate`
};

/// Places the mesh on the camera's reference image and sets up the correlation. Throws InputError.
[[nodiscard]] Observation observe(const io::Case& test, const identification::Specimen& specimen);

/// Correlates every frame after the reference; `done` is called on every rank. Collective.
void correlate(Observation& observation, const io::Case& test, const Communicator& world,
               const std::function<void(int place, const correlation::DicFrame&)>& done = {});

/// Pixels [column, row] of the surface's nodes: [nodes x 2] row-major.
[[nodiscard]] std::vector<double> pixels_of_nodes(const Observation& observation, const mesh::Mesh& surface);

/// In-plane [2n] to three components [3n], zero through the thickness.
[[nodiscard]] std::vector<double> three_components(const Eigen::VectorXd& in_plane);

/// What the identification needs: the record of the frames after the reference, and the images.
[[nodiscard]] identification::Record make_record(Observation& observation, const io::Case& test,
                                                 const identification::Specimen& specimen);
[[nodiscard]] identification::ImageData make_image_data(const Observation& observation, const io::Case& test);

/// What becomes of a displacement of the surface in the first frames of the record [2 * surface nodes x frames, length]
/// before it drives the ends: smoothed, each frame as far as the measured one was.
[[nodiscard]] Eigen::MatrixXd driving_displacement(const Observation& observation, Eigen::MatrixXd displacement);

/// Noise of the displacement that drives the simulation in the frame of median smoothing [2 * surface nodes x draws, length].
[[nodiscard]] Eigen::MatrixXd driving_noise(const Observation& observation, int draws = 64);

/// Standard deviation of the load cell [force]: given, else that of the static frames, else 0.1 % of the largest force.
[[nodiscard]] double force_noise(const Observation& observation, const io::Case& test);

}  // namespace imic3d::app
