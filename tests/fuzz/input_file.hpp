#pragma once
// What the fuzzers share: their input as a file, since that is what the readers take.

#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "imic3d/core/error.hpp"

namespace imic3d::fuzz {

/// A folder of this process (in TMPDIR: /dev/shm spares the disk), removed at its end.
inline const std::filesystem::path& folder() {
  struct Folder {
    Folder() { std::filesystem::create_directories(path); }
    ~Folder() { std::filesystem::remove_all(path); }
    std::filesystem::path path = std::filesystem::temp_directory_path() / ("imic3d_fuzz_" + std::to_string(::getpid()));
  };
  static const Folder made;
  return made.path;
}

inline std::filesystem::path write(const std::string& name, const void* data, std::size_t size) {
  const auto file = folder() / name;
  std::ofstream(file, std::ios::binary).write(static_cast<const char*>(data), static_cast<std::streamsize>(size));
  return file;
}
inline std::filesystem::path write(const std::string& name, const std::string& text) {
  return write(name, text.data(), text.size());
}

/// The inputs that were found once: every file of tests/fuzz/found/KIND.
template <class Read>
void for_each_found(const std::filesystem::path& found, const Read& read) {
  for (const auto& entry : std::filesystem::directory_iterator(found)) {
    std::ifstream stream(entry.path(), std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(stream)), {});
    read(entry.path().filename().string(), reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
  }
}

/// Bad input is to give an InputError; any other exception ends the fuzzer as a finding.
template <class Read>
void expect_result_or_input_error(const Read& read) {
  try {
    read();
  } catch (const InputError&) {
  }
}

}  // namespace imic3d::fuzz
