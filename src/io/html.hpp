#pragma once
// What the pages share: their style, embedded pictures, numbers as text.

#include <string>

namespace imic3d::io {

extern const char* const page_style;  ///< CSS

[[nodiscard]] std::string base64(const std::string& bytes);

/// A number with `digits` significant ones; a dash for NaN.
[[nodiscard]] std::string shown(double value, int digits = 5);

/// A value as far as its standard deviation lets it be known: two digits of that.
[[nodiscard]] std::string shown_with(double value, double deviation);

}  // namespace imic3d::io
