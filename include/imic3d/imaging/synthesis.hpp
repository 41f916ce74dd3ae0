#pragma once
// Virtual images (Sec. 4): a speckled surface, moved by a finite-element displacement, as a camera would record it.

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// Positions in an image, one a row: column, row [px].
using PixelPoints = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
/// Quadrilaterals as node numbers [m x 4].
using Quads = Eigen::Matrix<int, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// The inverse of a finite-element mapping: x + u(x) = X solved for x (Eq. 17), exactly, element by element, for
/// bilinear quadrilaterals. Can be asked by several threads at once.
class InverseMapping {
 public:
  /// Where a point lies: the quad and its parent coordinates in [-1, 1]^2. Kept between calls as a first guess.
  struct Location {
    int quad = -1;
    Eigen::Vector2d parent = Eigen::Vector2d::Zero();
  };

  /// `reference` and `deformed` are the nodes' positions x and X = x + u(x) in the image [n x 2, px]. Throws InputError
  /// if sizes do not fit or a deformed quad is turned over or not convex.
  InverseMapping(const PixelPoints& reference, const PixelPoints& deformed, const Quads& quads);

  /// The same through a camera: `deformed` are the nodes' positions in space [n x 3, length], between them they are
  /// bilinear, and P(X) of them is where the camera sees them; `reference` is any bilinear coordinate of the surface.
  /// Newton's method on P itself, out-of-plane displacement and lens distortion included. `camera` must outlive this.
  /// Throws InputError too if a node is not seen.
  InverseMapping(const Camera& camera, const PixelPoints& reference,
                 const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>& deformed, const Quads& quads);

  /// Finds the quad that X lies in; false if there is none. `at` is tried first.
  [[nodiscard]] bool locate(const Eigen::Vector2d& deformed, Location& at) const;
  /// x of a location.
  [[nodiscard]] Eigen::Vector2d reference(const Location& at) const;
  /// Edges that belong to one quad only, as pairs of deformed positions.
  [[nodiscard]] const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& boundary() const { return boundary_; }

 private:
  /// Position = constant + along xi + along eta + twist xi eta.
  struct Bilinear {
    Eigen::Vector2d constant, xi, eta, twist;
    [[nodiscard]] Eigen::Vector2d operator()(const Eigen::Vector2d& p) const {
      return constant + xi * p.x() + eta * p.y() + twist * (p.x() * p.y());
    }
  };
  /// `margin`: how far a quad's image may reach beyond the box of its corners [px].
  InverseMapping(const PixelPoints& reference, const PixelPoints& deformed, const Quads& quads, double margin);
  [[nodiscard]] bool solve(int quad, const Eigen::Vector2d& deformed, Eigen::Vector2d& parent) const;

  const Camera* camera_ = nullptr;                  // perspective: `space_` through it is the map
  std::vector<Eigen::Matrix<double, 3, 4>> space_;  // constant, along xi, along eta, twist in space

  std::vector<Bilinear> reference_, deformed_;
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> boundary_;
  // Quads whose bounding box reaches a square of the plane: bucket b has members first_[b] … first_[b + 1] - 1.
  Eigen::Vector2d low_ = Eigen::Vector2d::Zero();
  double bucket_ = 1.0;
  int columns_ = 0, rows_ = 0;
  std::vector<int> first_, members_;
};

/// What is painted on a surface, as a function of the position in the reference image [px].
class Texture {
 public:
  virtual ~Texture() = default;
  [[nodiscard]] virtual double grey(const Eigen::Vector2d& x) const = 0;  ///< grey level at a point
  /// True: `grey` is the light at a point, a pixel is its mean over the pixel's area. False: `grey` is already the
  /// mean over a pixel (an image that is interpolated) and is taken at the pixel's centre (Sec. 4).
  [[nodiscard]] virtual bool integrate() const = 0;
};

struct SpeckleOptions {
  double diameter = 4.0;  ///< mean diameter of the disks [px]; they spread by +- 30 %
  double coverage = 0.5;  ///< part of the area that is covered, between 0 and 1
  /// Width over which a disk's edge fades [px]. With sharper edges the image holds frequencies that no interpolation
  /// recovers: at 4 px diameter a cubic B-spline is off by 7.5, 3.7, 1.5 and 0.7 grey levels of 255 (rms) for edges of
  /// 1, 2, 3 and 4 px, which adds to the noise of a correlation.
  double edge = 4.0;
  double paint = 0.75 * 255.0;  ///< grey level between the disks
  double disk = 0.2 * 255.0;    ///< grey level of the disks
  std::uint64_t seed = 1;
};

/// Random disks with smooth edges, placed independently of each other, known as a function: nothing is interpolated.
class Speckle final : public Texture {
 public:
  /// Disks cover the box from `low` to `high` [px]. The same seed gives the same disks on every machine. Throws
  /// InputError (diameter, coverage or edge out of range).
  Speckle(const Eigen::Vector2d& low, const Eigen::Vector2d& high, const SpeckleOptions& options = {});
  [[nodiscard]] double grey(const Eigen::Vector2d& x) const override;
  [[nodiscard]] bool integrate() const override { return true; }

 private:
  struct Disk {
    float x, y, inner, outer;  // from `inner` to `outer` radius it fades
  };
  SpeckleOptions options_;
  Eigen::Vector2d low_;
  double bucket_ = 1.0;
  int columns_ = 0, rows_ = 0;
  std::vector<int> first_;
  std::vector<Disk> disks_;  // by bucket, as often as it reaches buckets
};

/// An image interpolated by cubic B-splines.
class ImageTexture final : public Texture {
 public:
  explicit ImageTexture(const Image& image) : spline_(image) {}
  [[nodiscard]] double grey(const Eigen::Vector2d& x) const override {
    return static_cast<double>(spline_.value(x.x(), x.y()));
  }
  [[nodiscard]] bool integrate() const override { return false; }

 private:
  BSpline spline_;
};

struct SynthesisOptions {
  int width = 1024, height = 1024;  ///< [px]
  int depth = 8;                    ///< bits per pixel: 8 or 16
  /// Points per pixel and direction over which light is averaged: Gauss points inside the specimen, at its edges at
  /// least 8, evenly spread.
  int supersampling = 3;
  double noise = 0.01;     ///< standard deviation of the grey-level noise, of the dynamic (0 to 2^depth - 1)
  std::uint64_t seed = 1;  ///< of the noise
};

/// The image of a surface without noise, grey levels not rounded. `background` is what is seen beside the specimen, in
/// the frame of the image. Rows are shared out over OpenMP threads.
[[nodiscard]] Image render(const InverseMapping& mapping, const Texture& specimen, const Texture& background,
                           const SynthesisOptions& options);

/// Adds white Gaussian noise, drawn anew for each frame, and rounds to the grey levels of the depth. The same seed and
/// frame give the same image, whatever the number of threads.
[[nodiscard]] Image record(const Image& clean, int frame, const SynthesisOptions& options);

/// The image without the specimen: pixels that it covers take the grey level of the nearest one that lies more than
/// `margin` [px] beside it. As it was where there is none.
[[nodiscard]] Image without(const Image& image, const InverseMapping& specimen, int margin);

/// A dark background with a faint texture, for images of `options`' size and depth.
[[nodiscard]] Speckle dark_background(const SynthesisOptions& options);

}  // namespace imic3d::imaging
