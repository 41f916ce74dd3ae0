#pragma once
// Global finite-element digital image correlation of a series of frames.

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <filesystem>
#include <functional>
#include <memory>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/correlation/correlation.hpp"

namespace imic3d::correlation {

struct DicOptions {
  int pyramid_levels = -1;        ///< coarser levels above the image; -1: until the shorter side is below 100 px
  int max_iterations = 50;
  double tolerance = 1e-3;        ///< largest nodal update [px]
  double regularisation = 0.0;    ///< cut-off wavelength of the smoothing at the finest level [length]; 0: none
  bool brightness = false;        ///< fit gain and offset per frame
  double large_strain = 0.02;     ///< from here on grad F is carried to the deformed configuration
  int groups = 0;                 ///< groups of ranks over frames; 0: as many as ranks and frames allow
};

/// The correlation of one frame.
struct DicFrame {
  Eigen::VectorXd displacement;  ///< [2 * nodes, length]
  bool converged = false;
  int iterations = 0;            ///< at the finest level
  double rms = 0.0;              ///< residual [grey level]
  double pixels = 0.0;
  Eigen::VectorXd element_rms;   ///< [grey level]
};

class GlobalDic {
 public:
  /// The reference image, the mesh's surface and the camera define the operators of every pyramid level.
  GlobalDic(const mesh::Mesh& surface, const imaging::TelecentricCamera& camera, const imaging::Image& reference,
            DicOptions options, const std::string& place);

  /// The finest level's operators.
  [[nodiscard]] const Correlation& correlation() const { return *levels_.front().correlation; }
  [[nodiscard]] const DicOptions& options() const { return options_; }

  /// Correlates a series of image files with the reference. The coarse levels follow the series frame by frame, each
  /// starting from the frame before; the finer levels then run over groups of ranks side by side. The result is the
  /// same on every rank. Collective over `world`. Throws InputError (an image that cannot be read or has another size).
  [[nodiscard]] std::vector<DicFrame> run(const Communicator& world, const std::vector<std::filesystem::path>& images,
                                          const std::function<void(int, const DicFrame&)>& frame_done = {}) const;

  /// One image from a given start, on all levels from `coarsest` down.
  [[nodiscard]] DicFrame correlate(const imaging::Image& image, const Eigen::VectorXd& start, int coarsest,
                                   int finest, const Communicator& group) const;
  [[nodiscard]] int levels() const { return static_cast<int>(levels_.size()); }

  /// Standard deviation of each displacement unknown [2 * nodes, length] by Eq. 14's M_DIC for a grey-level noise of
  /// `sigma` in a frame and a reference averaged over `references` images: sigma^2 (1 + 1/references) diag(M^-1).
  [[nodiscard]] Eigen::VectorXd standard_deviation(double sigma, int references) const;

 private:
  struct Level {
    imaging::BSpline reference;
    std::shared_ptr<Correlation> correlation;
    Eigen::SparseMatrix<double> M, smoothing;  // smoothing: weight * gradient energy
    std::shared_ptr<Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>> factor;  // of M + smoothing
  };
  void solve_level(int level, const imaging::BSpline& g, const Communicator& group, DicFrame& frame) const;

  DicOptions options_;
  std::vector<Level> levels_;
};

}  // namespace imic3d::correlation
