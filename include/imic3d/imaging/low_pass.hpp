#pragma once
// Gaussian low-pass of images, and what it makes of their noise.

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// The image smoothed by a Gaussian of standard deviation `width` [px]; unchanged if it is 0. A camera samples details
/// that are finer than two pixels wrongly (aliasing), and interpolation moves these wrongly: a bias of the displacement
/// of some 0.001 px that changes with its fraction of a pixel (Schreier, Braasch & Sutton 2000). Smoothing f and g
/// alike takes it away at the price of a little noise.
[[nodiscard]] Image low_pass(const Image& image, double width);

/// What white noise of unit variance becomes in the spline of a smoothed image.
struct NoiseResponse {
  double level = 1.0;  ///< standard deviation of the grey levels at the pixels
  /// variance of a derivative at the pixels [1/px^2]; 9 (2/sqrt(3) - 1) = 1.392 for width 0
  double slope = 0.0;
};
[[nodiscard]] NoiseResponse noise_response(double width);

}  // namespace imic3d::imaging
