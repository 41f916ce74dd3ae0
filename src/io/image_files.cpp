#include "image_files.hpp"

#include <fmt/format.h>
#include <glob.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <climits>
#include <cstdint>
#include <fstream>

#include "imic3d/core/error.hpp"

namespace imic3d::io {

namespace {

bool is_digit(char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; }

/// Reads integers of a file at given places in either byte order.
class Bytes {
 public:
  explicit Bytes(const std::filesystem::path& file) : file_(file), stream_(file, std::ios::binary) {
    std::error_code error;
    if (!std::filesystem::is_regular_file(file, error)) throw InputError(file.string(), "no such file", "an image");
    if (!stream_) throw InputError(file.string(), "cannot be read", "an image");
    size_ = std::filesystem::file_size(file, error);
  }

  std::uint64_t number(std::uint64_t at, int bytes, bool big_endian) {
    std::array<unsigned char, 8> buffer{};
    stream_.seekg(static_cast<std::streamoff>(at));
    if (!stream_.read(reinterpret_cast<char*>(buffer.data()), bytes)) incomplete();
    std::uint64_t value = 0;
    for (int i = 0; i < bytes; ++i)
      value = value << 8 | buffer[static_cast<std::size_t>(big_endian ? i : bytes - 1 - i)];
    return value;
  }

  [[nodiscard]] std::uint64_t size() const { return size_; }
  [[noreturn]] void incomplete() const { throw InputError(file_.string(), "an incomplete file", "a whole image"); }
  [[noreturn]] void unknown(const std::string& what = "not an image") const {
    throw InputError(file_.string(), what, "a PNG, TIFF or BMP image");
  }

 private:
  std::filesystem::path file_;
  std::ifstream stream_;
  std::uint64_t size_ = 0;
};

/// A size in pixels; no format means more than 2^31 - 1.
int size_of(std::uint64_t value, const Bytes& bytes) {
  if (value == 0 || value > INT_MAX) bytes.incomplete();
  return static_cast<int>(value);
}

ImageHeader read_png(Bytes& bytes) {
  constexpr std::uint64_t iend = 0x49454e44;
  ImageHeader header;
  header.columns = size_of(bytes.number(16, 4, true), bytes);
  header.rows = size_of(bytes.number(20, 4, true), bytes);
  header.depth = static_cast<int>(bytes.number(24, 1, true));
  const auto colour = bytes.number(25, 1, true);
  header.channels = colour == 2 ? 3 : colour == 6 ? 4 : colour == 4 ? 2 : 1;
  // Walk the chunks to the last: a file that was cut has none.
  for (std::uint64_t at = 8; at + 12 <= bytes.size(); at += 12 + bytes.number(at, 4, true))
    if (bytes.number(at + 4, 4, true) == iend) return header;
  bytes.incomplete();
}

ImageHeader read_bmp(Bytes& bytes) {
  if (bytes.number(2, 4, false) > bytes.size()) bytes.incomplete();
  ImageHeader header;
  const auto size = [&](std::uint64_t at) {  // negative: from the top downwards
    const auto value = static_cast<std::int32_t>(bytes.number(at, 4, false));
    return size_of(static_cast<std::uint64_t>(std::abs(static_cast<std::int64_t>(value))), bytes);
  };
  header.columns = size(18);
  header.rows = size(22);
  const int bits = static_cast<int>(bytes.number(28, 2, false));
  header.depth = 8;
  header.channels = bits <= 8 ? 1 : bits / 8;
  return header;
}

/// Classic TIFF: tags of the first directory (TIFF 6.0, section 2).
ImageHeader read_tiff(Bytes& bytes, bool big_endian) {
  const auto directory = bytes.number(4, 4, big_endian);
  const auto entries = bytes.number(directory, 2, big_endian);
  if (directory + 2 + 12 * entries + 4 > bytes.size()) bytes.incomplete();
  ImageHeader header;
  header.depth = 1;
  std::uint64_t offsets = 0, counts = 0, strips = 0;
  int offset_bytes = 4, count_bytes = 4;
  for (std::uint64_t i = 0; i < entries; ++i) {
    const auto entry = directory + 2 + 12 * i;
    const auto tag = bytes.number(entry, 2, big_endian);
    const int width = bytes.number(entry + 2, 2, big_endian) == 3 ? 2 : 4;  // SHORT or LONG
    const auto count = bytes.number(entry + 4, 4, big_endian);
    const auto values =
        count * static_cast<std::uint64_t>(width) <= 4 ? entry + 8 : bytes.number(entry + 8, 4, big_endian);
    switch (tag) {
      case 256: header.columns = size_of(bytes.number(values, width, big_endian), bytes); break;
      case 257: header.rows = size_of(bytes.number(values, width, big_endian), bytes); break;
      case 258: header.depth = static_cast<int>(bytes.number(values, width, big_endian)); break;
      case 277: header.channels = static_cast<int>(bytes.number(values, width, big_endian)); break;
      case 273:
      case 324: offsets = values, offset_bytes = width, strips = count; break;  // strips or tiles
      case 279:
      case 325: counts = values, count_bytes = width; break;
      default: break;
    }
  }
  if (offsets == 0 || header.columns == 0 || header.rows == 0 || strips > bytes.size()) bytes.incomplete();
  for (std::uint64_t i = 0; counts != 0 && i < strips; ++i) {
    const auto start = bytes.number(offsets + i * static_cast<std::uint64_t>(offset_bytes), offset_bytes, big_endian);
    const auto length = bytes.number(counts + i * static_cast<std::uint64_t>(count_bytes), count_bytes, big_endian);
    if (start + length > bytes.size()) bytes.incomplete();
  }
  return header;
}

}  // namespace

bool natural_less(const std::string& a, const std::string& b) {
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      const auto end_of_number = [](const std::string& text, std::size_t at) {
        while (at < text.size() && is_digit(text[at])) ++at;
        return at;
      };
      const auto value = [&](const std::string& text, std::size_t at, std::size_t end) {
        while (at + 1 < end && text[at] == '0') ++at;
        return text.substr(at, end - at);
      };
      const auto end_i = end_of_number(a, i), end_j = end_of_number(b, j);
      const auto number_a = value(a, i, end_i), number_b = value(b, j, end_j);
      if (number_a.size() != number_b.size()) return number_a.size() < number_b.size();
      if (number_a != number_b) return number_a < number_b;
      i = end_i;
      j = end_j;
    } else {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
    }
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;
}

std::vector<std::filesystem::path> matching_files(const std::filesystem::path& folder, const std::string& pattern) {
  std::string whole;
  if (!std::filesystem::path(pattern).is_absolute() && !folder.empty()) {
    for (char c : folder.string() + "/") {
      if (std::string("*?[]\\").find(c) != std::string::npos) whole += '\\';
      whole += c;
    }
  }
  whole += pattern;
  glob_t found{};
  std::vector<std::filesystem::path> files;
  if (::glob(whole.c_str(), GLOB_NOSORT, nullptr, &found) == 0)
    for (std::size_t i = 0; i < found.gl_pathc; ++i)
      files.push_back(std::filesystem::path(found.gl_pathv[i]).lexically_normal());
  ::globfree(&found);
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return natural_less(a.string(), b.string()); });
  return files;
}

std::optional<int> number_in_name(const std::filesystem::path& file) {
  const std::string name = file.stem().string();
  auto end = name.size();
  while (end > 0 && !is_digit(name[end - 1])) --end;
  auto start = end;
  while (start > 0 && is_digit(name[start - 1])) --start;
  if (start == end || end - start > 9) return std::nullopt;
  return std::stoi(name.substr(start, end - start));
}

bool same_content(const std::filesystem::path& a, const std::filesystem::path& b) {
  std::error_code error;
  if (std::filesystem::file_size(a, error) != std::filesystem::file_size(b, error) || error) return false;
  std::ifstream first(a, std::ios::binary), second(b, std::ios::binary);
  return std::equal(std::istreambuf_iterator<char>(first), {}, std::istreambuf_iterator<char>(second));
}

ImageHeader read_image_header(const std::filesystem::path& file) {
  Bytes bytes(file);
  if (bytes.size() < 32) bytes.unknown();
  if (bytes.number(0, 8, true) == 0x89504e470d0a1a0a) return read_png(bytes);
  if (bytes.number(0, 2, true) == 0x424d) return read_bmp(bytes);
  if (bytes.number(0, 4, true) == 0x49492a00) return read_tiff(bytes, false);
  if (bytes.number(0, 4, true) == 0x4d4d002a) return read_tiff(bytes, true);
  if (bytes.number(0, 3, true) == 0xffd8ff) bytes.unknown("a JPEG image, which has lost noise and gained patterns");
  if (const auto magic = bytes.number(0, 2, true); magic >= 0x5031 && magic <= 0x5036)
    bytes.unknown("a portable anymap");
  bytes.unknown();
}

}  // namespace imic3d::io
