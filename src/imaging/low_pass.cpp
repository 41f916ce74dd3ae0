#include "imic3d/imaging/low_pass.hpp"

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "imic3d/imaging/bspline.hpp"

namespace imic3d::imaging {

Image low_pass(const Image& image, double width) {
  if (!(width > 0.0)) return image;
  Image result = image;
  const int size = 2 * static_cast<int>(std::ceil(4.0 * width)) + 1;
  const cv::Mat full(image.height, image.width, CV_32F, const_cast<float*>(image.grey.data()));
  cv::Mat smooth(image.height, image.width, CV_32F, result.grey.data());
  cv::GaussianBlur(full, smooth, cv::Size(size, size), width, width, cv::BORDER_REFLECT_101);
  return result;
}

NoiseResponse noise_response(double width) {
  // The response to one bright pixel: its squares are the variances for white noise.
  const int middle = 20 + static_cast<int>(std::ceil(5.0 * width)), size = 2 * middle + 1;
  Image impulse(size, size);
  impulse(middle, middle) = 1.0F;
  const Image smooth = low_pass(impulse, width);
  const BSpline spline(smooth);
  NoiseResponse response{.level = 0.0, .slope = 0.0};
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      response.level += std::pow(smooth(x, y), 2);
      response.slope += std::pow(spline.sample(x, y).slope.x(), 2);
    }
  response.level = std::sqrt(response.level);
  return response;
}

}  // namespace imic3d::imaging
