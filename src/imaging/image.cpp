#include "imic3d/imaging/image.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <climits>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

namespace imic3d::imaging {
namespace {

namespace fs = std::filesystem;

const char* const allowed_file = "a TIFF, PNG or BMP image of 8 or 16 bits per sample";

void require_file(const fs::path& file) {
  std::error_code ignored;
  if (!fs::exists(file, ignored)) throw InputError(file.string(), "no such file", allowed_file);
  if (!fs::is_regular_file(file, ignored)) throw InputError(file.string(), "not a file", allowed_file);
}

// Integers of a file's first bytes and, for TIFF, of its directory, wherever that is.
class Bytes {
 public:
  explicit Bytes(const fs::path& file) : stream_(file, std::ios::binary) {}
  bool big_endian = true;
  [[nodiscard]] std::string text(std::uint64_t position, std::size_t count) {
    std::string bytes(count, '\0');
    stream_.clear();
    stream_.seekg(static_cast<std::streamoff>(position));
    stream_.read(bytes.data(), static_cast<std::streamsize>(count));
    return stream_ ? bytes : std::string{};
  }
  [[nodiscard]] std::optional<std::uint32_t> integer(std::uint64_t position, std::size_t count) {
    const std::string bytes = text(position, count);
    if (bytes.size() != count) return {};
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < count; ++i)
      value = value << 8U | static_cast<unsigned char>(bytes[big_endian ? i : count - 1 - i]);
    return value;
  }

 private:
  std::ifstream stream_;
};

std::optional<ImageHeader> png_header(Bytes& bytes) {
  const auto width = bytes.integer(16, 4), height = bytes.integer(20, 4), depth = bytes.integer(24, 1);
  if (!width || !height || !depth || *width > INT_MAX || *height > INT_MAX) return {};
  // Palettes and depths below 8 are decoded to 8 bits.
  return ImageHeader{static_cast<int>(*width), static_cast<int>(*height), *depth == 16 ? 16 : 8};
}

std::optional<ImageHeader> bmp_header(Bytes& bytes) {
  bytes.big_endian = false;
  const auto width = bytes.integer(18, 4), height = bytes.integer(22, 4);
  if (!width || !height) return {};
  const auto rows = static_cast<int>(*height);  // negative: from the top downwards
  if (*width > INT_MAX || rows == INT_MIN) return {};
  return ImageHeader{static_cast<int>(*width), std::abs(rows), 8};
}

/// `block`: pixels of a strip or tile, which the decoder holds at once; those of a whole image where strips are said to
/// be no shorter.
std::optional<ImageHeader> tiff_header(Bytes& bytes, double& block) {
  const auto directory = bytes.integer(4, 4);
  if (!directory) return {};
  const auto entries = bytes.integer(*directory, 2);
  if (!entries) return {};
  ImageHeader header{0, 0, 1};
  double rows_per_strip = 0.0, tile_width = 0.0, tile_height = 0.0;
  std::set<std::uint32_t> read;
  for (std::uint64_t i = 0; i < *entries; ++i) {
    const std::uint64_t entry = *directory + 2 + 12 * i;
    const auto tag = bytes.integer(entry, 2), type = bytes.integer(entry + 2, 2), count = bytes.integer(entry + 4, 4);
    if (!tag || !type || !count) return {};
    if (!read.insert(*tag).second) return {};  // of a tag that is there twice decoders take either
    double* const of_block = *tag == 278   ? &rows_per_strip
                             : *tag == 322 ? &tile_width
                             : *tag == 323 ? &tile_height
                                           : nullptr;
    if ((*tag < 256 || *tag > 258) && of_block == nullptr) continue;
    const std::size_t size = *type == 3 ? 2 : 4;
    // More than fits into the entry stands elsewhere (bits per sample of a colour file).
    std::uint64_t place = entry + 8;
    if (*count * size > 4) place = bytes.integer(place, 4).value_or(0);
    const auto value = bytes.integer(place, size);
    if (!value) return {};
    if (of_block != nullptr) {
      *of_block = *value < INT_MAX ? *value : 0.0;  // all rows
      continue;
    }
    if (*value > INT_MAX) return {};
    (*tag == 256 ? header.width : *tag == 257 ? header.height : header.depth) = static_cast<int>(*value);
  }
  block = std::max(header.width * rows_per_strip, tile_width * tile_height);
  return header;
}

/// What the file says of itself; nothing if it is none of the allowed formats or its header is broken. `most`: pixels
/// that decoding it takes room for.
std::optional<ImageHeader> declared(const fs::path& file, double& most) {
  double block = 0.0;
  Bytes bytes(file);
  const std::string magic = bytes.text(0, 8);
  std::optional<ImageHeader> header;
  if (magic == "\x89PNG\r\n\x1a\n")
    header = png_header(bytes);
  else if (magic.substr(0, 2) == "BM")
    header = bmp_header(bytes);
  else if (magic.substr(0, 4) == std::string("MM\0*", 4))
    header = tiff_header(bytes, block);
  else if (magic.substr(0, 4) == std::string("II*\0", 4))
    bytes.big_endian = false, header = tiff_header(bytes, block);
  if (header) most = std::max(static_cast<double>(header->width) * header->height, block);
  return header && header->width > 0 && header->height > 0 ? header : std::nullopt;
}

std::string described(const ImageHeader& header) {
  return fmt::format("{} x {} pixels of {} bits", header.width, header.height, header.depth);
}

}  // namespace

Image read_image(const fs::path& file) {
  require_file(file);
  cv::Mat decoded;
  std::string reason;
  // A broken header must not claim the memory: no compression packs more than some thousand pixels into a byte.
  double most = 0.0;
  const auto header = declared(file, most);
  if (header && most > 5000.0 * static_cast<double>(fs::file_size(file)))
    throw InputError(file.string(),
                     fmt::format("{} in {} bytes{}", described(*header), fs::file_size(file),
                                 most > static_cast<double>(header->width) * header->height
                                     ? fmt::format(", in strips or tiles of {:.0f} pixels", most)
                                     : ""),
                     allowed_file);
  try {
    if (header) decoded = cv::imread(file.string(), cv::IMREAD_UNCHANGED | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception& error) {
    reason = error.err.empty() ? "" : fmt::format(" ({})", error.err);
  }
  if (decoded.empty()) throw InputError(file.string(), "a file that cannot be decoded" + reason, allowed_file);
  if (decoded.depth() != CV_8U && decoded.depth() != CV_16U)
    throw InputError(file.string(), fmt::format("samples of type {}", cv::typeToString(decoded.depth())), allowed_file);
  if (decoded.channels() == 2) cv::extractChannel(decoded, decoded, 0);  // grey and alpha
  if (decoded.channels() == 3) cv::cvtColor(decoded, decoded, cv::COLOR_BGR2GRAY);
  if (decoded.channels() == 4) cv::cvtColor(decoded, decoded, cv::COLOR_BGRA2GRAY);
  Image image(decoded.cols, decoded.rows, decoded.depth() == CV_16U ? 16 : 8);
  image.path = file;
  cv::Mat grey(image.height, image.width, CV_32F, image.grey.data());
  decoded.convertTo(grey, CV_32F);
  return image;
}

ImageHeader read_header(const fs::path& file) {
  require_file(file);
  double most = 0.0;
  const auto header = declared(file, most);
  if (!header) throw InputError(file.string(), "a file that cannot be decoded", allowed_file);
  if (header->depth != 8 && header->depth != 16)
    throw InputError(file.string(), fmt::format("{} bits per sample", header->depth), allowed_file);
  return *header;
}

void write_image(const Image& image, const fs::path& file, std::optional<int> depth) {
  const int bits = depth.value_or(image.depth);
  if (bits != 8 && bits != 16) throw InputError(file.string(), fmt::format("a depth of {} bits", bits), "8 or 16 bits");
  if (bits == 16 && file.extension() == ".bmp")
    throw InputError(file.string(), "16 bits in a BMP file", "8 bits, or the extension .tif or .png");
  const cv::Mat grey(image.height, image.width, CV_32F, const_cast<float*>(image.grey.data()));
  cv::Mat rounded;
  grey.convertTo(rounded, bits == 16 ? CV_16U : CV_8U);
  bool written = false;
  std::string reason;
  try {
    written = cv::imwrite(file.string(), rounded);
  } catch (const cv::Exception& error) {
    reason = fmt::format(" ({})", error.err);
  }
  if (!written)
    throw InputError(file.string(), "an image file that cannot be written" + reason,
                     "an existing folder with write permission and the extension .tif, .png or .bmp (8 bits only)");
}

bool of_one_level(const Image& image) {
  return std::all_of(image.grey.begin(), image.grey.end(), [&](float level) { return level == image.grey.front(); });
}

Image average(std::span<const Image> images) {
  if (images.empty()) throw InputError("reference image", "no frames", "at least one frame");
  Image mean = images.front();
  std::vector<double> sum(mean.grey.size(), 0.0);
  for (const Image& image : images) {
    if (image.header() != mean.header())
      throw InputError(image.path.string(), described(image.header()),
                       described(mean.header()) + " like the first image");
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += image.grey[i];
  }
  for (std::size_t i = 0; i < sum.size(); ++i)
    mean.grey[i] = static_cast<float>(sum[i] / static_cast<double>(images.size()));
  return mean;
}

std::vector<Mistake> ImageSequence::check() const {
  std::vector<Mistake> mistakes;
  if (files_.empty()) mistakes.push_back({"images", "no files", "at least one image"});
  for (const fs::path& path : files_) {
    try {
      const ImageHeader header = read_header(path);
      if (!first_) first_ = header;
      if (header != *first_)
        mistakes.push_back({path.string(), described(header), described(*first_) + " like the first image"});
    } catch (const InputError& error) {
      mistakes.insert(mistakes.end(), error.mistakes().begin(), error.mistakes().end());
    }
  }
  return mistakes;
}

Image ImageSequence::read(int frame) const {
  if (frame < 0 || frame >= size())
    throw InputError("images", fmt::format("frame {}", frame), fmt::format("frames 0 to {}", size() - 1));
  Image image = read_image(file(frame));
  if (!first_) first_ = frame == 0 ? image.header() : read_header(file(0));
  if (image.header() != *first_)
    throw InputError(image.path.string(), described(image.header()), described(*first_) + " like the first image");
  return image;
}

Image ImageSequence::reference(std::span<const int> frames) const {
  std::vector<Image> images;
  images.reserve(frames.size());
  for (const int frame : frames) images.push_back(read(frame));
  return average(images);
}

}  // namespace imic3d::imaging
