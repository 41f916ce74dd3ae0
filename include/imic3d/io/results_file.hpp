#pragma once
// An HDF5 file that stays readable when the program is killed.
//
// Everything is declared first: each dataset gets its final size, is allocated at once and filled with NaN (integers:
// 0). start() flushes that structure. From then on only numbers change, in place, so whatever moment the program is
// killed at, the file can be opened; a frame is whole if its group's `frames_done` says so. Others may read while it
// grows. For one rank only (the root), with data that have been gathered; serial use of the parallel HDF5.

#include <cstddef>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace imic3d::io {

/// How numbers are kept in the file; in memory they are doubles.
enum class Storage { real64, real32, integer };

class ResultsFile {
 public:
  /// A new, empty file; one that is there is replaced at start(), not before. Throws InputError if the file cannot be
  /// made.
  [[nodiscard]] static ResultsFile create(const std::filesystem::path& path);
  /// An existing file, for reading or for writing into its declared datasets. Throws InputError.
  [[nodiscard]] static ResultsFile open(const std::filesystem::path& path, bool writable = false);
  ResultsFile(ResultsFile&&) noexcept;
  ResultsFile& operator=(ResultsFile&&) noexcept;
  ~ResultsFile();

  // Before start(). Names are paths such as `fields/displacement`; groups are made as needed. Every dataset has the
  // attributes `unit` and `description`.
  void declare(const std::string& name, const std::vector<std::size_t>& shape, const std::string& unit,
               const std::string& description, Storage storage = Storage::real64);
  /// `frames_done` of a group: one integer a frame.
  void declare_frames_done(const std::string& group, std::size_t frames);
  /// Declares and writes at once. values: the product of the shape, last index fastest.
  void store(const std::string& name, const std::vector<std::size_t>& shape, std::span<const double> values,
             const std::string& unit, const std::string& description, Storage storage = Storage::real64);
  void store(const std::string& name, const std::vector<std::size_t>& shape, std::span<const int> values,
             const std::string& unit, const std::string& description);
  void store_text(const std::string& name, const std::string& text, const std::string& description);
  void store_texts(const std::string& name, const std::vector<std::string>& texts, const std::string& description);
  /// Ends the declarations: writes the structure to the disk. declare and store throw std::logic_error afterwards.
  void start();

  /// Overwrites all values, or row `index` of the first dimension. Throws std::invalid_argument on a wrong size.
  void write(const std::string& name, std::span<const double> values);
  void write(const std::string& name, std::size_t index, std::span<const double> values);
  /// Marks a frame of `group` whole (or not, before it is written again); all that was written before is in the file.
  void mark_done(const std::string& group, std::size_t frame, bool whole = true);

  [[nodiscard]] bool has(const std::string& name) const;
  /// Paths of all datasets, sorted.
  [[nodiscard]] std::vector<std::string> names() const;
  [[nodiscard]] std::vector<std::size_t> shape(const std::string& name) const;
  [[nodiscard]] std::string unit(const std::string& name) const;
  [[nodiscard]] std::string description(const std::string& name) const;
  [[nodiscard]] std::vector<double> read(const std::string& name) const;
  [[nodiscard]] std::vector<double> read(const std::string& name, std::size_t index) const;
  [[nodiscard]] std::vector<int> read_integers(const std::string& name) const;
  [[nodiscard]] std::string read_text(const std::string& name) const;
  [[nodiscard]] std::vector<std::string> read_texts(const std::string& name) const;
  /// Frames of `group` that are whole, ascending; none if the group has no frames.
  [[nodiscard]] std::vector<std::size_t> frames_done(const std::string& group) const;
  [[nodiscard]] const std::filesystem::path& path() const;

 private:
  struct Impl;
  explicit ResultsFile(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace imic3d::io
