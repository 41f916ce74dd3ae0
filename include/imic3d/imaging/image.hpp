#pragma once
// Grey-level images: reading, writing, and the sequence of frames of one camera.

#include <cstddef>
#include <filesystem>
#include <optional>
#include <span>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::imaging {

/// Size and depth of an image as its file declares them.
struct ImageHeader {
  int width = 0, height = 0;  ///< [px]
  int depth = 0;              ///< bits per sample: 8 or 16
  bool operator==(const ImageHeader&) const = default;
};

/// Grey levels, row by row; the centre of the upper left pixel is (0, 0), x to the right (column), y downwards (row).
struct Image {
  int width = 0, height = 0;   ///< [px]
  int depth = 8;               ///< bits per pixel of the file (8 or 16); grey levels run from 0 to 2^depth - 1
  std::filesystem::path path;  ///< where it was read from; empty if it was computed
  std::vector<float> grey;     ///< [height x width]

  Image() = default;
  Image(int columns, int rows, int bits = 8, float level = 0.0F)
      : width(columns),
        height(rows),
        depth(bits),
        grey(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows), level) {}

  [[nodiscard]] float operator()(int x, int y) const { return grey[index(x, y)]; }
  [[nodiscard]] float& operator()(int x, int y) { return grey[index(x, y)]; }
  [[nodiscard]] float dynamic() const { return depth == 16 ? 65535.0F : 255.0F; }  ///< largest grey level of the depth
  [[nodiscard]] ImageHeader header() const { return {width, height, depth}; }
  [[nodiscard]] std::span<const float> row(int y) const {
    return {grey.data() + index(0, y), static_cast<std::size_t>(width)};
  }

 private:
  [[nodiscard]] std::size_t index(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  }
};

/// Reads a TIFF, PNG or BMP file of 8 or 16 bits. A colour file becomes 0.299 R + 0.587 G + 0.114 B (OpenCV's weights),
/// an alpha channel is ignored, an orientation tag too. Up to 2^30 pixels: OpenCV's limit, which the environment
/// variable OPENCV_IO_MAX_IMAGE_PIXELS raises. Throws InputError (missing, unreadable, other depth).
[[nodiscard]] Image read_image(const std::filesystem::path& file);

/// Size and depth without decoding the pixels. Throws InputError.
[[nodiscard]] ImageHeader read_header(const std::filesystem::path& file);

/// Writes grey levels rounded to the nearest integer and clipped to the depth (8 or 16, the image's own if not given);
/// the format is the extension's (.tif, .png, .bmp). Throws InputError (depth, folder that cannot be written to).
void write_image(const Image& image, const std::filesystem::path& file, std::optional<int> depth = {});

/// Whether all pixels have the same grey level: no picture.
[[nodiscard]] bool of_one_level(const Image& image);

/// Pixel-wise average of images of one size; keeps the depth and the path of the first. Throws InputError.
[[nodiscard]] Image average(std::span<const Image> images);

/// The image files of one camera in the order of the frames.
class ImageSequence {
 public:
  ImageSequence() = default;
  explicit ImageSequence(std::vector<std::filesystem::path> files) : files_(std::move(files)) {}

  [[nodiscard]] int size() const { return static_cast<int>(files_.size()); }
  [[nodiscard]] const std::filesystem::path& file(int frame) const {
    return files_.at(static_cast<std::size_t>(frame));
  }

  /// Everything wrong with the files (missing, unreadable, other size or depth than the first), from their headers
  /// only.
  [[nodiscard]] std::vector<Mistake> check() const;
  /// Reads a frame; throws InputError if it differs in size or depth from the sequence's first.
  [[nodiscard]] Image read(int frame) const;
  /// The reference image: the average of some frames (Sec. 2.2: `f`). Throws InputError.
  [[nodiscard]] Image reference(std::span<const int> frames) const;

 private:
  std::vector<std::filesystem::path> files_;
  mutable std::optional<ImageHeader> first_;
};

}  // namespace imic3d::imaging
