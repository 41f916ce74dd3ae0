#pragma once
// Case files, beside a mesh, a load record, a curve and images that they may name.

#include <limits>

#include "imic3d/imaging/image.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "input_file.hpp"

namespace imic3d::fuzz {

inline io::CaseChecks checks_of_case() {
  return {.parameters_of =
              [](const io::MaterialCase&) {
                return std::vector<ParameterInfo>{{"E", "MPa", "", 1.0, 1e7, {}},
                                                  {"nu", "-", "", 0.0, 0.499, {}},
                                                  {"S_y", "MPa", "", 1e-3, std::numeric_limits<double>::infinity(), {}},
                                                  {"H", "MPa", "", 0.0, 1e6, {}},
                                                  {"delta", "-", "", 1e-6, 1.0, {}}};
              },
          .read_mesh = [](const std::filesystem::path& file) { return mesh::read(file); },
          .effects =
              [](const io::Case&) {
                return std::map<std::string, std::vector<std::string>>{{"force_zero", {"force_offset"}},
                                                                       {"taper", {"taper_x", "taper_y"}}};
              },
          .sections = {},
          .images = true,
          .fields = true};
}

inline void write_what_a_case_names() {
  write("plate.msh",
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n1 1 \"bottom\"\n1 2 \"top\"\n$EndPhysicalNames\n"
        "$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n$EndNodes\n"
        "$Elements\n3\n1 1 2 1 1 1 2\n2 1 2 2 2 3 4\n3 3 2 0 1 1 2 3 4\n$EndElements\n");
  write("loads.csv", "frame,t_s,F_N,image_file\n0,0,0,frame_0.png\n1,1,100,frame_1.png\n2,2,200,frame_2.png\n");
  write("curve.csv", "strain,stress\n0,0\n0.001,200\n0.002,300\n");
  for (const char* name : {"frame_0.png", "frame_1.png", "frame_2.png"})
    imaging::write_image(imaging::Image(8, 8), folder() / name);
}

inline void case_file(const std::uint8_t* data, std::size_t size) {
  static const io::CaseChecks checks = [] {
    write_what_a_case_names();
    return checks_of_case();
  }();
  const auto file = write("case.yaml", data, size);
  expect_result_or_input_error([&] { (void)io::read_case(file, checks); });
}

}  // namespace imic3d::fuzz
