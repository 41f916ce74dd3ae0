#include "loads_input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  imic3d::fuzz::loads(data, size);
  return 0;
}
