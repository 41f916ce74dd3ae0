#include "imic3d/imaging/pyramid.hpp"

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace imic3d::imaging {

Image half_size(const Image& image) {
  const cv::Mat full(image.height, image.width, CV_32F, const_cast<float*>(image.grey.data()));
  cv::Mat half;
  cv::pyrDown(full, half);
  Image result(half.cols, half.rows, image.depth);
  for (int y = 0; y < half.rows; ++y) std::copy_n(half.ptr<float>(y), half.cols, &result(0, y));
  return result;
}

std::vector<Image> half_sizes(const std::vector<Image>& images) {
  std::vector<Image> half;
  for (const Image& image : images) half.push_back(half_size(image));
  return half;
}

}  // namespace imic3d::imaging
