#pragma once
// The light of a test: what pure correlation leaves of the grey levels, seen as an experiment of its own.

#include <functional>
#include <memory>

#include "imic3d/loop/field_experiment.hpp"
#include "imic3d/loop/light_statistics.hpp"

namespace imic3d::loop {

struct LightCamera {
  LightOptics optics;
  Scene scene;  ///< of its face
  std::vector<LightFrame> frames;
  int face = 0;  ///< its cameras are correlated together, and take light for one motion
};

/// The numbers of every frame and camera: the linear ones (offset and gain of each cell, gradient of all), whitened;
/// the mean square of each cell over what noise predicts, its constant level unknown to a tenth, its course to 3 % (in
/// the null); the light of each camera known to 1e-4 over time (in the null); the saturated pixels, a ten-thousandth of
/// them allowed. The reference's noise, common to all frames, is whitened over time. Each is then z -> 10 asinh(z/10):
/// what lies beyond ten standard deviations is judged by its ratio to the model's, as no model of light is right to
/// better than a tenth. Where there are several cameras each has some effects for itself, too
/// (Effect::of_one_of_several). Free is the noise of each camera. What the correlation has fitted (gain and offset of a
/// frame, of each element) is no data.
class LightExperiment final : public Experiment {
 public:
  /// What the statistics would be of images of the declared model's motion that were made of the reference
  /// [cameras][frames]; empty if there are none.
  using Synthetic = std::function<std::vector<std::vector<LightFrame>>()>;

  /// `held_out`: places of the frames that are never fitted. Throws InputError: a declared effect beyond its bounds.
  LightExperiment(std::vector<LightCamera> cameras, std::vector<int> frames, std::vector<int> held_out,
                  const std::vector<DeclaredEffect>& declared = {}, Synthetic synthetic = {},
                  const std::function<std::string(std::string)>& unit = {});

  [[nodiscard]] const std::vector<Parameter>& parameters() const override { return parameters_; }
  [[nodiscard]] const std::vector<Candidate>& candidates() const override { return candidates_; }
  [[nodiscard]] const std::vector<Datum>& data() const override { return data_; }
  [[nodiscard]] std::vector<int> frame_numbers() const override { return frames_; }
  [[nodiscard]] std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override;
  void learn_bias(const std::vector<double>& values) override;
  [[nodiscard]] Doubt doubt() const override;
  [[nodiscard]] Eigen::MatrixXd noise(const std::vector<double>& values, int draws) override;

  [[nodiscard]] const std::vector<LightCamera>& cameras() const { return cameras_; }
  /// The measured numbers in standard deviations, before anything is predicted [N]: under the null without a noise of f
  /// they are N(0, 1).
  [[nodiscard]] const Eigen::VectorXd& measured() const { return z_; }
  /// Whether a camera has images that were compressed: what that leaves looks like a noise level or aliasing, which are
  /// no candidates then.
  [[nodiscard]] bool images_compressed() const;
  /// The rows of a cell: those of its offset and gain where they are data, then that of its mean square. `frame`:
  /// place.
  [[nodiscard]] std::vector<Eigen::Index> rows_of(std::size_t camera, Eigen::Index cell, int frame) const;
  /// Standard deviation of the noise of each image over the camera's, by the median mean square of its places less what
  /// is learned of what is no light: what leaves so much of the grey levels, be it noise or what pixels do not resolve,
  /// moves the correlation as much [cameras x frames].
  [[nodiscard]] Eigen::MatrixXd frame_noise() const;
  /// Share of the linear numbers' square beyond noise that a gain and an offset of each frame (with `gradient`: and a
  /// linear growth of the gain over the surface) would take away; 0 where nothing is beyond it, or they are fitted.
  [[nodiscard]] double share_of_gain_and_offset(bool gradient = false) const;

 private:
  struct Whitening;
  /// What a model makes of a camera, frame by frame.
  struct Changes {
    Eigen::MatrixXd grows;  // of the grey levels in B (LightOptics::R) [6 cells x frames]
    Eigen::MatrixXd sums;   // of the linear numbers, beside those of `grows` [L x frames]
    // of the mean squares, beside those of `grows`, over the expected ones [cells x frames]
    Eigen::MatrixXd squares;
    Eigen::VectorXd saturated;  // root of the pixels' count [frames]
  };
  [[nodiscard]] Changes changes_of(std::size_t camera, const std::vector<double>& values) const;
  [[nodiscard]] Eigen::Index linear(std::size_t camera) const {
    return cameras_[camera].optics.local ? 0 : 2 * cameras_[camera].optics.cells() + 2;
  }
  [[nodiscard]] Eigen::Index numbers(std::size_t camera) const {
    return linear(camera) + cameras_[camera].optics.cells() + 1;
  }
  [[nodiscard]] Eigen::VectorXd predicted(const std::vector<double>& values) const;  // z [N]
  /// Numbers of a camera [numbers x frames] in standard deviations, put into their rows of z.
  void put(std::size_t camera, const Eigen::MatrixXd& linear, const Eigen::MatrixXd& squares,
           const Eigen::VectorXd& saturated, Eigen::VectorXd& z) const;
  void make_whitening();
  [[nodiscard]] double plain_onset() const;

  std::vector<LightCamera> cameras_;
  std::vector<int> frames_, held_out_;
  Synthetic synthetic_;
  std::vector<std::shared_ptr<const Effect>> effects_;
  std::vector<std::size_t> first_;  // parameter of each effect
  std::vector<int> camera_of_;      // that has it for itself, -1: all
  std::vector<Parameter> parameters_;
  std::vector<Candidate> candidates_;
  std::vector<Datum> data_;
  std::vector<std::shared_ptr<const Whitening>> whitening_;  // of each camera
  Eigen::VectorXd z_, bias_;                                 // measured; what is learned of what is no light [N]
  // of each camera, over the expected ones [cells x frames]; empty before
  std::vector<Eigen::MatrixXd> learned_squares_;
};

}  // namespace imic3d::loop
