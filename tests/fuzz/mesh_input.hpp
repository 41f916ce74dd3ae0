#pragma once
// Mesh files: the first byte says which format (even: Gmsh, odd: Abaqus).

#include "imic3d/mesh/mesh.hpp"
#include "input_file.hpp"

namespace imic3d::fuzz {

inline void mesh(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return;
  const auto file = write(data[0] % 2 == 0 ? "mesh.msh" : "mesh.inp", data + 1, size - 1);
  expect_result_or_input_error([&] {
    const auto mesh = mesh::read(file);
    if (mesh.cells.rows() > 2000) return;
    if (mesh.type == mesh::CellType::quad4 || mesh.front.rows() > 0) (void)mesh::front_surface(mesh);
    if (mesh.type == mesh::CellType::quad4) (void)mesh::contours(mesh);
    (void)mesh::quadratic(mesh);
  });
}

}  // namespace imic3d::fuzz
