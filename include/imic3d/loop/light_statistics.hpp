#pragma once
// What pure correlation leaves of the grey levels of one camera, in few numbers of known noise: its light.

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/loop/effect.hpp"

namespace imic3d::loop {

/// What the reference tells of a camera's numbers. Cells are the places of the surface (loop::Places) that it sees. In
/// a cell f' = f - mean, x' and y' count from the cell's middle [length]. Linear numbers: sums over the pixels of 1 r
/// and f' r in each cell, then of x r and y r over all of them, r = f - g(x + u); L = 2 cells + 2.
struct LightOptics {
  std::string camera;
  double noise = 1.0;  ///< standard deviation of one image [grey level]
  int references = 1;  ///< images averaged to the reference
  /// taken off each frame by the correlation (of each element, if local)
  bool gain_and_offset_fitted = false, local = false;
  bool compressed = false;                 ///< its images were (imaging::block_excess)
  std::vector<int> places;                 ///< of each cell, in loop::Places
  std::vector<Eigen::Vector2d> middle;     ///< of their places [cells, length]
  Eigen::Vector2d size;                    ///< of a place [length]
  Eigen::VectorXd pixels, mean, variance;  ///< of f in each cell [cells]
  /// What the correlation leaves of light: a grey level that grows by b, b = sum of c_k B_k with B = {1, f', x', y', f'
  /// x', f' y'} in each cell, changes the linear numbers by -R c. It takes the rest for motion, and motion is that of
  /// all the face's cameras: c has the light of each of them, in their order, and this camera's begins at `own`. R =
  /// A^T B - b_A^T M^-1 w b_B, b_X = N^T grad F X, w the weight of the camera that B is of, A^T B of this one's alone
  /// [L x 6 cells of all].
  Eigen::MatrixXd R;
  Eigen::Index own = 0;
  /// Of each cell: such light adds c^T E c to the mean square there, beyond what 1 and f' explain [6 cells of all,
  /// square].
  std::vector<Eigen::MatrixXd> E;
  /// Gain and offset that the correlation fits, of each frame or element, are neither motion nor left: of the light c
  /// of this camera there remains beside_fitted c [6 cells square].
  Eigen::MatrixXd beside_fitted;
  /// covariance of the linear numbers for an image noise of one in g alone, the correlation's smoothing included [L x
  /// L]
  Eigen::MatrixXd G;
  double level = 1.0;     ///< variance of unit noise in f, smoothed
  double absorbed = 0.0;  ///< share of the noise's square that the correlation takes for motion
  /// of the variance of a mean square: what the reference's noise alone makes [1/(pixels), for unit noise]
  double shared = 0.0;
  [[nodiscard]] Eigen::Index cells() const { return pixels.size(); }
  /// The light c of an offset and of a gain of one, alike in all cells [6 cells x 2].
  [[nodiscard]] Eigen::MatrixXd offset_and_gain() const;
};

/// The numbers of one frame.
struct LightFrame {
  Eigen::VectorXd linear;    ///< [L]
  Eigen::VectorXd squares;   ///< mean square of r in each cell, less what 1 and f' explain [cells]
  Eigen::VectorXd kurtosis;  ///< mean of r^4 over the mean square's square [cells]
  /// variance that unit noise of g has in r: interpolation smooths it, a fitted gain counts [cells]
  Eigen::VectorXd frame_noise;
  Eigen::VectorXd spread;  ///< variance of the mean square for unit noise of Gaussian distribution [cells]
  /// Of an image that was made of f by interpolation: what unit noise of f leaves of the square of r, and of f' r
  /// [cells].
  Eigen::VectorXd echo, echo_linear;
  /// What aliasing of all of f leaves of the square of r, over the variance of f: the mean of sum over x and y of 1 -
  /// cos(2 pi displacement [px]) [cells].
  Eigen::VectorXd aliasing;
  std::vector<Eigen::Vector2d> motion;  ///< mean displacement of the cells [cells, length]
  double saturated = 0.0;               ///< pixels at the largest grey level, or where the record was cut below it
  double pixels = 0.0;
};

/// Numbers of all frames of one camera of one face.
class LightStatistics {
 public:
  /// Of all cameras of a face: `views` are those of the correlation, `noise` as Observation::camera_noise [cameras,
  /// grey level].
  [[nodiscard]] static std::vector<LightStatistics> of_face(const correlation::GlobalDic& dic,
                                                            const std::vector<correlation::View>& views, int references,
                                                            const std::vector<double>& noise, const Scene& scene);

  [[nodiscard]] const LightOptics& optics() const { return optics_; }
  /// Of an image that the correlation has taken to the displacement U [unknowns], `off_epipolar` beside it
  /// (Cameras::off_epipolar).
  [[nodiscard]] LightFrame frame(const imaging::Image& image, const Eigen::VectorXd& U,
                                 const correlation::InImage& off_epipolar = {}) const;

 private:
  /// Sums over pixels: B^T B of each cell, b_B [unknowns x 6 cells], M of each cell [unknowns x unknowns]
  /// and of the rest.
  struct Moments {
    std::vector<Eigen::Matrix<double, 6, 6>> inner;
    Eigen::MatrixXd b;
    std::vector<Eigen::SparseMatrix<double>> M;
  };
  LightStatistics(const correlation::GlobalDic& dic, int camera, int references, double noise, const Scene& scene);
  [[nodiscard]] Moments moments() const;
  /// R, E, G and what is beside what is fitted. `motions`: M^-1 w b of each camera [unknowns x 6 cells of it].
  void find_marks(const Moments& of_this, const std::vector<Eigen::MatrixXd>& motions, const imaging::Image& reference,
                  const Scene& scene);
  /// Of the linear numbers with weights B S, `motion` = M^-1 b of these.
  [[nodiscard]] Eigen::MatrixXd covariance(const Eigen::MatrixXd& S, const Eigen::MatrixXd& motion, int width,
                                           int height) const;
  [[nodiscard]] Eigen::VectorXd slope(int element, std::size_t pixel) const;
  [[nodiscard]] Eigen::Vector<double, 6> basis_at(int element, std::size_t pixel) const;
  void make_cells(const Scene& scene);
  void make_noise();
  [[nodiscard]] float largest_grey(const imaging::Image& image) const;

  const correlation::GlobalDic* dic_;
  int camera_;
  LightOptics optics_;
  Eigen::Vector2d middle_;                             // of the surface
  Eigen::VectorXd in_plane_;                           // of the nodes: x and y [2 nodes]
  std::vector<int> cell_;                              // of each element, -1: none
  std::vector<Eigen::Matrix<double, 2, 3>> jacobian_;  // of the camera at the nodes
  double reach_ = 0.0;                                 // of the noise's squared covariance [px]
  static constexpr int table = 32;                     // parts of a pixel
  // of unit noise, smoothed and interpolated along one axis, at fractions of a pixel [table + 1]
  Eigen::VectorXd variance_;
  // the same of what was interpolated before by the opposite way: variance, covariance with that at a pixel
  Eigen::VectorXd again_, across_;
  // sum over all shifts of the squared covariance of r with itself [table + 1 square]
  Eigen::MatrixXd squared_;
};

}  // namespace imic3d::loop
