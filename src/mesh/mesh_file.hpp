#pragma once
// What the readers of the mesh formats share: a file as lines, and its contents before the numbering is made
// contiguous.

#include <Eigen/Core>
#include <array>
#include <charconv>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::mesh {

enum class Shape { point, line2, quad4, hex8, other };

/// An element as the file has it: its number, node numbers and, for shapes that are not supported, a name to complain
/// of.
struct FileElement {
  long number = 0;
  Shape shape = Shape::other;
  int dimension = 0;
  std::array<long, 8> nodes{};
  std::string_view name;  ///< of a static string
};

struct FileContents {
  std::vector<long> node_numbers;
  std::vector<Eigen::Vector3d> nodes;
  std::vector<FileElement> elements;
  std::map<std::string, std::vector<std::size_t>> element_groups;      ///< positions in `elements`
  std::map<std::string, std::vector<long>> node_groups;                ///< node numbers of the file
  std::map<std::string, std::vector<std::vector<long>>> facet_groups;  ///< node numbers of edges or faces
};

inline int nodes_of(Shape shape) {
  switch (shape) {
    case Shape::point: return 1;
    case Shape::line2: return 2;
    case Shape::quad4: return 4;
    case Shape::hex8: return 8;
    case Shape::other: return 0;
  }
  return 0;
}

/// A text file, line by line, that knows where it is.
class Lines {
 public:
  /// Throws InputError if the file cannot be read.
  explicit Lines(const std::filesystem::path& file);
  /// The next line that is not blank, without white space at its ends; false at the end of the file.
  bool next(std::string_view& line);
  /// The next line; throws InputError with `what` was expected at the end of the file.
  std::string_view expect(const char* what);
  /// `file:line`
  [[nodiscard]] std::string place() const;
  [[noreturn]] void fail(const std::string& found, const std::string& allowed) const;

 private:
  std::string name_, text_;
  std::size_t position_ = 0;
  int number_ = 0;
};

[[nodiscard]] std::string_view trimmed(std::string_view text);

/// Takes the next word (separated by white space or commas) off the front of `line`; empty at its end.
[[nodiscard]] std::string_view take_word(std::string_view& line);

/// The next words of `line` as numbers. Throws InputError at `lines`' place.
[[nodiscard]] long take_integer(std::string_view& line, const Lines& lines, const char* what);
[[nodiscard]] double take_number(std::string_view& line, const Lines& lines, const char* what);

[[nodiscard]] FileContents read_gmsh(const std::filesystem::path& file);
[[nodiscard]] FileContents read_abaqus(const std::filesystem::path& file);

}  // namespace imic3d::mesh
