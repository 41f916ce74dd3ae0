#include "imic3d/imaging/patch_match.hpp"

#include <cmath>
#include <opencv2/imgproc.hpp>

namespace imic3d::imaging {
namespace {

/// Offset of a parabola's top from the middle of three values.
double parabola_top(float before, float middle, float after) {
  const double curvature = static_cast<double>(before) - 2.0 * middle + after;
  return curvature < 0.0 ? 0.5 * (static_cast<double>(before) - after) / curvature : 0.0;
}

}  // namespace

PatchMatch match_patch(const Image& patch, const Image& image, double x, double y, double reach) {
  const double half_width = 0.5 * (patch.width - 1), half_height = 0.5 * (patch.height - 1);
  const int left = std::max(0, static_cast<int>(std::floor(x - half_width - reach)));
  const int top = std::max(0, static_cast<int>(std::floor(y - half_height - reach)));
  const int right = std::min(image.width - 1, static_cast<int>(std::ceil(x + half_width + reach)));
  const int bottom = std::min(image.height - 1, static_cast<int>(std::ceil(y + half_height + reach)));
  if (right - left + 1 < patch.width || bottom - top + 1 < patch.height) return {};
  const cv::Mat whole(image.height, image.width, CV_32F, const_cast<float*>(image.grey.data()));
  const cv::Mat small(patch.height, patch.width, CV_32F, const_cast<float*>(patch.grey.data()));
  cv::Mat score;
  cv::matchTemplate(whole(cv::Rect(left, top, right - left + 1, bottom - top + 1)), small, score, cv::TM_CCOEFF_NORMED);
  double best = -1.0;
  cv::Point at;
  cv::minMaxLoc(score, nullptr, &best, nullptr, &at);
  if (!std::isfinite(best)) return {};
  PatchMatch match{left + at.x + half_width, top + at.y + half_height, best};
  if (at.x > 0 && at.x < score.cols - 1)
    match.x += parabola_top(score.at<float>(at.y, at.x - 1), score.at<float>(at), score.at<float>(at.y, at.x + 1));
  if (at.y > 0 && at.y < score.rows - 1)
    match.y += parabola_top(score.at<float>(at.y - 1, at.x), score.at<float>(at), score.at<float>(at.y + 1, at.x));
  return match;
}

}  // namespace imic3d::imaging
