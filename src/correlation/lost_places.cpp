#include "imic3d/correlation/lost_places.hpp"

#include <algorithm>

#include "imic3d/core/median.hpp"

namespace imic3d::correlation {

namespace {

/// Elements that share a node with each.
std::vector<std::vector<int>> neighbours(const mesh::Mesh& surface) {
  const auto& cells = surface.cells;
  std::vector<std::vector<int>> at_node(static_cast<std::size_t>(surface.nodes.rows())),
      beside(static_cast<std::size_t>(cells.rows()));
  for (int e = 0; e < cells.rows(); ++e)
    for (int i = 0; i < 4; ++i) at_node[static_cast<std::size_t>(cells(e, i))].push_back(e);
  for (const auto& elements : at_node)
    for (const int e : elements)
      beside[static_cast<std::size_t>(e)].insert(beside[static_cast<std::size_t>(e)].end(), elements.begin(),
                                                 elements.end());
  return beside;
}

std::vector<std::vector<int>> patches(const std::vector<std::vector<int>>& beside, std::vector<char> left) {
  std::vector<std::vector<int>> all;
  for (std::size_t first = 0; first < left.size(); ++first) {
    if (std::exchange(left[first], 0) == 0) continue;
    auto& patch = all.emplace_back(1, static_cast<int>(first));
    for (std::size_t k = 0; k < patch.size(); ++k)
      for (const int other : beside[static_cast<std::size_t>(patch[k])])
        if (std::exchange(left[static_cast<std::size_t>(other)], 0) != 0) patch.push_back(other);
  }
  return all;
}

}  // namespace

std::vector<std::vector<int>> patches(const mesh::Mesh& surface, const std::vector<char>& marked) {
  return patches(neighbours(surface), marked);
}

std::vector<char> lost_elements(const Cameras& cameras, const std::vector<DicFrame>& frames) {
  constexpr double beyond = 3.0, doubtful = 1.5;  // of the median
  constexpr std::size_t enough = 16;              // pixels that tell of an element
  const auto elements = static_cast<std::size_t>(cameras.elements());
  const auto beside = neighbours(cameras.surface());
  std::vector<Eigen::VectorXd> variance;
  for (int c = 0; c < cameras.size(); ++c) variance.push_back(variance_of_elements(cameras[c].quadrature()));
  std::vector<std::vector<char>> lost;  // [frames][elements]
  std::vector<char> ever(elements, 0);
  for (const DicFrame& frame : frames) {
    auto& here = lost.emplace_back(elements, 0);
    if (frame.lost) continue;
    for (int c = 0; c < cameras.size(); ++c) {
      const Eigen::VectorXd& rms = frame.cameras[static_cast<std::size_t>(c)].element_rms;
      std::vector<double> seen;
      for (Eigen::Index e = 0; e < rms.size(); ++e)
        if (cameras[c].quadrature().pixels_of(static_cast<int>(e)) > 0) seen.push_back(rms[e]);
      if (seen.empty()) continue;
      const double usual = median(std::move(seen));
      std::vector<char> bad(elements, 0);
      for (std::size_t e = 0; e < elements; ++e)
        bad[e] = cameras[c].quadrature().pixels_of(static_cast<int>(e)) >= enough &&
                         rms[static_cast<Eigen::Index>(e)] > beyond * usual
                     ? 1
                     : 0;
      for (const auto& patch : patches(beside, bad))
        if (std::any_of(patch.begin(), patch.end(),
                        [&](int e) { return rms[e] * rms[e] > variance[static_cast<std::size_t>(c)][e]; }))
          for (const int e : patch)
            for (const int other : beside[static_cast<std::size_t>(e)])
              if (rms[other] > doubtful * usual) here[static_cast<std::size_t>(other)] = 1;
    }
    if (4 * static_cast<std::size_t>(std::count(here.begin(), here.end(), 1)) > elements) here.assign(elements, 0);
    for (std::size_t e = 0; e < elements; ++e) ever[e] = std::max(ever[e], here[e]);
  }
  std::vector<char> left_out(elements, 0);
  for (const auto& patch : patches(beside, ever)) {
    const auto in = std::count_if(lost.begin(), lost.end(), [&](const auto& here) {
      return std::any_of(patch.begin(), patch.end(), [&](int e) { return here[static_cast<std::size_t>(e)] != 0; });
    });
    if (in > 1 && 5 * static_cast<std::size_t>(in) > frames.size())
      for (const int e : patch) left_out[static_cast<std::size_t>(e)] = 1;
  }
  const auto count = static_cast<std::size_t>(std::count(left_out.begin(), left_out.end(), 1));
  if (count == 0 || 4 * count > elements) return {};
  return left_out;
}

}  // namespace imic3d::correlation
