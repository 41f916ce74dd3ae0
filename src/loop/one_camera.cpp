#include "imic3d/loop/one_camera.hpp"

#include <Eigen/Dense>
#include <cmath>
#include <utility>

#include "imic3d/core/linear.hpp"

namespace imic3d::loop {

Sight::Sight(std::string name, const imaging::Camera& seen_by, const mesh::Mesh& surface,
             const Eigen::Vector2d& image_centre)
    : camera(std::move(name)), pixels(surface.nodes.rows(), 2), slopes(surface.nodes.rows(), 6), centre(image_centre) {
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    const Eigen::Vector3d X = surface.nodes.row(i).transpose();
    pixels.row(i) = seen_by.project(X).transpose();
    Eigen::Map<Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>(slopes.row(i).data()) = seen_by.jacobian(X);
  }
}

double Sight::scale() const { return std::sqrt(0.5 * slopes.squaredNorm() / static_cast<double>(slopes.rows())); }

ImagePlane::ImagePlane(const Sight& sight, const mesh::Mesh& surface, Scene of_face)
    : scale_(sight.scale()), plane_(surface), scene_(std::move(of_face)) {
  plane_.nodes.setZero();
  plane_.nodes.leftCols<2>() = sight.pixels / scale_;
  scene_.surface = &plane_;
  scene_.components = 2;
  scene_.low = plane_.nodes.leftCols<2>().colwise().minCoeff(),
  scene_.high = plane_.nodes.leftCols<2>().colwise().maxCoeff();
  scene_.pixels = scale_ * Eigen::Matrix2d::Identity();
  scene_.axis_of_lens = sight.centre / scale_;
}

Pixels ImagePlane::error(const Effect& effect, Effect::Values values, int t, const Pixels& motion) const {
  const Eigen::VectorXd U = motion.reshaped<Eigen::RowMajor>() / scale_;
  Eigen::VectorXd beyond = Eigen::VectorXd::Zero(U.size());
  effect.see(values, scene_, t, U, beyond);
  return scale_ * Eigen::Map<const Pixels>(beyond.data(), motion.rows(), 2);
}

namespace {

class OfOneCamera final : public Effect {
 public:
  OfOneCamera(std::shared_ptr<const Effect> effect, const std::vector<Sight>& sights, std::size_t camera,
              const mesh::Mesh& surface, const Scene& of_face)
      : effect_(std::move(effect)),
        sight_(sights[camera]),
        plane_(sight_, surface, of_face),
        answer_(surface.nodes.rows(), 6) {
    for (Eigen::Index i = 0; i < answer_.rows(); ++i) {
      Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
      for (const Sight& sight : sights) normal += sight.slope(i).transpose() * sight.slope(i);
      Eigen::Map<Eigen::Matrix<double, 3, 2>>(answer_.row(i).data()) =
          least_squares(normal, sight_.slope(i).transpose());
    }
  }
  [[nodiscard]] Description describe(const Scene&) const override { return effect_->describe(plane_.scene()); }
  [[nodiscard]] bool applies(const Scene&) const override { return effect_->applies(plane_.scene()); }
  [[nodiscard]] bool of_each_camera() const override { return true; }
  void see(Values values, const Scene&, int t, const Eigen::VectorXd& U, Eigen::VectorXd& error) const override {
    Pixels motion(answer_.rows(), 2);
    for (Eigen::Index i = 0; i < motion.rows(); ++i)
      motion.row(i) = (sight_.slope(i) * U.segment<3>(3 * i)).transpose();
    const Pixels beyond = plane_.error(*effect_, values, t, motion);
    for (Eigen::Index i = 0; i < motion.rows(); ++i)
      error.segment<3>(3 * i) +=
          Eigen::Map<const Eigen::Matrix<double, 3, 2>>(answer_.row(i).data()) * beyond.row(i).transpose();
  }

 private:
  std::shared_ptr<const Effect> effect_;
  Sight sight_;
  ImagePlane plane_;
  // d(displacement)/d(pixel) of each node, 3 x 2 column by column [length/px]
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor> answer_;
};

}  // namespace

std::shared_ptr<const Effect> of_one_camera(std::shared_ptr<const Effect> effect, const std::vector<Sight>& sights,
                                            std::size_t camera, const mesh::Mesh& surface, const Scene& of_face) {
  return std::make_shared<OfOneCamera>(std::move(effect), sights, camera, surface, of_face);
}

}  // namespace imic3d::loop
