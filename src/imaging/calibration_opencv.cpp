#include "calibration_opencv.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <fstream>
#include <iterator>
#include <opencv2/core.hpp>

#include "imic3d/core/error.hpp"

namespace imic3d::imaging {

namespace {

namespace fs = std::filesystem;

/// cv::FileStorage of a file's text. OpenCV says what is wrong on stderr too, which is kept quiet meanwhile.
cv::FileStorage opened(const fs::path& file, const std::string& text) {
  const auto quiet = [](int, const char*, const char*, const char*, int, void*) { return 0; };
  cv::redirectError(quiet);
  cv::FileStorage storage;
  std::string said;
  try {
    storage.open(text, cv::FileStorage::READ | cv::FileStorage::MEMORY);
  } catch (const cv::Exception& exception) {
    said = exception.err;
  }
  cv::redirectError(nullptr);
  if (!said.empty() || !storage.isOpened())
    throw InputError(file.string(), said.empty() ? "cannot be parsed" : said, "a file of cv::FileStorage");
  return storage;
}

class Node {
 public:
  Node(std::string place, const cv::FileNode& node) : place_(std::move(place)), node_(node) {}

  [[nodiscard]] bool has(const std::string& key) const { return node_.isMap() && !node_[key].empty(); }
  [[nodiscard]] Node operator[](const std::string& key) const {
    if (!has(key)) throw InputError(place_ + " " + key, "not given", "a value");
    return {place_ + " " + key, node_[key]};
  }
  [[nodiscard]] int integer(const std::string& key) const {
    if (!has(key)) return 0;
    if (!node_[key].isInt()) throw InputError(place_ + " " + key, "not an integer", "an integer [px]");
    return static_cast<int>(node_[key]);
  }
  [[nodiscard]] std::string text(const std::string& key, const std::string& otherwise) const {
    return has(key) && node_[key].isString() ? static_cast<std::string>(node_[key]) : otherwise;
  }
  /// rows, columns: 0 if any number of them will do.
  [[nodiscard]] Eigen::MatrixXd matrix(int rows, int columns) const {
    cv::Mat read;
    try {
      if (node_.isMap()) node_ >> read;
    } catch (const cv::Exception&) {
    }
    if (read.empty() || read.channels() != 1 || (rows > 0 && read.rows != rows) ||
        (columns > 0 && read.cols != columns))
      throw InputError(
          place_, read.empty() ? "not a matrix" : fmt::format("{} x {} numbers", read.rows, read.cols),
          (rows > 0 && columns > 0 ? fmt::format("{} x {} numbers", rows, columns) : "a matrix") +
              (rows == 3 && columns == 3 && read.total() == 3 ? ", which cv::Rodrigues makes of a rotation vector"
                                                              : ""));
    read.convertTo(read, CV_64F);
    Eigen::MatrixXd values(read.rows, read.cols);
    for (int i = 0; i < read.rows; ++i)
      for (int j = 0; j < read.cols; ++j) values(i, j) = read.at<double>(i, j);
    return values;
  }
  [[nodiscard]] const std::string& place() const { return place_; }
  [[nodiscard]] const cv::FileNode& node() const { return node_; }

 private:
  std::string place_;
  cv::FileNode node_;
};

Intrinsics intrinsics(const Node& in, const std::string& matrix_key, const std::string& distortion_key) {
  const Node matrix = in[matrix_key], distortion = in[distortion_key];
  const Eigen::MatrixXd K = matrix.matrix(3, 3), D = distortion.matrix(0, 0);
  if (K(1, 0) != 0.0 || K(2, 0) != 0.0 || K(2, 1) != 0.0 || K(2, 2) != 1.0)
    throw InputError(matrix.place(), "not a camera matrix", "fx skew cx, 0 fy cy, 0 0 1");
  Intrinsics lens{.fx = K(0, 0), .fy = K(1, 1), .cx = K(0, 2), .cy = K(1, 2), .skew = K(0, 1)};
  const auto count = D.size();
  if (std::min(D.rows(), D.cols()) != 1 || (count != 4 && count != 5 && count != 8 && count != 12 && count != 14))
    throw InputError(distortion.place(), fmt::format("{} x {} numbers", D.rows(), D.cols()),
                     "4, 5, 8, 12 or 14 numbers: k1 k2 p1 p2 k3 k4 ...");
  for (Eigen::Index k = 0; k < count; ++k) {
    const double value = D.reshaped()[k];
    if (k < 12)
      lens.distortion[static_cast<std::size_t>(k)] = value;
    else if (value != 0.0)
      throw InputError(distortion.place(), "a tilted sensor", "tau_x and tau_y zero: it is not modelled");
  }
  return lens;
}

Pose pose(const Node& in, const std::string& rotation_key, const std::string& translation_key) {
  const Node rotation = in[rotation_key], translation = in[translation_key];
  Pose found{rotation.matrix(3, 3), Eigen::Vector3d::Zero()};
  const Eigen::MatrixXd T = translation.matrix(0, 0);
  if (T.size() != 3)
    throw InputError(translation.place(), fmt::format("{} x {} numbers", T.rows(), T.cols()), "3 numbers");
  found.translation = T.reshaped();
  return found;
}

/// R and T of the stereo sample stand in a second file, `extrinsics` with the same ending.
Pose second_camera(const fs::path& file, const Node& root) {
  if (root.has("R") && root.has("T")) return pose(root, "R", "T");
  const fs::path other = file.parent_path() / ("extrinsics" + file.extension().string());
  std::ifstream stream(other, std::ios::binary);
  if (!stream)
    throw InputError(file.string() + " R", "not given, and no " + other.filename().string() + " beside it",
                     "R and T of the second camera");
  const auto storage = opened(other, std::string((std::istreambuf_iterator<char>(stream)), {}));
  const Node there(other.string(), storage.root());
  return pose(there, "R", "T");
}

}  // namespace

std::vector<CalibratedCamera> read_opencv_calibration(const fs::path& file, const std::string& text) {
  const auto storage = opened(file, text);
  const Node root(file.string(), storage.root());
  std::vector<CalibratedCamera> cameras;
  if (root.has("cameras")) {
    const auto list = root["cameras"].node();
    if (!list.isSeq()) throw InputError(root["cameras"].place(), "not a list", "a list of cameras");
    for (std::size_t i = 0; i < list.size(); ++i) {
      const Node node(fmt::format("{} cameras[{}]", file.string(), i), list[static_cast<int>(i)]);
      CalibratedCamera camera{.name = node.text("name", fmt::format("camera {}", i)),
                              .width = node.integer("image_width"),
                              .height = node.integer("image_height"),
                              .intrinsics = intrinsics(node, "camera_matrix", "distortion_coefficients"),
                              .pose = pose(node, "rotation", "translation"),
                              .covariance = {}};
      if (node.has("covariance"))
        camera.covariance = node["covariance"].matrix(camera_numbers, camera_numbers * static_cast<int>(list.size()));
      check_camera(node.place(), camera);
      cameras.push_back(camera);
    }
  } else if (root.has("M1")) {
    cameras.resize(2);
    for (int i = 0; i < 2; ++i) {
      auto& camera = cameras[static_cast<std::size_t>(i)];
      camera.name = fmt::format("camera {}", i);
      camera.width = root.integer("image_width"), camera.height = root.integer("image_height");
      camera.intrinsics = intrinsics(root, fmt::format("M{}", i + 1), fmt::format("D{}", i + 1));
    }
    cameras[1].pose = second_camera(file, root);
    for (const auto& camera : cameras) check_camera(file.string() + " " + camera.name, camera);
  } else if (root.has("camera_matrix")) {
    cameras.push_back({.name = "camera 0",
                       .width = root.integer("image_width"),
                       .height = root.integer("image_height"),
                       .intrinsics = intrinsics(root, "camera_matrix", "distortion_coefficients"),
                       .pose = {},
                       .covariance = {}});
    check_camera(file.string(), cameras[0]);
  } else {
    throw InputError(file.string(), "no camera",
                     "cameras (a list), M1 D1 M2 D2 R T, or camera_matrix and distortion_coefficients");
  }
  return cameras;
}

void write_calibration(const fs::path& file, const std::vector<CalibratedCamera>& cameras,
                       const std::string& length_unit) {
  const auto mat = [](const Eigen::MatrixXd& values) {
    cv::Mat_<double> m(static_cast<int>(values.rows()), static_cast<int>(values.cols()));
    for (int i = 0; i < m.rows; ++i)
      for (int j = 0; j < m.cols; ++j) m(i, j) = values(i, j);
    return m;
  };
  cv::FileStorage storage(".yaml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY | cv::FileStorage::FORMAT_YAML);
  storage << "length_unit" << length_unit << "cameras"
          << "[";
  for (const auto& camera : cameras) {
    const auto& lens = camera.intrinsics;
    const Eigen::Matrix3d K{{lens.fx, lens.skew, lens.cx}, {0.0, lens.fy, lens.cy}, {0.0, 0.0, 1.0}};
    storage << "{"
            << "name" << camera.name << "image_width" << camera.width << "image_height" << camera.height
            << "camera_matrix" << mat(K) << "distortion_coefficients"
            << mat(Eigen::Map<const Eigen::RowVectorXd>(lens.distortion.data(), 12)) << "rotation"
            << mat(camera.pose.rotation) << "translation" << mat(camera.pose.translation);
    if (camera.covariance.size() > 0) storage << "covariance" << mat(camera.covariance);
    storage << "}";
  }
  storage << "]";
  std::ofstream stream(file, std::ios::binary);
  stream << storage.releaseAndGetString();
  if (!stream.flush()) throw InputError(file.string(), "cannot be written", "a writable folder");
}

}  // namespace imic3d::imaging
