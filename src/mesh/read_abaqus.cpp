// Abaqus input files: nodes, elements, sets and element surfaces of one part.

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <optional>
#include <set>
#include <unordered_map>
#include <utility>

#include "mesh_file.hpp"

namespace imic3d::mesh {

namespace {

std::string upper(std::string_view text) {
  std::string result(text);
  std::transform(result.begin(), result.end(), result.begin(), [](unsigned char c) { return std::toupper(c); });
  return result;
}

struct AbaqusType {
  Shape shape;
  int dimension;  ///< -1: not a part of the specimen (rigid bodies, masses, springs …)
  std::string_view name;
};

/// Nothing but separators is left of a data line.
bool at_end(std::string_view line) { return take_word(line).empty(); }

AbaqusType abaqus_type(const std::string& type) {
  const auto starts = [&](std::initializer_list<const char*> prefixes) {
    return std::any_of(prefixes.begin(), prefixes.end(), [&](const char* prefix) { return type.starts_with(prefix); });
  };
  if (starts({"C3D8"})) return {Shape::hex8, 3, "8-node hexahedra"};
  if (starts({"C3D20", "C3D27"})) return {Shape::other, 3, "quadratic hexahedra"};
  if (starts({"C3D4", "C3D10"})) return {Shape::other, 3, "tetrahedra"};
  if (starts({"C3D", "SC", "CSS"})) return {Shape::other, 3, "prisms or other solids"};
  if (starts({"CPS4", "CPE4", "CPEG4", "CAX4", "S4", "M3D4", "SFM3D4"}))
    return {Shape::quad4, 2, "4-node quadrilaterals"};
  if (starts({"CPS3", "CPE3", "CPEG3", "CAX3", "S3", "STRI3", "M3D3", "SFM3D3"}))
    return {Shape::other, 2, "3-node triangles"};
  if (starts({"CPS", "CPE", "CAX", "S8", "S9", "STRI65", "M3D", "SFM3D"}))
    return {Shape::other, 2, "quadratic triangles or quadrilaterals"};
  if (type == "T2D2" || type == "T3D2" || type == "B21" || type == "B31") return {Shape::line2, 1, "2-node lines"};
  return {Shape::other, -1, ""};
}

constexpr std::array<std::array<int, 4>, 6> abaqus_hex_faces{
    {{0, 1, 2, 3}, {4, 7, 6, 5}, {0, 4, 5, 1}, {1, 5, 6, 2}, {2, 6, 7, 3}, {3, 7, 4, 0}}};

/// A keyword line: its name and parameters (names in upper case, values as written).
struct Keyword {
  std::string name;
  std::map<std::string, std::string> parameters;
  [[nodiscard]] bool has(const char* parameter) const { return parameters.contains(parameter); }
  [[nodiscard]] std::string value(const char* parameter) const {
    const auto at = parameters.find(parameter);
    return at == parameters.end() ? "" : at->second;
  }
};

class AbaqusReader {
 public:
  explicit AbaqusReader(const std::filesystem::path& file) : lines_(file) {}

  FileContents read() {
    bool more = next();
    while (more) {
      if (!line_.starts_with('*')) lines_.fail(fmt::format("\"{}\"", line_.substr(0, 40)), "a keyword such as *NODE");
      const Keyword keyword = take_keyword();
      refuse(keyword);
      if (keyword.name == "NODE")
        more = read_nodes(keyword);
      else if (keyword.name == "ELEMENT")
        more = read_elements(keyword);
      else if (keyword.name == "NSET")
        more = read_set(keyword, "NSET", node_sets_);
      else if (keyword.name == "ELSET")
        more = read_set(keyword, "ELSET", element_sets_);
      else if (keyword.name == "SURFACE")
        more = read_surface(keyword);
      else if (keyword.name == "INSTANCE")
        more = read_instance();
      else
        more = skip_data();
    }
    gather_groups();
    return std::move(contents_);
  }

 private:
  template <class Member>
  struct Set {
    std::string name;  ///< as first written
    std::vector<Member> members;
  };
  template <class Member>
  using Sets = std::map<std::string, Set<Member>>;  // by name in upper case
  struct Face {
    std::string set;  ///< an element set, or empty:
    long element = 0;
    std::size_t face = 0;
    std::string place;
  };

  bool next() {
    do {
      line_ = {};
      if (!lines_.next(line_)) return false;
    } while (line_.starts_with("**"));
    return true;
  }

  bool next_data() { return next() && !line_.starts_with('*'); }

  /// True if there is a further keyword.
  bool skip_data() {
    while (next_data()) {
    }
    return line_.starts_with('*');
  }

  Keyword take_keyword() {
    std::string text(line_);
    while (text.ends_with(',')) {
      if (!next()) lines_.fail("the file ends", "the rest of a keyword line");
      text += line_;
    }
    Keyword keyword;
    std::size_t begin = 1;
    for (bool first = true; begin <= text.size(); first = false) {
      const std::size_t end = std::min(text.find(',', begin), text.size());
      const std::string_view part = trimmed(std::string_view(text).substr(begin, end - begin));
      const std::size_t equals = part.find('=');
      const std::string name = upper(trimmed(part.substr(0, equals)));
      if (first)
        keyword.name = name;
      else
        keyword.parameters[name] = equals == std::string_view::npos ? "" : unquoted(part.substr(equals + 1));
      begin = end + 1;
    }
    return keyword;
  }

  static std::string unquoted(std::string_view text) {
    text = trimmed(text);
    if (text.size() >= 2 && text.front() == '"' && text.back() == '"') text = text.substr(1, text.size() - 2);
    return std::string(text);
  }

  void refuse(const Keyword& keyword) const {
    static const std::set<std::string> generating{"INCLUDE", "SYSTEM", "NGEN",  "NFILL",
                                                  "NCOPY",   "NMAP",   "ELGEN", "ELCOPY"};
    if (generating.contains(keyword.name))
      lines_.fail("*" + keyword.name, "one file with every node and element written out");
    if ((keyword.name == "NODE" || keyword.name == "ELEMENT") && keyword.has("INPUT"))
      lines_.fail("INPUT=" + keyword.value("INPUT"), "one file with every node and element written out");
    if (keyword.name == "NODE" && keyword.has("SYSTEM") && upper(keyword.value("SYSTEM")) != "R")
      lines_.fail("SYSTEM=" + keyword.value("SYSTEM"), "rectangular coordinates");
  }

  /// The set of that name, new if need be; `Part-1-1.Set-1` is the set Set-1.
  template <class Member>
  static Set<Member>& set_named(Sets<Member>& sets, const std::string& name) {
    const std::string last = name.substr(name.rfind('.') + 1);
    auto& set = sets[upper(last)];
    if (set.name.empty()) set.name = last;
    return set;
  }

  bool read_nodes(const Keyword& keyword) {
    std::vector<long>* set = keyword.has("NSET") ? &set_named(node_sets_, keyword.value("NSET")).members : nullptr;
    while (next_data()) {
      std::string_view rest = line_;
      refuse_empty_fields();
      const long number = take_integer(rest, lines_, "the number of a node");
      Eigen::Vector3d node = Eigen::Vector3d::Zero();
      for (int i = 0; i < 3; ++i)
        if (i < 2 || !at_end(rest)) node[i] = take_number(rest, lines_, "a coordinate");
      contents_.node_numbers.push_back(number);
      contents_.nodes.push_back(node);
      if (set != nullptr) set->push_back(number);
    }
    return line_.starts_with('*');
  }

  /// Abaqus reads an empty field as 0; here it would shift the coordinates after it.
  void refuse_empty_fields() const {
    bool empty = true;
    for (char letter : line_.substr(0, line_.size() - 1)) {
      if (letter == ',' && empty) lines_.fail("an empty coordinate", "a number in every field");
      if (letter != ' ' && letter != '\t') empty = letter == ',';
    }
  }

  bool read_elements(const Keyword& keyword) {
    const std::string written = keyword.value("TYPE");
    if (written.empty()) lines_.fail("*ELEMENT without TYPE", "*ELEMENT, TYPE=CPS4 or C3D8, for example");
    const AbaqusType type = abaqus_type(upper(written));
    if (type.dimension < 0) return skip_data();
    std::vector<long>* set = keyword.has("ELSET") ? &set_named(element_sets_, keyword.value("ELSET")).members : nullptr;
    const auto count = static_cast<std::size_t>(nodes_of(type.shape));
    bool data = next_data();
    while (data) {
      std::string_view rest = line_;
      FileElement element{.number = take_integer(rest, lines_, "the number of an element"),
                          .shape = type.shape,
                          .dimension = type.dimension,
                          .nodes = {},
                          .name = type.name};
      if (type.shape == Shape::other) {
        for (bool continued = true; continued;) {
          continued = line_.ends_with(',');
          data = next_data();
          continued = continued && data;
        }
      } else {
        for (std::size_t i = 0; i < count; ++i) {
          while (at_end(rest)) {
            if (!next_data()) lines_.fail("the element ends", fmt::format("{} nodes", count));
            rest = line_;
          }
          element.nodes[i] = take_integer(rest, lines_, "the node of an element");
        }
        data = next_data();
      }
      if (!element_at_.emplace(element.number, contents_.elements.size()).second)
        lines_.fail(fmt::format("element {} is there twice", element.number), "different element numbers");
      if (set != nullptr) set->push_back(element.number);
      contents_.elements.push_back(element);
    }
    return line_.starts_with('*');
  }

  bool read_set(const Keyword& keyword, const char* parameter, Sets<long>& sets) {
    if (keyword.value(parameter).empty())
      lines_.fail(fmt::format("*{} without a name", keyword.name),
                  fmt::format("*{}, {}=name", keyword.name, parameter));
    auto& set = set_named(sets, keyword.value(parameter));
    while (next_data()) {
      std::string_view rest = line_;
      if (keyword.has("GENERATE")) {
        const long first = take_integer(rest, lines_, "first"), last = take_integer(rest, lines_, "last");
        const long step = at_end(rest) ? 1 : take_integer(rest, lines_, "step");
        if (step <= 0 || last < first)
          lines_.fail(fmt::format("{}, {}, {}", first, last, step), "first, last, step > 0");
        const auto count =
            (static_cast<unsigned long>(last) - static_cast<unsigned long>(first)) / static_cast<unsigned long>(step) +
            1;
        if (count > most_generated - generated_)
          lines_.fail(fmt::format("{}, {}, {}", first, last, step),
                      fmt::format("at most {} numbers in all generated sets", most_generated));
        generated_ += count;
        for (unsigned long i = 0; i < count; ++i)
          set.members.push_back(
              static_cast<long>(static_cast<unsigned long>(first) + i * static_cast<unsigned long>(step)));
        continue;
      }
      while (true) {
        std::string_view ahead = rest;
        const std::string_view word = take_word(ahead);
        if (word.empty()) break;
        if (std::isdigit(static_cast<unsigned char>(word.front())) != 0) {
          set.members.push_back(take_integer(rest, lines_, "a number or the name of a set"));
          continue;
        }
        const std::string other = upper(unquoted(word)).substr(upper(unquoted(word)).rfind('.') + 1);
        const auto at = sets.find(other);
        if (at == sets.end()) lines_.fail(fmt::format("set {}", word), "a set defined before");
        const std::vector<long> members = at->second.members;
        set.members.insert(set.members.end(), members.begin(), members.end());
        // Sets of sets of sets would grow without bound.
        std::sort(set.members.begin(), set.members.end());
        set.members.erase(std::unique(set.members.begin(), set.members.end()), set.members.end());
        rest = ahead;
      }
    }
    return line_.starts_with('*');
  }

  bool read_surface(const Keyword& keyword) {
    const std::string type = upper(keyword.value("TYPE"));
    if (!type.empty() && type != "ELEMENT") return skip_data();
    auto& surface = set_named(surfaces_, keyword.value("NAME"));
    while (next_data()) {
      std::string_view rest = line_;
      const std::string of(take_word(rest));
      const std::string_view face = take_word(rest);
      if (face.size() != 2 || (face[0] != 'S' && face[0] != 's' && face[0] != 'E' && face[0] != 'e') || face[1] < '1' ||
          face[1] > '6')
        continue;  // a whole face of a shell, an analytical surface …
      Face& member = surface.members.emplace_back(Face{{}, 0, static_cast<std::size_t>(face[1] - '1'), lines_.place()});
      std::string_view number = of;
      if (std::isdigit(static_cast<unsigned char>(of.front())) != 0)
        member.element = take_integer(number, lines_, "an element or an element set");
      else
        member.set = of;
    }
    return line_.starts_with('*');
  }

  bool read_instance() {
    if (++instances_ > 1) lines_.fail("a second *INSTANCE", "one instance of one part");
    while (next_data()) {
      std::string_view rest = line_;
      while (!at_end(rest))
        if (take_number(rest, lines_, "a translation") != 0.0)
          lines_.fail("an instance that is moved or turned", "an instance in its part's place");
    }
    return line_.starts_with('*');
  }

  /// Sets may name elements and nodes that come later: they are looked up at the end.
  void gather_groups() {
    for (auto& [key, set] : node_sets_) contents_.node_groups[set.name] = std::move(set.members);
    for (const auto& [key, set] : element_sets_)
      for (long number : set.members)
        if (const auto at = element_at_.find(number); at != element_at_.end())
          contents_.element_groups[set.name].push_back(at->second);
    for (const auto& [key, surface] : surfaces_)
      for (const auto& face : surface.members) add_faces(surface.name, face);
  }

  void add_faces(const std::string& surface, const Face& face) {
    std::vector<long> numbers{face.element};
    if (!face.set.empty()) {
      const auto at = element_sets_.find(upper(face.set).substr(upper(face.set).rfind('.') + 1));
      if (at == element_sets_.end()) throw InputError(face.place, "element set " + face.set, "a set of the file");
      numbers = at->second.members;
    }
    for (long number : numbers) {
      const auto at = element_at_.find(number);
      if (at == element_at_.end()) continue;
      const auto& element = contents_.elements[at->second];
      std::vector<long> nodes;
      if (element.shape == Shape::hex8)
        for (int k : abaqus_hex_faces[face.face]) nodes.push_back(element.nodes[static_cast<std::size_t>(k)]);
      else if (element.shape == Shape::quad4 && face.face < 4)
        nodes = {element.nodes[face.face], element.nodes[(face.face + 1) % 4]};
      if (!nodes.empty()) contents_.facet_groups[surface].push_back(std::move(nodes));
    }
  }

  static constexpr unsigned long most_generated = 20'000'000;

  Lines lines_;
  std::string_view line_;
  int instances_ = 0;
  unsigned long generated_ = 0;  // numbers in sets
  std::unordered_map<long, std::size_t> element_at_;
  Sets<long> node_sets_, element_sets_;
  Sets<Face> surfaces_;
  FileContents contents_;
};

}  // namespace

FileContents read_abaqus(const std::filesystem::path& file) { return AbaqusReader(file).read(); }

}  // namespace imic3d::mesh
