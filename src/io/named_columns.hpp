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
    std::vector<std::string> text;  ///< the columns in their order, at first those that have to be there
  };
  std::filesystem::path file;
  std::vector<std::string> columns;
  std::vector<Row> rows;
  std::vector<Mistake> mistakes;  ///< at first of lines that are no rows
  char separator = ',';

  /// Nothing where the field is no number.
  [[nodiscard]] std::optional<double> number(const Row& row, std::size_t column) const;

  /// One more mistake. `found`: else what the field holds.
  void mistake(const Row& row, std::size_t column, std::string allowed, std::string found = {});

  /// Throws InputError with the first mistakes, if there are any; the rest is counted.
  void refuse() const;
};

/// Reads a table separated by comma, semicolon, tab or else blanks. The header is the first line that names all the
/// columns `wanted`; `welcome` may be absent. Empty lines, those that begin with # and a row of units in brackets below
/// the header are passed over. Throws InputError if the file cannot be read or no line is the header; `kind`: what the
/// file should be.
[[nodiscard]] NamedColumns read_named_columns(const std::filesystem::path& file, const std::vector<std::string>& wanted,
                                              const std::string& kind, const std::vector<std::string>& welcome = {});

}  // namespace imic3d::io
