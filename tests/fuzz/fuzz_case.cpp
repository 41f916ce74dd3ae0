#include "case_input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  imic3d::fuzz::case_file(data, size);
  return 0;
}
