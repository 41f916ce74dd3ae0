#pragma once
// Second-order tensors of numbers or dual numbers, as the laws use them.

#include <array>
#include <cmath>
#include <cstddef>

#include "imic3d/material/dual.hpp"
#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::material {

/// Position of component ij in a symmetric tensor: order 11, 22, 33, 12, 23, 13.
inline constexpr int symmetric_index[3][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}};
/// Row and column of each of the six components.
inline constexpr int symmetric_row[6] = {0, 1, 2, 0, 1, 0};
inline constexpr int symmetric_column[6] = {0, 1, 2, 1, 2, 2};

/// A symmetric second-order tensor by its six tensor components (not engineering shears): 11, 22, 33, 12, 23, 13.
template <Scalar T>
struct SymmetricTensor {
  std::array<T, 6> components;

  T& operator[](int i) { return components[static_cast<std::size_t>(i)]; }
  const T& operator[](int i) const { return components[static_cast<std::size_t>(i)]; }
  T& operator()(int i, int j) { return (*this)[symmetric_index[i][j]]; }
  const T& operator()(int i, int j) const { return (*this)[symmetric_index[i][j]]; }

  static SymmetricTensor zero() {
    SymmetricTensor A;
    A.components.fill(T(0.0));
    return A;
  }
  static SymmetricTensor identity() {
    SymmetricTensor A = zero();
    for (int i = 0; i < 3; ++i) A[i] = T(1.0);
    return A;
  }
  SymmetricTensor& operator+=(const SymmetricTensor& B) {
    for (int i = 0; i < 6; ++i) (*this)[i] += B[i];
    return *this;
  }
};

template <Scalar T>
SymmetricTensor<T> operator+(const SymmetricTensor<T>& A, const SymmetricTensor<T>& B) {
  SymmetricTensor<T> C;
  for (int i = 0; i < 6; ++i) C[i] = A[i] + B[i];
  return C;
}
template <Scalar T>
SymmetricTensor<T> operator-(const SymmetricTensor<T>& A, const SymmetricTensor<T>& B) {
  SymmetricTensor<T> C;
  for (int i = 0; i < 6; ++i) C[i] = A[i] - B[i];
  return C;
}
template <Scalar T>
SymmetricTensor<T> operator*(const T& factor, const SymmetricTensor<T>& A) {
  SymmetricTensor<T> B;
  for (int i = 0; i < 6; ++i) B[i] = factor * A[i];
  return B;
}
template <Scalar T>
requires(!std::same_as<T, double>) SymmetricTensor<T>
operator*(double factor, const SymmetricTensor<T>& A) {
  SymmetricTensor<T> B;
  for (int i = 0; i < 6; ++i) B[i] = factor * A[i];
  return B;
}

template <Scalar T>
T trace(const SymmetricTensor<T>& A) {
  return A[0] + A[1] + A[2];
}

template <Scalar T>
SymmetricTensor<T> deviator(const SymmetricTensor<T>& A) {
  const T mean = trace(A) / 3.0;
  return {{A[0] - mean, A[1] - mean, A[2] - mean, A[3], A[4], A[5]}};
}

/// A : B
template <Scalar T>
T double_dot(const SymmetricTensor<T>& A, const SymmetricTensor<T>& B) {
  return A[0] * B[0] + A[1] * B[1] + A[2] * B[2] + 2.0 * (A[3] * B[3] + A[4] * B[4] + A[5] * B[5]);
}

/// Adds a multiple of the identity.
template <Scalar T>
SymmetricTensor<T> add_spherical(SymmetricTensor<T> A, const T& pressure) {
  for (int i = 0; i < 3; ++i) A[i] += pressure;
  return A;
}

/// Values alone, and the derivatives in one direction.
template <Scalar T>
SymmetricTensor<double> values(const SymmetricTensor<T>& A) {
  SymmetricTensor<double> B;
  for (int i = 0; i < 6; ++i) B[i] = value(A[i]);
  return B;
}
template <int N>
SymmetricTensor<double> derivatives(const SymmetricTensor<Dual<N>>& A, int direction) {
  SymmetricTensor<double> B;
  for (int i = 0; i < 6; ++i) B[i] = A[i].derivative[static_cast<std::size_t>(direction)];
  return B;
}

/// A second-order tensor, by rows.
template <Scalar T>
struct Tensor {
  std::array<T, 9> components;

  T& operator()(int i, int j) { return components[static_cast<std::size_t>(3 * i + j)]; }
  const T& operator()(int i, int j) const { return components[static_cast<std::size_t>(3 * i + j)]; }
};

template <Scalar T>
Tensor<T> operator*(const Tensor<T>& A, const Tensor<T>& B) {
  Tensor<T> C;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) C(i, j) = A(i, 0) * B(0, j) + A(i, 1) * B(1, j) + A(i, 2) * B(2, j);
  return C;
}
template <Scalar T>
Tensor<T> operator*(const Tensor<T>& A, const SymmetricTensor<T>& B) {
  Tensor<T> C;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) C(i, j) = A(i, 0) * B(0, j) + A(i, 1) * B(1, j) + A(i, 2) * B(2, j);
  return C;
}

template <Scalar T>
T determinant(const Tensor<T>& A) {
  return A(0, 0) * (A(1, 1) * A(2, 2) - A(1, 2) * A(2, 1)) - A(0, 1) * (A(1, 0) * A(2, 2) - A(1, 2) * A(2, 0)) +
         A(0, 2) * (A(1, 0) * A(2, 1) - A(1, 1) * A(2, 0));
}

/// A S A^T
template <Scalar T>
SymmetricTensor<T> push_forward(const Tensor<T>& A, const SymmetricTensor<T>& S) {
  const Tensor<T> AS = A * S;
  SymmetricTensor<T> B;
  for (int k = 0; k < 6; ++k) {
    const int i = symmetric_row[k], j = symmetric_column[k];
    B[k] = AS(i, 0) * A(j, 0) + AS(i, 1) * A(j, 1) + AS(i, 2) * A(j, 2);
  }
  return B;
}

/// A^T S A
template <Scalar T>
SymmetricTensor<T> pull_back(const Tensor<T>& A, const SymmetricTensor<T>& S) {
  const Tensor<T> transposed{{A(0, 0), A(1, 0), A(2, 0), A(0, 1), A(1, 1), A(2, 1), A(0, 2), A(1, 2), A(2, 2)}};
  return push_forward(transposed, S);
}

/// A^T A - I, without the loss of digits of forming A^T A first where A is near the identity.
template <Scalar T>
SymmetricTensor<T> cauchy_green_minus_identity(const Tensor<T>& A) {
  Tensor<T> H = A;
  for (int i = 0; i < 3; ++i) H(i, i) -= 1.0;
  SymmetricTensor<T> B;
  for (int k = 0; k < 6; ++k) {
    const int i = symmetric_row[k], j = symmetric_column[k];
    B[k] = H(i, j) + H(j, i) + (H(0, i) * H(0, j) + H(1, i) * H(1, j) + H(2, i) * H(2, j));
  }
  return B;
}

}  // namespace imic3d::material
