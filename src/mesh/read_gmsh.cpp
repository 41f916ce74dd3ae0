// Gmsh's own format, versions 2.2 and 4.1, ASCII (https://gmsh.info/doc/texinfo/gmsh.html#File-formats).

#include <fmt/format.h>

#include <algorithm>
#include <climits>
#include <cstdlib>
#include <utility>

#include "mesh_file.hpp"

namespace imic3d::mesh {

namespace {

struct GmshType {
  Shape shape;
  int dimension;
  std::string_view name;
};

GmshType gmsh_type(long type) {
  switch (type) {
    case 1: return {Shape::line2, 1, "2-node lines"};
    case 2: return {Shape::other, 2, "3-node triangles"};
    case 3: return {Shape::quad4, 2, "4-node quadrilaterals"};
    case 4: return {Shape::other, 3, "4-node tetrahedra"};
    case 5: return {Shape::hex8, 3, "8-node hexahedra"};
    case 6: return {Shape::other, 3, "6-node prisms"};
    case 7: return {Shape::other, 3, "5-node pyramids"};
    case 8: return {Shape::other, 1, "3-node lines"};
    case 9: return {Shape::other, 2, "6-node triangles"};
    case 10: return {Shape::other, 2, "9-node quadrilaterals"};
    case 11: return {Shape::other, 3, "10-node tetrahedra"};
    case 12: return {Shape::other, 3, "27-node hexahedra"};
    case 13: return {Shape::other, 3, "18-node prisms"};
    case 14: return {Shape::other, 3, "14-node pyramids"};
    case 15: return {Shape::point, 0, "points"};
    case 16: return {Shape::other, 2, "8-node quadrilaterals"};
    case 17: return {Shape::other, 3, "20-node hexahedra"};
    case 18: return {Shape::other, 3, "15-node prisms"};
    case 19: return {Shape::other, 3, "13-node pyramids"};
    default: return {Shape::other, 3, "elements of high order"};
  }
}

class GmshReader {
 public:
  explicit GmshReader(const std::filesystem::path& file) : lines_(file) {}

  FileContents read() {
    std::string_view line;
    while (lines_.next(line)) {
      if (line == "$MeshFormat") {
        read_format();
        continue;
      }
      if (line.starts_with("$") && !line.starts_with("$Comments") && version_ == 0)
        lines_.fail(fmt::format("\"{}\"", line), "$MeshFormat first");
      if (line == "$PhysicalNames")
        read_physical_names();
      else if (line == "$Entities")
        read_entities();
      else if (line == "$Nodes")
        version_ == 2 ? read_nodes_2() : read_nodes_4();
      else if (line == "$Elements")
        version_ == 2 ? read_elements_2() : read_elements_4();
      else if (line.starts_with("$"))
        skip_section(std::string(line.substr(1)));
      else
        lines_.fail(fmt::format("\"{}\"", line.substr(0, 40)), "a section such as $Nodes");
    }
    if (version_ == 0) lines_.fail("no $MeshFormat", "a Gmsh mesh, version 2.2 or 4.1, ASCII");
    return std::move(contents_);
  }

 private:
  using Physical = std::pair<int, long>;  // dimension, number

  void end_section(const char* name) {
    if (const auto line = lines_.expect(name); line != name)
      lines_.fail(fmt::format("\"{}\"", line.substr(0, 40)), name);
  }

  void skip_section(const std::string& name) {
    while (lines_.expect(fmt::format("$End{}", name).c_str()) != "$End" + name) {
    }
  }

  std::size_t take_count(std::string_view& line, const char* what) {
    const long count = take_integer(line, lines_, what);
    if (count < 0) lines_.fail(fmt::format("{}", count), what);
    return static_cast<std::size_t>(count);
  }

  /// Physical groups, and other tags, are 32-bit numbers.
  long take_group(std::string_view& line) {
    const long group = take_integer(line, lines_, "a physical group");
    if (std::labs(std::max(group, -LONG_MAX)) > INT_MAX)
      lines_.fail(fmt::format("{}", group), "the number of a physical group");
    return group;
  }

  void read_format() {
    std::string_view line = lines_.expect("the version of the format");
    const auto version = take_word(line);
    if (version == "2.2" || version == "2")
      version_ = 2;
    else if (version == "4.1")
      version_ = 4;
    else
      lines_.fail(fmt::format("Gmsh format {}", version), "2.2 or 4.1 (gmsh -format msh22, or -format msh41)");
    if (take_integer(line, lines_, "0 for ASCII or 1 for binary") != 0)
      lines_.fail("a binary mesh", "ASCII (gmsh without -bin)");
    end_section("$EndMeshFormat");
  }

  void read_physical_names() {
    std::string_view line = lines_.expect("the number of physical names");
    for (std::size_t left = take_count(line, "the number of physical names"); left > 0; --left) {
      line = lines_.expect("a physical name");
      const auto dimension = static_cast<int>(take_integer(line, lines_, "a dimension"));
      const long number = take_integer(line, lines_, "the number of a physical group");
      const std::size_t first = line.find('"'), last = line.rfind('"');
      if (first == std::string_view::npos || last <= first) lines_.fail(std::string(line), "a name in quotation marks");
      names_[{dimension, number}] = std::string(line.substr(first + 1, last - first - 1));
    }
    end_section("$EndPhysicalNames");
  }

  /// The name of a physical group; one without a name is called after its dimension and number, e.g. `curve3`.
  std::string group_name(int dimension, long number) const {
    const auto at = names_.find({dimension, number});
    if (at != names_.end()) return at->second;
    constexpr std::array<const char*, 4> kinds{"point", "curve", "surface", "volume"};
    return fmt::format("{}{}", kinds[static_cast<std::size_t>(dimension)], number);
  }

  void read_entities() {
    std::string_view line = lines_.expect("the numbers of entities");
    std::array<std::size_t, 4> counts{};
    for (auto& count : counts) count = take_count(line, "a number of entities");
    for (int dimension = 0; dimension < 4; ++dimension)
      for (std::size_t left = counts[static_cast<std::size_t>(dimension)]; left > 0; --left) {
        line = lines_.expect("an entity");
        const long entity = take_integer(line, lines_, "the number of an entity");
        for (int i = 0; i < (dimension == 0 ? 3 : 6); ++i) (void)take_number(line, lines_, "a bound of an entity");
        auto& groups = groups_of_entity_[{dimension, entity}];
        for (std::size_t group = take_count(line, "a number of physical groups"); group > 0; --group)
          groups.push_back(std::labs(take_group(line)));  // negative: reversed orientation
      }
    end_section("$EndEntities");
  }

  void read_nodes_2() {
    std::string_view line = lines_.expect("the number of nodes");
    for (std::size_t left = take_count(line, "the number of nodes"); left > 0; --left) {
      line = lines_.expect("a node");
      contents_.node_numbers.push_back(take_integer(line, lines_, "the number of a node"));
      take_node(line);
    }
    end_section("$EndNodes");
  }

  void take_node(std::string_view& line) {
    Eigen::Vector3d node;
    for (double& coordinate : node) coordinate = take_number(line, lines_, "a coordinate");
    contents_.nodes.push_back(node);
  }

  void read_nodes_4() {
    std::string_view line = lines_.expect("the number of node blocks");
    for (std::size_t blocks = take_count(line, "the number of node blocks"); blocks > 0; --blocks) {
      line = lines_.expect("a block of nodes");
      for (int i = 0; i < 3; ++i) (void)take_integer(line, lines_, "dimension, entity and kind of a block of nodes");
      const std::size_t count = take_count(line, "the number of nodes of a block");
      for (std::size_t i = 0; i < count; ++i) {
        line = lines_.expect("the number of a node");
        contents_.node_numbers.push_back(take_integer(line, lines_, "the number of a node"));
      }
      for (std::size_t i = 0; i < count; ++i) {
        line = lines_.expect("a node");
        take_node(line);  // the parameters of a node on a curve or surface may follow
      }
    }
    end_section("$EndNodes");
  }

  FileElement take_element(std::string_view& line, long number, const GmshType& type) {
    FileElement element{
        .number = number, .shape = type.shape, .dimension = type.dimension, .nodes = {}, .name = type.name};
    for (int i = 0; i < nodes_of(type.shape); ++i)
      element.nodes[static_cast<std::size_t>(i)] = take_integer(line, lines_, "the node of an element");
    return element;
  }

  void add(const FileElement& element, const std::vector<long>& groups) {
    for (long group : groups)
      contents_.element_groups[group_name(element.dimension, group)].push_back(contents_.elements.size());
    contents_.elements.push_back(element);
  }

  void read_elements_2() {
    std::string_view line = lines_.expect("the number of elements");
    for (std::size_t left = take_count(line, "the number of elements"); left > 0; --left) {
      line = lines_.expect("an element");
      const long number = take_integer(line, lines_, "the number of an element");
      const GmshType type = gmsh_type(take_integer(line, lines_, "the type of an element"));
      std::vector<long> groups;
      const std::size_t tags = take_count(line, "a number of tags");
      for (std::size_t i = 0; i < tags; ++i) {
        const long tag = take_group(line);
        if (i == 0 && tag != 0) groups.push_back(std::labs(tag));
      }
      add(take_element(line, number, type), groups);
    }
    end_section("$EndElements");
  }

  void read_elements_4() {
    std::string_view line = lines_.expect("the number of element blocks");
    for (std::size_t blocks = take_count(line, "the number of element blocks"); blocks > 0; --blocks) {
      line = lines_.expect("a block of elements");
      const auto dimension = static_cast<int>(take_integer(line, lines_, "the dimension of a block of elements"));
      const long entity = take_integer(line, lines_, "the entity of a block of elements");
      const GmshType type = gmsh_type(take_integer(line, lines_, "the type of a block of elements"));
      const auto groups = groups_of_entity_.find({dimension, entity});
      for (std::size_t left = take_count(line, "the number of elements of a block"); left > 0; --left) {
        line = lines_.expect("an element");
        const long number = take_integer(line, lines_, "the number of an element");
        add(take_element(line, number, type), groups == groups_of_entity_.end() ? std::vector<long>{} : groups->second);
      }
    }
    end_section("$EndElements");
  }

  Lines lines_;
  int version_ = 0;
  std::map<Physical, std::string> names_;
  std::map<Physical, std::vector<long>> groups_of_entity_;
  FileContents contents_;
};

}  // namespace

FileContents read_gmsh(const std::filesystem::path& file) { return GmshReader(file).read(); }

}  // namespace imic3d::mesh
