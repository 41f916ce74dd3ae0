#include "ground.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

namespace imic3d::loop {

namespace {

/// The learned bias is known to a part only (the synthetic images differ from real ones, the finer mesh errs too): what
/// is not known of it joins the noise, for each number of a frame and again for all of them together (and for each
/// further thing that is unknown) a random polynomial of second degree in time. Number by number alone it would cancel
/// over the many numbers that a parameter is found from.
void doubt_bias(const Experiment& experiment, Eigen::MatrixXd& null) {
  const Experiment::Doubt doubt = experiment.doubt();
  if (doubt.each.size() == 0) return;
  const auto& data = experiment.data();
  std::vector<double> clock(experiment.frame_numbers().size());  // of each frame in its test, from -1 to 1
  for (std::size_t t = 0; t < clock.size(); ++t) {
    const auto [first, last] = experiment.test_of(static_cast<int>(t));
    clock[t] = last > first ? 2.0 * (static_cast<int>(t) - first) / (last - first) - 1.0 : 0.0;
  }
  std::vector<Eigen::Index> place(data.size());  // of a number within its frame
  Eigen::Index most = 0;
  for (std::size_t i = 0; i < data.size(); ++i) {
    place[i] = i > 0 && data[i].frame == data[i - 1].frame ? place[i - 1] + 1 : 0;
    most = std::max(most, place[i] + 1);
  }
  std::mt19937_64 random(11);
  std::normal_distribution<double> normal;
  for (auto draw : null.colwise()) {
    Eigen::Matrix<double, 3, Eigen::Dynamic> c(3, most);  // coefficients of Legendre polynomials
    for (double& x : c.reshaped()) x = normal(random);
    Eigen::Matrix<double, 3, Eigen::Dynamic> whole(3, doubt.whole.cols());
    for (double& x : whole.reshaped()) x = normal(random);
    const double size = std::sqrt(1.0 + 1.0 / 3.0 + 0.2);
    for (std::size_t i = 0; i < data.size(); ++i) {
      const double s = clock[static_cast<std::size_t>(data[i].frame)];
      const auto row = static_cast<Eigen::Index>(i);
      const Eigen::Vector3d both =
          (doubt.each[row] * c.col(place[i]) + whole * doubt.whole.row(row).transpose()) / size;
      draw[row] += both[0] + both[1] * s + both[2] * 0.5 * (3.0 * s * s - 1.0);
    }
  }
}

}  // namespace

std::shared_ptr<const Ground> ground_of(Experiment& experiment, const std::vector<double>& values, int asked) {
  auto ground = std::make_shared<Ground>();
  ground->learned = experiment.learned();
  // Some draws say how the numbers of a frame vary together, others what is left of them then: no draw judges itself.
  const int draws = experiment.draws(asked);
  Eigen::MatrixXd null = experiment.noise(values, asked + draws);
  doubt_bias(experiment, null);
  Eigen::MatrixXd of_weight = null.leftCols(asked);
  // Numbers whose noise was estimated from themselves are whitened with that; to weigh them by it once more would be to
  // trust it twice.
  const Eigen::VectorXd freedom = experiment.freedom();
  for (Eigen::Index i = 0; i < freedom.size(); ++i)
    if (std::isfinite(freedom[i])) of_weight.row(i).setZero();
  const auto& data = experiment.data();
  ground->weight = Weight(data, of_weight);
  ground->null = ground->weight(null.rightCols(draws));
  ground->squares = ground->weight(experiment.noise_of_squares(values, null.rightCols(asked)));
  if (std::any_of(data.begin(), data.end(), [](const Datum& d) { return d.channel > 0; }))
    ground->apart = Weight(data, of_weight, 2, true);
  return ground;
}

}  // namespace imic3d::loop
