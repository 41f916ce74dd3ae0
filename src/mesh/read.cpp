#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <optional>
#include <set>
#include <unordered_map>

#include "check.hpp"
#include "facets.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "mesh_file.hpp"

namespace imic3d::mesh {

Lines::Lines(const std::filesystem::path& file) : name_(file.filename().string()) {
  std::error_code ignored;
  std::ifstream stream(file, std::ios::binary);
  if (!stream || !std::filesystem::is_regular_file(file, ignored))
    throw InputError(file.string(), "cannot be read", "a mesh file (.msh or .inp)");
  text_.assign(std::istreambuf_iterator<char>(stream), {});
}

bool Lines::next(std::string_view& line) {
  while (position_ < text_.size()) {
    const std::size_t end = std::min(text_.find('\n', position_), text_.size());
    line = trimmed(std::string_view(text_).substr(position_, end - position_));
    position_ = end + 1;
    ++number_;
    if (!line.empty()) return true;
  }
  return false;
}

std::string_view Lines::expect(const char* what) {
  std::string_view line;
  if (!next(line)) fail("the file ends", what);
  return line;
}

std::string Lines::place() const { return fmt::format("{}:{}", name_, number_); }

void Lines::fail(const std::string& found, const std::string& allowed) const {
  throw InputError(place(), found, allowed);
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view blank = " \t\r\n\v\f";
  const std::size_t first = text.find_first_not_of(blank);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(blank) - first + 1);
}

std::string_view take_word(std::string_view& line) {
  constexpr std::string_view separators = " \t\r,";
  const std::size_t first = line.find_first_not_of(separators);
  if (first == std::string_view::npos) return line = {};
  const std::size_t end = std::min(line.find_first_of(separators, first), line.size());
  const std::string_view word = line.substr(first, end - first);
  line.remove_prefix(end);
  return word;
}

long take_integer(std::string_view& line, const Lines& lines, const char* what) {
  const std::string_view word = take_word(line);
  long value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (word.empty() || error != std::errc() || end != word.data() + word.size())
    lines.fail(word.empty() ? "the line ends" : fmt::format("\"{}\"", word), fmt::format("{} (an integer)", what));
  return value;
}

double take_number(std::string_view& line, const Lines& lines, const char* what) {
  const std::string_view word = take_word(line);
  std::string text(word.starts_with('+') ? word.substr(1) : word);
  for (char& letter : text)
    if (letter == 'd' || letter == 'D') letter = 'e';  // Fortran's double precision
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    lines.fail(word.empty() ? "the line ends" : fmt::format("\"{}\"", word), fmt::format("{} (a number)", what));
  return value;
}

namespace {

constexpr const char* supported =
    "4-node quadrilaterals (2D) or 8-node hexahedra (3D), in Gmsh 2.2 or 4.1 ASCII or Abaqus "
    "format; for Gmsh: recombine the surfaces, element order 1";

/// The highest dimension in the file; throws if its elements are not all quads or hexes.
int cell_dimension(const FileContents& contents, const std::string& name) {
  int dimension = 0;
  for (const auto& element : contents.elements) dimension = std::max(dimension, element.dimension);
  std::map<std::string_view, int> others;
  bool found = false;
  for (const auto& element : contents.elements) {
    if (element.dimension != dimension) continue;
    found = found || element.shape != Shape::other;
    if (element.shape == Shape::other) ++others[element.name];
  }
  if (dimension < 2 && others.empty())
    throw InputError(name, "no quadrilaterals and no hexahedra",
                     std::string(supported) + " (of a geometry with physical groups it saves what is in one of them: "
                                              "there must be a Physical Surface, or Volume, too)");
  if (others.empty() && found) return dimension;
  std::string list;
  for (const auto& [shape, count] : others) list += fmt::format("{}{} {}", list.empty() ? "" : ", ", count, shape);
  throw InputError(name, list, supported);
}

/// Turns cells whose corners are all negative; the others are left for `check`.
void turn_reversed_cells(Mesh& mesh) {
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c) {
    if (largest_corner_jacobian(mesh, c) >= 0.0) continue;
    auto cell = mesh.cells.row(c);
    if (mesh.type == CellType::quad4)
      std::swap(cell[1], cell[3]);
    else
      for (int i = 0; i < 4; ++i) std::swap(cell[i], cell[i + 4]);
  }
}

void sort_unique(std::vector<int>& numbers) {
  std::sort(numbers.begin(), numbers.end());
  numbers.erase(std::unique(numbers.begin(), numbers.end()), numbers.end());
}

class Builder {
 public:
  Builder(const FileContents& contents, std::string name) : contents_(contents), name_(std::move(name)) {}

  Mesh build() {
    dimension_ = cell_dimension(contents_, name_);
    mesh_.type = dimension_ == 3 ? CellType::hex8 : CellType::quad4;
    number_nodes();
    take_cells();
    check_or_throw();
    take_groups();
    if (dimension_ == 3) choose_default_front();
    return std::move(mesh_);
  }

 private:
  /// Nodes of the cells, in the order of the file.
  void number_nodes() {
    std::unordered_map<long, int> position;
    position.reserve(contents_.nodes.size());
    for (std::size_t i = 0; i < contents_.nodes.size(); ++i)
      if (!position.emplace(contents_.node_numbers[i], static_cast<int>(i)).second)
        throw InputError(name_, fmt::format("node {} is there twice", contents_.node_numbers[i]),
                         "different node numbers");
    std::vector<char> used(contents_.nodes.size(), 0);
    for (const auto& element : contents_.elements) {
      if (element.dimension != dimension_) continue;
      for (int k = 0; k < nodes_of(element.shape); ++k) {
        const auto at = position.find(element.nodes[static_cast<std::size_t>(k)]);
        if (at == position.end())
          throw InputError(fmt::format("{} element {}", name_, element.number),
                           fmt::format("node {}", element.nodes[static_cast<std::size_t>(k)]), "a node of the file");
        used[static_cast<std::size_t>(at->second)] = 1;
      }
    }
    const auto count = std::count(used.begin(), used.end(), 1);
    mesh_.nodes.resize(count, 3);
    int next = 0;
    for (std::size_t i = 0; i < contents_.nodes.size(); ++i) {
      if (used[i] == 0) continue;
      mesh_.nodes.row(next) = contents_.nodes[i].transpose();
      number_.emplace(contents_.node_numbers[i], next++);
    }
  }

  /// Cells in the order of the file; one that stands there once for each of its groups (Gmsh 2.2) is kept once.
  void take_cells() {
    const int size = nodes_per_cell(mesh_.type);
    cell_of_element_.assign(contents_.elements.size(), -1);
    std::map<std::vector<int>, int> known;
    std::vector<std::vector<int>> cells;
    for (std::size_t e = 0; e < contents_.elements.size(); ++e) {
      const auto& element = contents_.elements[e];
      if (element.dimension != dimension_) continue;
      std::vector<int> cell(static_cast<std::size_t>(size));
      for (std::size_t k = 0; k < cell.size(); ++k) cell[k] = number_.at(element.nodes[k]);
      std::vector<int> key = cell;
      std::sort(key.begin(), key.end());
      const auto [at, is_new] = known.emplace(std::move(key), static_cast<int>(cells.size()));
      cell_of_element_[e] = at->second;
      if (!is_new) continue;
      cells.push_back(std::move(cell));
      labels_.push_back(element.number);
    }
    mesh_.cells.resize(static_cast<Eigen::Index>(cells.size()), size);
    for (std::size_t c = 0; c < cells.size(); ++c)
      for (std::size_t k = 0; k < cells[c].size(); ++k)
        mesh_.cells(static_cast<Eigen::Index>(c), static_cast<Eigen::Index>(k)) = cells[c][k];
  }

  void check_or_throw() {
    turn_reversed_cells(mesh_);
    auto mistakes = check_cells(mesh_, name_, "element", labels_);
    if (!mistakes.empty()) throw InputError(std::move(mistakes));
  }

  [[nodiscard]] std::optional<int> number(long file_number) const {
    const auto at = number_.find(file_number);
    return at == number_.end() ? std::nullopt : std::optional<int>(at->second);
  }

  void take_groups() {
    const Facets boundary = boundary_facets(mesh_);
    FacetMap<int> facet_at;
    const int size = facet_size(mesh_.type);
    for (Eigen::Index f = 0; f < boundary.nodes.rows(); ++f)
      facet_at.emplace(facet_key(boundary.nodes.row(f), size), static_cast<int>(f));

    std::map<std::string, std::vector<int>> facets;
    const auto add_facet = [&](const std::string& group, const auto& nodes, int count) {
      std::vector<int> mine;
      for (int k = 0; k < count; ++k)
        if (const auto node = number(nodes[static_cast<std::size_t>(k)])) mine.push_back(*node);
      auto& all = mesh_.node_groups[group];
      all.insert(all.end(), mine.begin(), mine.end());
      if (static_cast<int>(mine.size()) != count || count != size) return;
      const auto at = facet_at.find(facet_key(mine, size));
      if (at != facet_at.end()) facets[group].push_back(at->second);
    };

    for (const auto& [group, members] : contents_.element_groups)
      for (std::size_t e : members) {
        const auto& element = contents_.elements[e];
        if (element.dimension == dimension_)
          mesh_.cell_groups[group].push_back(cell_of_element_[e]);
        else if (element.shape != Shape::other)
          add_facet(group, element.nodes, nodes_of(element.shape));
      }
    for (const auto& [group, members] : contents_.facet_groups)
      for (const auto& nodes : members) add_facet(group, nodes, static_cast<int>(nodes.size()));
    for (const auto& [group, members] : contents_.node_groups)
      for (long node : members)
        if (const auto mine = number(node)) mesh_.node_groups[group].push_back(*mine);

    for (auto& [group, members] : mesh_.cell_groups) sort_unique(members);
    for (auto& [group, members] : mesh_.node_groups) sort_unique(members);
    std::erase_if(mesh_.node_groups, [](const auto& group) { return group.second.empty(); });
    for (auto& [group, members] : facets) {
      sort_unique(members);
      auto& rows = mesh_.facet_groups[group];
      rows.resize(static_cast<Eigen::Index>(members.size()), size);
      for (std::size_t i = 0; i < members.size(); ++i)
        rows.row(static_cast<Eigen::Index>(i)) = boundary.nodes.row(members[i]);
    }
  }

  void choose_default_front() {
    if (mesh_.facet_groups.contains("front")) {
      mesh_.front = mesh_.facet_groups["front"];
      return;
    }
    const Facets boundary = boundary_facets(mesh_);
    const double cosine = std::cos(std::acos(-1.0) / 6.0);
    std::vector<Eigen::Index> seen;
    for (Eigen::Index f = 0; f < boundary.nodes.rows(); ++f) {
      const auto at = [&](int k) -> Eigen::RowVector3d { return mesh_.nodes.row(boundary.nodes(f, k)); };
      const Eigen::RowVector3d normal = (at(2) - at(0)).cross(at(3) - at(1));
      if (normal[2] >= cosine * normal.norm()) seen.push_back(f);
    }
    mesh_.front.resize(static_cast<Eigen::Index>(seen.size()), 4);
    for (std::size_t i = 0; i < seen.size(); ++i)
      mesh_.front.row(static_cast<Eigen::Index>(i)) = boundary.nodes.row(seen[i]);
  }

  const FileContents& contents_;
  std::string name_;
  int dimension_ = 2;
  Mesh mesh_;
  std::unordered_map<long, int> number_;
  std::vector<int> cell_of_element_;
  std::vector<long> labels_;
};

}  // namespace

Mesh read(const std::filesystem::path& file) {
  const std::string extension = file.extension().string();
  if (extension != ".msh" && extension != ".inp")
    throw InputError(file.string(), fmt::format("a file that ends in \"{}\"", extension),
                     ".msh (Gmsh) or .inp (Abaqus)");
  const FileContents contents = extension == ".msh" ? read_gmsh(file) : read_abaqus(file);
  return Builder(contents, file.filename().string()).build();
}

}  // namespace imic3d::mesh
