#pragma once
// PETSc error codes become exceptions.

#include <petscsys.h>

#include <stdexcept>
#include <string>

namespace imic3d::mechanics {

/// Throws std::runtime_error with PETSc's own text if `code` is not zero.
inline void petsc(PetscErrorCode code) {
  if (code == 0) return;
  const char* text = nullptr;
  PetscErrorMessage(code, &text, nullptr);
  throw std::runtime_error(std::string("PETSc: ") + (text != nullptr ? text : "unknown error"));
}

}  // namespace imic3d::mechanics
