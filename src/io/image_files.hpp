#pragma once
// Image files of a camera: which there are, in what order, and what their headers say.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace imic3d::io {

/// Files that match a pattern of the shell, relative to `folder`, in natural order (frame_2 before frame_10).
[[nodiscard]] std::vector<std::filesystem::path> matching_files(const std::filesystem::path& folder,
                                                                const std::string& pattern);

/// Natural order: runs of digits compare as numbers.
[[nodiscard]] bool natural_less(const std::string& a, const std::string& b);

/// The last number in a file's name, without its extension; nothing if there is none.
[[nodiscard]] std::optional<int> number_in_name(const std::filesystem::path& file);

/// Whether two files hold the same bytes.
[[nodiscard]] bool same_content(const std::filesystem::path& a, const std::filesystem::path& b);

/// What an image's header says; read without decoding the pixels.
struct ImageHeader {
  int columns = 0, rows = 0;
  int depth = 0;     ///< bits per sample
  int channels = 1;  ///< samples per pixel
};

/// Reads the header of a PNG, TIFF or BMP file and checks that the file is complete. Throws InputError (place: the
/// file).
[[nodiscard]] ImageHeader read_image_header(const std::filesystem::path& file);

}  // namespace imic3d::io
