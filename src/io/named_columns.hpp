#pragma once
// Tables whose header may stand below what a laboratory wrote before it.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::io {

/// Columns of a table as text; "" where a row has no such field.
struct NamedColumns {
  struct Row {
    int line = 0;
    std::vector<std::string> text;  ///< as many as were wanted, in their order
  };
  std::filesystem::path file;
  std::vector<std::string> wanted;
  std::vector<Row> rows;
  char separator = ',';

  /// Nothing where the field is no number.
  [[nodiscard]] std::optional<double> number(const Row& row, std::size_t column) const;

  [[nodiscard]] Mistake mistake(const Row& row, std::size_t column, std::string allowed) const;
};

/// Reads a table separated by comma, semicolon or tab. The header is the first line that names all the columns. Empty lines, those that begin with # and a row of
/// units in brackets below the header are passed over. Throws InputError if the file cannot be read or no line names the columns; `kind`: what the file should be.
[[nodiscard]] NamedColumns read_named_columns(const std::filesystem::path& file, const std::vector<std::string>& wanted, const std::string& kind);

/// Throws InputError with the first mistakes of a file, if there are any.
void refuse(std::vector<Mistake> mistakes);

}  // namespace imic3d::io
