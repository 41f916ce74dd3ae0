#include <fmt/format.h>
#include <fmt/ranges.h>

#include "imic3d/core/error.hpp"
#include "imic3d/io/run_results.hpp"

namespace imic3d::io {

namespace {

/// Writes the XML of one results file. Heavy data stay in the HDF5 file; a frame is a slab of its dataset.
class XdmfWriter {
 public:
  explicit XdmfWriter(const ResultsFile& file)
      : file_(file), numbers_(file.read_integers(file.has("loop/frames") ? "loop/frames" : "frames/number")) {}

  std::string text() {
    out_ =
        "<?xml version=\"1.0\"?>\n<!-- In ParaView choose \"XDMF Reader\"; the Xdmf3 readers do not know slabs. -->\n"
        "<Xdmf Version=\"2.0\">\n <Domain>\n";
    if (file_.has("mesh/cells") && file_.has("fields/displacement")) {
      series("specimen", "mesh",
             {{"displacement", "fields/displacement", "Vector", "Node"},
              {"von_mises", "fields/von_mises", "Scalar", "Cell"},
              {"plastic_strain", "fields/plastic_strain", "Scalar", "Cell"}});
    }
    if (file_.has("surface/cells") && file_.has("dic/displacement")) {
      series("surface", "surface",
             {{"dic_displacement", "dic/displacement", "Vector", "Node"},
              {"residual_dic", "residual/element_dic", "Scalar", "Cell"},
              {"residual_model", "residual/element_model", "Scalar", "Cell"}});
    }
    for (const std::string face : {"", "front/", "back/"}) left_by_loop(face);
    return out_ + " </Domain>\n</Xdmf>\n";
  }

 private:
  struct Attribute {
    std::string name, dataset, type, centre;
  };

  /// What imic3d loop leaves of the displacement of a face.
  void left_by_loop(const std::string& face) {
    if (!file_.has(face + "loop/before/displacement")) return;
    std::vector<Attribute> attributes = {{"left_before", face + "loop/before/displacement", "Vector", "Node"},
                                         {"left_after", face + "loop/after/displacement", "Vector", "Node"}};
    if (file_.has(face + "loop/remainder/map"))
      attributes.push_back({"remainder", face + "loop/remainder/map", "Scalar", "Node"});
    series(face.empty() ? "surface" : face.substr(0, face.size() - 1), face + "surface", attributes);
  }

  void series(const std::string& name, const std::string& mesh, const std::vector<Attribute>& attributes) {
    out_ += fmt::format("  <Grid Name=\"{}\" GridType=\"Collection\" CollectionType=\"Temporal\">\n", name);
    for (std::size_t i = 0; i < numbers_.size(); ++i) {
      out_ += fmt::format("   <Grid Name=\"{} {}\" GridType=\"Uniform\">\n    <Time Value=\"{}\"/>\n", name,
                          numbers_[i], numbers_[i]);
      topology_and_geometry(mesh);
      for (const auto& attribute : attributes) add(attribute, i);
      out_ += "   </Grid>\n";
    }
    out_ += "  </Grid>\n";
  }

  void topology_and_geometry(const std::string& mesh) {
    // Viewers differ in the order of a hexahedron's middle nodes: quadratic cells are shown by their corners.
    const std::string topology = mesh + (file_.has(mesh + "/corners") ? "/corners" : "/cells");
    const auto cells = file_.shape(topology);
    out_ += fmt::format("    <Topology TopologyType=\"{}\" NumberOfElements=\"{}\">\n{}    </Topology>\n",
                        cells[1] == 8 ? "Hexahedron" : "Quadrilateral", cells[0],
                        item(topology, "NumberType=\"Int\" Precision=\"4\"", "     "));
    out_ +=
        fmt::format("    <Geometry GeometryType=\"XYZ\">\n{}    </Geometry>\n", item(mesh + "/nodes", real, "     "));
  }

  void add(const Attribute& attribute, std::size_t frame) {
    const auto shape = file_.shape(attribute.dataset);
    const std::vector<std::size_t> row(shape.begin() + 1, shape.end());
    std::vector<std::size_t> start(shape.size(), 0), stride(shape.size(), 1), count = shape;
    start[0] = frame;
    count[0] = 1;
    out_ += fmt::format(
        "    <Attribute Name=\"{}\" AttributeType=\"{}\" Center=\"{}\">\n"
        "     <DataItem ItemType=\"HyperSlab\" Dimensions=\"{}\" NumberType=\"Float\" Precision=\"8\">\n"
        "      <DataItem Dimensions=\"3 {}\" NumberType=\"Int\" Format=\"XML\">{} {} {}</DataItem>\n{}"
        "     </DataItem>\n    </Attribute>\n",
        attribute.name, attribute.type, attribute.centre, fmt::join(row, " "), shape.size(), fmt::join(start, " "),
        fmt::join(stride, " "), fmt::join(count, " "), item(attribute.dataset, real, "      "));
  }

  std::string item(const std::string& dataset, const std::string& type, const std::string& indent) {
    return fmt::format("{}<DataItem Format=\"HDF\" {} Dimensions=\"{}\">{}:/{}</DataItem>\n", indent, type,
                       fmt::join(file_.shape(dataset), " "), file_.path().filename().string(), dataset);
  }

  static constexpr const char* real = "NumberType=\"Float\" Precision=\"8\"";
  const ResultsFile& file_;
  std::vector<int> numbers_;
  std::string out_;
};

}  // namespace

void write_xdmf(const ResultsFile& file, const std::filesystem::path& path) {
  write_text_file(path, XdmfWriter(file).text());
}

}  // namespace imic3d::io
