#pragma once
// Eigenvalues of symmetric tensors, and the logarithm and exponential built on them with their derivatives.

#include <array>

#include "imic3d/material/tensor.hpp"

namespace imic3d::material {

/// A = sum_a values[a] N_a (x) N_a; the columns of `vectors` are the orthonormal N_a. Values are not sorted.
struct SpectralDecomposition {
  std::array<double, 3> values;
  Tensor<double> vectors;
};

/// Cyclic Jacobi rotations: error of a few units in the last place of |A|, also for equal and nearly equal values.
[[nodiscard]] SpectralDecomposition spectral_decomposition(const SymmetricTensor<double>& A) noexcept;

/// Divided differences of the natural logarithm at the eigenvalues x_a = 1 + y_a, to about 1e-13 relative, however
/// close the eigenvalues are.
namespace divided_difference {
/// (ln x_a - ln x_b) / (x_a - x_b), 1/x_a where they are equal.
[[nodiscard]] double logarithm(double x_a, double x_b) noexcept;
/// (ln[x_a,x_b] - ln[x_b,x_c]) / (x_a - x_c), symmetric in its three arguments; -1/(2 x_a^2) where they are equal.
[[nodiscard]] double logarithm(double x_a, double x_b, double x_c) noexcept;
/// (exp z_a - exp z_b) / (z_a - z_b), exp z_a where they are equal.
[[nodiscard]] double exponential(double z_a, double z_b) noexcept;
}  // namespace divided_difference

/// E = 1/2 ln C and what follows from it at one elastic deformation, C = Fe^T Fe = I + B.
///
/// In the eigenbasis of C (values x_a), with first and second divided differences of ln, ln[ab] and ln[abc]:
///   (dE/dC : A)_ab            = 1/2 ln[ab] A_ab
///   T : d2E/dC2 : (A, B)      = sum_abc T_ab ln[abc] A_ac B_cb        (T symmetric)
/// Miehe, Apel, Lambrecht (2002), Comput. Methods Appl. Mech. Engrg. 191, and Ball (1984) for the isotropic functions.
class LogarithmicStrain {
 public:
  /// B = C - I with positive definite C.
  explicit LogarithmicStrain(const SymmetricTensor<double>& B) noexcept;

  /// False where C is not positive definite or not finite.
  [[nodiscard]] bool valid() const noexcept { return valid_; }

  /// E = 1/2 ln(I + B); the values of B are those of the constructor.
  template <Scalar T>
  [[nodiscard]] SymmetricTensor<T> strain(const SymmetricTensor<T>& B) const noexcept;

  /// Second Piola-Kirchhoff stress of the intermediate configuration, S = T : 2 dE/dC.
  template <Scalar T>
  [[nodiscard]] SymmetricTensor<T> second_piola(const SymmetricTensor<T>& B,
                                                const SymmetricTensor<T>& stress) const noexcept;

  /// Spatial tangent (Lie derivative of the Kirchhoff stress per rate of deformation with engineering shears).
  /// Fe: elastic deformation gradient; stress: T; material_tangent: A = dT/dE with engineering shears.
  [[nodiscard]] Matrix6 spatial_tangent(const Tensor<double>& Fe, const SymmetricTensor<double>& stress,
                                        const Matrix6& material_tangent) const noexcept;

 private:
  [[nodiscard]] SymmetricTensor<double> scaled_in_eigenbasis(const SymmetricTensor<double>& A,
                                                             double factor) const noexcept;
  [[nodiscard]] SymmetricTensor<double> curvature(const SymmetricTensor<double>& stress,
                                                  const SymmetricTensor<double>& dB) const noexcept;
  void second_differences(std::array<double, 10>& f) const noexcept;

  SpectralDecomposition spectrum_;   // of B
  SymmetricTensor<double> first_;    // ln[ab]
  std::array<double, 3> principal_;  // 1/2 ln x_a
  bool valid_ = false;
};

/// exp(A) - I of a symmetric tensor, with derivatives where T is a dual number. Without the identity, so that rounding
/// is relative to the increment and the plastic volume does not drift over many steps.
template <Scalar T>
[[nodiscard]] SymmetricTensor<T> exponential_minus_identity(const SymmetricTensor<T>& A) noexcept;

// ---------------------------------------------------------------------------------------------------------------------

template <Scalar T>
SymmetricTensor<T> LogarithmicStrain::strain(const SymmetricTensor<T>& B) const noexcept {
  const SymmetricTensor<double> E = push_forward(
      spectrum_.vectors, SymmetricTensor<double>{{principal_[0], principal_[1], principal_[2], 0.0, 0.0, 0.0}});
  if constexpr (derivatives_of<T> == 0) {
    return E;
  } else {
    SymmetricTensor<T> result;
    for (int i = 0; i < 6; ++i) result[i].value = E[i];
    for (int k = 0; k < derivatives_of<T>; ++k) {
      const SymmetricTensor<double> dE = scaled_in_eigenbasis(derivatives(B, k), 0.5);
      for (int i = 0; i < 6; ++i) result[i].derivative[static_cast<std::size_t>(k)] = dE[i];
    }
    return result;
  }
}

template <Scalar T>
SymmetricTensor<T> LogarithmicStrain::second_piola(const SymmetricTensor<T>& B,
                                                   const SymmetricTensor<T>& stress) const noexcept {
  const SymmetricTensor<double> stress_value = values(stress);
  const SymmetricTensor<double> S = scaled_in_eigenbasis(stress_value, 1.0);
  if constexpr (derivatives_of<T> == 0) {
    return S;
  } else {
    SymmetricTensor<T> result;
    for (int i = 0; i < 6; ++i) result[i].value = S[i];
    for (int k = 0; k < derivatives_of<T>; ++k) {
      const SymmetricTensor<double> dS =
          scaled_in_eigenbasis(derivatives(stress, k), 1.0) + curvature(stress_value, derivatives(B, k));
      for (int i = 0; i < 6; ++i) result[i].derivative[static_cast<std::size_t>(k)] = dS[i];
    }
    return result;
  }
}

namespace detail {
/// exp(A) - I, and D exp(A) : dA for each of the given directions, in place.
void exponential_minus_identity(const SymmetricTensor<double>& A, SymmetricTensor<double>& result,
                                SymmetricTensor<double>* directions, int count) noexcept;
}  // namespace detail

template <Scalar T>
SymmetricTensor<T> exponential_minus_identity(const SymmetricTensor<T>& A) noexcept {
  constexpr int N = derivatives_of<T>;
  SymmetricTensor<double> value_of_result;
  std::array<SymmetricTensor<double>, N> directions;
  if constexpr (N > 0)
    for (int k = 0; k < N; ++k) directions[static_cast<std::size_t>(k)] = derivatives(A, k);
  detail::exponential_minus_identity(values(A), value_of_result, directions.data(), N);
  if constexpr (N == 0) {
    return value_of_result;
  } else {
    SymmetricTensor<T> result;
    for (int i = 0; i < 6; ++i) {
      result[i].value = value_of_result[i];
      for (std::size_t k = 0; k < N; ++k) result[i].derivative[k] = directions[k][i];
    }
    return result;
  }
}

}  // namespace imic3d::material
