#pragma once
// Pixels side by side: vectors of eight numbers, and loops compiled for several generations of processors.

#include <cstring>
#include <type_traits>

/// Before a function that shall use the vector units of the machine it runs on, though the program is built for any
/// x86-64: it is chosen when the program is loaded. What the versions compute differs by the rounding of fused
/// multiply-adds.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__AVX2__) && \
    !defined(__SANITIZE_ADDRESS__)
#define IMIC3D_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define IMIC3D_CLONES
#endif
#define IMIC3D_INLINE inline __attribute__((always_inline))

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpsabi"  // all of this is inlined

namespace imic3d {

inline constexpr int lanes = 8;
using Floats = float __attribute__((vector_size(4 * lanes)));
using Doubles = double __attribute__((vector_size(8 * lanes)));
template <class Real>
using Lanes = std::conditional_t<std::is_same_v<Real, float>, Floats, Doubles>;

/// Numbers of an array, in the precision of `Real`.
template <class Real = float, class Stored>
[[nodiscard]] IMIC3D_INLINE Lanes<Real> load(const Stored* from) {
  Lanes<Stored> values;
  std::memcpy(&values, from, sizeof values);
  return __builtin_convertvector(values, Lanes<Real>);
}
template <class Real>
IMIC3D_INLINE void store(const Lanes<Real>& values, Real* to) {
  std::memcpy(to, &values, sizeof values);
}
[[nodiscard]] IMIC3D_INLINE Doubles doubles(const Floats& values) { return __builtin_convertvector(values, Doubles); }
[[nodiscard]] IMIC3D_INLINE Doubles doubles(const Doubles& values) { return values; }
[[nodiscard]] IMIC3D_INLINE double total(const Floats& v) {
  double sum = 0.0;
  for (int l = 0; l < lanes; ++l) sum += static_cast<double>(v[l]);
  return sum;
}
[[nodiscard]] IMIC3D_INLINE double total(const Doubles& v) {
  double sum = 0.0;
  for (int l = 0; l < lanes; ++l) sum += v[l];
  return sum;
}

}  // namespace imic3d

#pragma GCC diagnostic pop
