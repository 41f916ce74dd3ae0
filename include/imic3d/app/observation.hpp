#pragma once
// What the cameras saw: their places, the references, and the correlation of every frame with them, face by face.

#include <memory>
#include <optional>
#include <vector>

#include "imic3d/app/setup.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/identification/forward_model.hpp"
#include "imic3d/identification/gauss_newton.hpp"
#include "imic3d/imaging/camera.hpp"
#include "imic3d/loop/field_experiment.hpp"

namespace imic3d::app {

struct Rig;

/// One face of the specimen and the cameras that look at it.
struct ObservedFace {
  std::shared_ptr<Rig> rig;
  std::shared_ptr<const correlation::GlobalDic> dic;    ///< without the elements that `correlate` found lost
  std::shared_ptr<const correlation::GlobalDic> whole;  ///< with all of them; the same where none is lost
  /// nodes whose motion drives the simulation, ascending; none if none is declared
  std::vector<int> ends;
  /// waves that the displacement on the ends has lost in each frame [length]
  std::vector<double> driving_cut_off;
};

/// The images of a test on the seen faces of its mesh. Displacements are those of all faces (identification::Specimen).
struct Observation {
  std::vector<ObservedFace> faces;  ///< as Specimen::faces
  std::vector<int> places;          ///< frames after the reference, as places in Case::frames
  int references = 1;               ///< images averaged to the reference
  /// grey-level noise of one image of each camera, as Case::cameras [grey level]
  std::vector<double> camera_noise;
  /// of one image; several cameras: 1/noise^2 is the mean of theirs [grey level]
  double noise = 0.0;
  /// from static frames or given; else estimated from the residual of the DIC
  bool noise_is_measured = false;
  /// one per place, after `correlate`; residuals of all faces together
  std::vector<correlation::DicFrame> frames;
  /// after `correlate`: of what cameras of a face see off their epipolar lines
  std::vector<std::string> doubts;
  /// after `correlate`: where the surface shows the reference's speckle no more, which frames could not be correlated
  /// or show no more of an end, and which the mesh has left, in words; empty: none
  std::string left_out;
};

/// Places the cameras on the reference images and sets up the correlation of each face. Throws InputError.
[[nodiscard]] Observation observe(const io::Case& test, const identification::Specimen& specimen);

/// What is said of elements with too few pixels in the mean; empty: they have enough.
[[nodiscard]] std::string small_elements(double pixels);

/// What is doubted of the case, of the cameras' places and of the frames that could not be correlated.
[[nodiscard]] std::vector<std::string> doubts_of(const io::Case& test, const Observation& seen);

/// How far the correlation has come, to be kept and taken up again.
struct CorrelationProgress {
  std::vector<correlation::DicSeries> known = {};  ///< of each face; is not done again
  /// on every rank, as GlobalDic::Reached
  std::function<void(std::size_t face, const correlation::DicSeries&)> reached = {};
};

/// Correlates every frame after the reference; `done` is called on every rank: with one face as the frames come. Where
/// places of the surface are lost (correlation::lost_elements) the series is correlated again without them, and `done`
/// called again. Collective.
void correlate(Observation& observation, const io::Case& test, const Communicator& world,
               const std::function<void(int place, const correlation::DicFrame&)>& done = {},
               CorrelationProgress progress = {});

/// What was seen, to be judged on another mesh of the specimen; its frames are those of the mesh before. Throws
/// InputError (too few pixels).
[[nodiscard]] Observation on_mesh(const Observation& seen, const io::Case& test,
                                  const identification::Specimen& specimen);

/// What a face's nodes move by in the image of one of its cameras beside their displacement, in a frame that was
/// correlated (Cameras::off_epipolar) [nodes x 2, px].
[[nodiscard]] correlation::InImage off_epipolar(const Observation& seen, std::size_t face, int camera, std::size_t t);

/// The residual of pure DIC that noise explains in a camera of a face [grey level].
[[nodiscard]] double residual_of_noise(const Observation& seen, const ObservedFace& face, std::size_t camera);
/// The residual of pure DIC in a frame over that which noise explains, rms of the cameras.
[[nodiscard]] double beyond_noise(const Observation& seen, const correlation::DicFrame& frame);
/// The median of the frames, not less than one: errors that are not noise, such as those of interpolation and of the
/// mesh, move nodes about as much as noise that were larger by this.
[[nodiscard]] double beyond_noise(const Observation& seen);

/// The noise of each frame over that of the median, by what the correlation leaves: a frame out of focus counts as one
/// with as much noise [frames].
[[nodiscard]] Eigen::VectorXd frame_noise(const Observation& seen);

/// What the identification needs: the record of the frames after the reference, and the images. Throws InputError where
/// the force has the sign of the other direction than the loaded end moves in.
[[nodiscard]] identification::Record make_record(Observation& observation, const io::Case& test,
                                                 const identification::Specimen& specimen);
[[nodiscard]] identification::ImageData make_image_data(const Observation& observation, const io::Case& test);

/// When the frame at a place of the case's was taken, and the mean of the reference frames. Where there is no load
/// record the frames' numbers are the clock.
[[nodiscard]] double time_of(const io::Case& test, int place);
[[nodiscard]] double reference_time(const io::Case& test);

/// The waves over which the displacement that drives the ends is smoothed at most, where noise hides what that bends
/// [length]: over four widths of the ends hardly more than an affine motion is left.
[[nodiscard]] double longest_cut_off(const identification::Specimen& specimen);

/// What becomes of a displacement of the surface in the first frames of the record [unknowns x frames, length]
/// before it drives the ends: smoothed, each frame as far as the measured one was.
[[nodiscard]] Eigen::MatrixXd driving_displacement(const Observation& observation, Eigen::MatrixXd displacement);

/// Noise of the displacement that drives the simulation in the frame of median smoothing [unknowns x draws, length].
[[nodiscard]] Eigen::MatrixXd driving_noise(const Observation& observation, int draws = 64);

/// A reading that is off zero by more of its standard deviations is none by chance.
inline constexpr double off_zero = 3.5;
/// The mean of what the load cell reads at rest [frames, force]. Its standard deviation is that of the `noise` that is
/// given, or else of their scatter, which few of them hardly know: as far off zero as Student's t allows by chance is
/// `off_zero` of it. Nothing where neither tells it: of less than three, or of equal ones.
[[nodiscard]] std::optional<loop::FieldData::Reading> reading_at_rest(const Eigen::VectorXd& force,
                                                                      const std::optional<double>& noise);
/// That of the frames of the reference.
[[nodiscard]] std::optional<loop::FieldData::Reading> force_at_rest(const io::Case& test);
/// What is doubted of a load cell that does not read zero at rest; empty if it does.
[[nodiscard]] std::string doubt_of_zero(const std::optional<loop::FieldData::Reading>& at_rest, const io::Case& test);

/// Standard deviation of the load cell [force]: given, else that of the static frames, else 0.1 % of the largest force.
[[nodiscard]] double force_noise(const Observation& observation, const io::Case& test);
/// Standard deviation of the force `at_rest` [readings], of three and more, else a thousandth of the `largest`.
[[nodiscard]] double force_noise(const Eigen::VectorXd& at_rest, double largest);

}  // namespace imic3d::app
