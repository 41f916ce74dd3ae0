// Files that once made the readers of meshes fail in another way than with an InputError (tests/fuzz).
#include <gtest/gtest.h>

#include "../fuzz/mesh_input.hpp"

namespace imic3d {
namespace test_found {

TEST(Found, MeshesGiveAResultOrAnInputError) {
  int files = 0;
  fuzz::for_each_found(IMIC3D_SOURCE_DIRECTORY "/tests/fuzz/found/mesh",
                       [&](const std::string& name, const std::uint8_t* data, std::size_t size) {
                         EXPECT_NO_THROW(fuzz::mesh(data, size)) << name;
                         ++files;
                       });
  EXPECT_GE(files, 7);
}

}  // namespace test_found
}  // namespace imic3d
