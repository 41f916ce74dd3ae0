#pragma once
// A file that a run can go on from: numbers and texts by their names, whole or not there at all.

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::io {

class Checkpoint {
 public:
  /// Names are paths such as `stages/0/values`.
  /// kept as [columns, rows], last index fastest
  void put(const std::string& name, const Eigen::MatrixXd& matrix);
  void put(const std::string& name, double value) { put(name, Eigen::MatrixXd::Constant(1, 1, value)); }
  void put(const std::string& name, const std::string& text);
  [[nodiscard]] bool has(const std::string& name) const { return numbers_.contains(name) || texts_.contains(name); }
  /// These throw InputError if the name is not there.
  [[nodiscard]] const Eigen::MatrixXd& matrix(const std::string& name) const;
  [[nodiscard]] double number(const std::string& name) const { return matrix(name)(0, 0); }
  [[nodiscard]] int count(const std::string& name) const { return static_cast<int>(number(name)); }
  [[nodiscard]] const std::string& text(const std::string& name) const;
  /// Takes out everything whose name begins so.
  void erase(const std::string& beginning);
  /// From rank 0 to the others. Collective.
  void broadcast(const Communicator& world);

  /// Writes an HDF5 file beside `path`, flushes it to the disk and renames it: whatever happens, there is the old file
  /// or the new one. Throws InputError if it cannot be written; then the old one stays.
  void write(const std::filesystem::path& path) const;
  /// Throws InputError if the file is not a whole checkpoint (a sum over its contents is checked).
  [[nodiscard]] static Checkpoint read(const std::filesystem::path& path);

 private:
  [[nodiscard]] std::string sum() const;
  std::map<std::string, Eigen::MatrixXd> numbers_;
  std::map<std::string, std::string> texts_;
};

/// What the result of `imic3d identify`, or of `imic3d loop`, depends on, as hashes by the section of the case file:
/// its keys (not how they are written, and without `groups`) and the files that it names: mesh, load record,
/// calibrations and tables of points by their contents, images by number, name and size.
[[nodiscard]] std::map<std::string, std::string> fingerprint(const Case& test, bool of_loop = false);

}  // namespace imic3d::io
