#pragma once
// The encoding of text files.

#include <string>
#include <string_view>

namespace imic3d::io {

/// Place of the first byte that does not belong to UTF-8 (RFC 3629), or the end.
[[nodiscard]] std::size_t first_foreign_byte(std::string_view text);

/// The text in UTF-8; what is not is taken for Latin-1 (ISO 8859-1), as testing machines write it.
[[nodiscard]] std::string in_utf8(std::string text);

}  // namespace imic3d::io
