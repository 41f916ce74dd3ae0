#pragma once
// Global finite-element digital image correlation of a series of frames.

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "imic3d/core/groups.hpp"
#include "imic3d/correlation/cameras.hpp"
#include "imic3d/correlation/correlation.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/imaging/low_pass.hpp"

namespace imic3d::correlation {

struct DicOptions {
  /// coarser levels above the image; -1: until the mesh's shorter side is below 100 px
  int pyramid_levels = -1;
  int max_iterations = 50;          ///< at the finest level
  double tolerance = 1e-3;          ///< largest nodal update [px]
  double regularisation = 0.0;      ///< cut-off wavelength of the smoothing at the finest level [length]; 0: none
  double low_pass = 0.0;            ///< standard deviation of the Gaussian that smooths all images, 0: none [px]
  double border = 0.0;              ///< pixels along the mesh's contour that the finest level leaves out [px]
  std::vector<int> cut_nodes = {};  ///< nodes where the specimen goes on beyond the mesh: no border there
  bool brightness = false;          ///< fit gain and offset of every frame together with the displacement
  bool local_brightness = false;    ///< a gain and an offset for each element
  /// M is built anew, with the gradient transported, when an element's deformation gradient has changed by more than
  /// this
  double strain_change = 0.05;
  /// a frame whose grey levels correlate less than this with the reference's is lost
  double lost = 0.5;
  int groups = 0;  ///< groups of ranks over frames; 0: plan_frames
  /// pixels of the reference whose level is 0 there are left out (one camera)
  const imaging::Image* mask = nullptr;
  /// elements whose pixels are left out, in all cameras and frames [elements]; empty: none
  std::vector<char> left_out = {};
};

/// One of the cameras that look at a mesh.
struct View {
  std::shared_ptr<const imaging::Camera> camera;
  imaging::Image reference;
  /// standard deviation [grey level]: the weights of the cameras; all alike unless every view has it
  double noise = 0.0;
  std::string place = "mesh";  ///< what messages call the view
};

/// Noise of the images of one camera.
struct ImageNoise {
  double sigma = 0.0;  ///< [grey level]
  int references = 1;  ///< images averaged to the reference
};

/// What one camera saw of a frame.
struct CameraFrame {
  double rms = 0.0;                 ///< residual [grey level]
  double coefficient = 0.0;         ///< correlation coefficient of f and g(x + u)
  double pixels = 0.0;              ///< pixels in the sums
  double dropped = 0.0;             ///< pixels that left the image
  double gain = 1.0, offset = 0.0;  ///< brightness: f = gain * g + offset
  Eigen::VectorXd element_rms;      ///< [elements, grey level]
};

/// The correlation of one frame. With several cameras the residuals are weighted like the functional (Cameras), the
/// gain and offset are the first camera's.
struct DicFrame {
  Eigen::VectorXd displacement;     ///< [nodes * dofs, length]
  bool converged = false;           ///< the largest nodal update fell below the tolerance
  bool lost = false;                ///< the images do not match: the displacement means nothing
  int iterations = 0;               ///< at the finest level
  double rms = 0.0;                 ///< residual [grey level]
  double coefficient = 0.0;         ///< correlation coefficient of f and g(x + u)
  double pixels = 0.0;              ///< pixels in the sums
  double dropped = 0.0;             ///< pixels that left the image
  double gain = 1.0, offset = 0.0;  ///< brightness: f = gain * g + offset
  Eigen::VectorXd element_rms;      ///< [elements, grey level]
  /// Cameras::epipolar_modes of the images that were found beside the displacement; empty if there are none
  Eigen::VectorXd epipolar;
  std::vector<CameraFrame> cameras;
  /// several cameras: nodes of which some direction continues the neighbours' motion unseen
  int hardly_seen = 0;
};

/// A frame as numbers [unknowns + elements + 10 + cameras * (elements + 6) + epipolar modes], to be sent or kept, and
/// back.
[[nodiscard]] Eigen::VectorXd numbers_of(const DicFrame& frame);
[[nodiscard]] DicFrame frame_of(const Eigen::VectorXd& numbers, Eigen::Index unknowns, Eigen::Index elements,
                                int cameras);

/// What is known of a series in the course of its correlation, the same on every rank.
struct DicSeries {
  /// displacement of the first frames on the coarse levels [unknowns, length]
  std::vector<Eigen::VectorXd> starts;
  std::vector<char> lost;           ///< which of them the coarse levels lost
  std::vector<DicFrame> frames;     ///< the first frames that are done
  std::vector<char> left_out = {};  ///< elements without which they are correlated [elements]; empty: none
  int round = 0;                    ///< how often such elements have been looked for
  /// what the groups of ranks did with their time on the finer levels, in this run
  std::vector<GroupTime> group_times = {};
};

/// How the frames of a series are shared out over ranks (`groups` = 0: as ends first). More ranks make the pass over
/// the mesh's pixels faster, not reading the images and their splines.
[[nodiscard]] GroupPlan plan_frames(int ranks, int frames, double image_pixels, double mesh_pixels, int groups = 0);

/// Gauss-Newton on f - g(x + u) (Eqs 5-9 without the mechanical term) from coarse images to fine ones.
///
/// Modified algorithm: the gradient of the reference stands for that of the deformed image, so that M is factorised
/// once. Where a strain or a rotation is large, grad F is a poor tangent: f(x) = g(x + u) gives grad g = F^-T grad f,
/// and that gradient is used in b, always, and in M, which is built anew (without visiting the pixels) whenever the
/// deformation has changed by `strain_change`. For small strain this is Eqs 8-9.
///
/// Nodes that the white noise of the images moves ten times as much as the median node, as those of a contour of which
/// the border leaves hardly a pixel, continue the motion of their neighbours (curvature energy of their elements
/// alone).
///
/// Coarse levels hold few pixels per element: there the change of the displacement is smoothed over about two elements
/// (curvature energy, free of bias for affine motion); at the finest level only if the user asks for it.
class GlobalDic {
 public:
  using Source = std::function<imaging::Image(int frame)>;
  using SourceOfAll = std::function<imaging::Image(int frame, int camera)>;
  using Done = std::function<void(int frame, const DicFrame&)>;
  using Reached = std::function<void(const DicSeries&)>;

  /// The reference image, the mesh's surface and the camera define the operators of every pyramid level; `place` is
  /// what messages call the mesh. Throws InputError (the mesh does not lie on the image; elements without speckle).
  GlobalDic(const mesh::Mesh& surface, std::shared_ptr<const imaging::Camera> camera, const imaging::Image& reference,
            DicOptions options, const std::string& place);
  GlobalDic(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera, const imaging::Image& reference,
            DicOptions options, const std::string& place);
  /// Several cameras, `dofs_per_node` unknowns a node (2: none can see motion through the plane; 3). Their fields of
  /// view may differ: an element counts with the pixels that each camera sees of it. Throws InputError if an element is
  /// seen by no camera. Along the line of sight of nodes that only one camera sees (or hardly a second), the
  /// displacement continues that of their neighbours (least curvature); a warning says how many nodes these are.
  GlobalDic(const mesh::Mesh& surface, std::vector<View> views, int dofs_per_node, DicOptions options);

  /// The finest level's operators: of all cameras, of one.
  [[nodiscard]] const Cameras& cameras() const { return *levels_.front().cameras; }
  [[nodiscard]] const Correlation& correlation(int camera = 0) const { return cameras()[camera]; }
  [[nodiscard]] const DicOptions& options() const { return options_; }
  /// What is added to M so that motions of the reference that hardly any camera sees continue their neighbours' (least
  /// curvature) [unknowns x unknowns]; empty if all are seen.
  [[nodiscard]] Eigen::SparseMatrix<double> held() const;
  /// The spline of an image as the finest level sees it, smoothed like the reference.
  [[nodiscard]] imaging::BSpline spline(const imaging::Image& image) const;
  /// What unit noise of the images becomes there.
  [[nodiscard]] const imaging::NoiseResponse& noise_response() const { return noise_; }
  /// Smoothed noise is not white: it moves M^-1 b like white noise of this standard deviation, for unit noise. The
  /// covariance of b is that of white noise with the gradient smoothed once more in the place of the gradient.
  [[nodiscard]] double motion_noise(int camera = 0) const { return motion_noise_[static_cast<std::size_t>(camera)]; }
  [[nodiscard]] int levels() const { return static_cast<int>(levels_.size()); }

  /// Correlates a series of images with the reference. The coarse levels follow the series frame by frame, each frame
  /// starting from the ones before or, where they lead astray, from patches found anywhere in the image; the finer
  /// levels then run over groups of ranks side by side. The result is the same on every rank; `done` is called in order
  /// on all, as the frames come. `known` is not done again (but handed to `done`); `reached` is called on every rank
  /// whenever more is known: on the coarse levels after a frame of each rank, then after a frame of each group or, if
  /// that takes less, about every 10 s. Collective over `world`. Throws InputError (an image that cannot be read or has
  /// another size).
  [[nodiscard]] std::vector<DicFrame> run(const Communicator& world, const std::vector<std::filesystem::path>& images,
                                          const Done& done = {}) const;
  /// The same for images from any source: `source(frame)` is called on one rank or another, more than once, and for the
  /// next frame by a thread of its own while one is correlated. At any time a rank holds two frames.
  [[nodiscard]] std::vector<DicFrame> run(const Communicator& world, int frames, const Source& source,
                                          const Done& done = {}) const;
  /// Several cameras: images [camera][frame], or from any source.
  [[nodiscard]] std::vector<DicFrame> run(const Communicator& world,
                                          const std::vector<std::vector<std::filesystem::path>>& images,
                                          const Done& done = {}, DicSeries known = {},
                                          const Reached& reached = {}) const;
  [[nodiscard]] std::vector<DicFrame> run(const Communicator& world, int frames, const SourceOfAll& source,
                                          const Done& done = {}, DicSeries known = {},
                                          const Reached& reached = {}) const;

  /// One image from the displacement `start`, on the levels from `coarsest` down to `finest` (0: the image itself),
  /// split over `group`, collective.
  [[nodiscard]] DicFrame correlate(const imaging::Image& image, const Eigen::VectorXd& start, int coarsest, int finest,
                                   const Communicator& group) const;
  /// The same for one image of each camera.
  [[nodiscard]] DicFrame correlate(std::vector<imaging::Image> images, const Eigen::VectorXd& start, int coarsest,
                                   int finest, const Communicator& group) const;

  /// Standard deviation of each displacement unknown [nodes * dofs, length] for a white noise of `sigma` [grey level]
  /// (before the smoothing, which enters by `motion_noise`)
  /// in every frame and in each of the `references` images that were averaged: sigma^2 (1 + 1/references) M^-1 (Eq.
  /// 14's factor 2 for one reference). M holds the noise of the reference's gradient, the true tangent T = M - V does
  /// not: the covariance is T^-1 M T^-1, here (M - 2 V)^-1, equal to first order in V = sigma^2/references *
  /// gradient_noise(). With smoothing S: H^-1 M H^-1, H = M + S. A fitted brightness is not counted.
  [[nodiscard]] Eigen::VectorXd standard_deviation(double sigma, int references) const;
  /// The same for each camera's own noise: T^-1 B T^-1 with B = sum of w_c^2 sigma_c^2 (1 + 1/references_c) M_c.
  [[nodiscard]] Eigen::VectorXd standard_deviation(const std::vector<ImageNoise>& noise) const;

 private:
  using Factor = Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>;
  struct Level {
    std::vector<imaging::ImageHeader> sizes;   // of the cameras' images
    std::vector<imaging::BSpline> references;  // of the coarsest level only, where patches are cut from it
    std::shared_ptr<Cameras> cameras;
    // weight * curvature energy, and the continuation where the reference is hardly seen
    Eigen::SparseMatrix<double> smoothing;
    Eigen::SparseMatrix<double> chosen;  // the former alone
    // the continuation of nodes that have hardly a pixel of their own; empty if there are none
    Eigen::SparseMatrix<double> of_noisy;
    std::shared_ptr<Factor> factor;  // of M + smoothing, undeformed
  };
  void build(const mesh::Mesh& surface, std::vector<View> views, int dofs_per_node);
  void find_motion_noise(const std::vector<View>& views);
  void solve_level(int level, std::span<const imaging::BSpline> g, const Communicator& group, DicFrame& frame) const;
  [[nodiscard]] DicFrame follow(const std::vector<imaging::Image>& coarse, const std::vector<Eigen::VectorXd>& before,
                                int finest) const;
  [[nodiscard]] std::vector<imaging::BSpline> splines(const std::vector<imaging::Image>& images, int level) const;
  [[nodiscard]] static Eigen::SparseMatrix<double> continuation(const Cameras& cameras, const std::vector<int>& nodes);
  void calm(Level& level, const Eigen::SparseMatrix<double>& M, const Eigen::SparseMatrix<double>& energy);
  void require_sight(const Level& level, const std::vector<View>& views) const;
  void require_speckle(const Level& level, const std::string& place) const;

  DicOptions options_;
  std::vector<Level> levels_;
  imaging::NoiseResponse noise_;
  std::vector<double> motion_noise_;  // [cameras]
  bool continued_ = false;            // nodes of the reference are hardly seen
};

}  // namespace imic3d::correlation
