#pragma once
// PETSc calls whose errors are exceptions, and PETSc objects that are destroyed at the end of their scope.

#include <petsclog.h>
#include <petscsys.h>

#include <stdexcept>
#include <string>
#include <utility>

namespace imic3d {

/// Throws std::runtime_error with PETSc's message if `code` is an error.
inline void check_petsc(PetscErrorCode code, const char* call, const char* file, int line) {
  if (code == 0) return;
  const char* text = nullptr;
  PetscErrorMessage(code, &text, nullptr);
  throw std::runtime_error(std::string("PETSc error ") + std::to_string(static_cast<int>(code)) + " (" +
                           (text != nullptr ? text : "unknown") + ") in " + call + ", " + file + ":" +
                           std::to_string(line));
}

/// Owns a PETSc object: `PetscOwner<Mat, MatDestroy> matrix; IMIC3D_PETSC(MatCreate(comm, matrix.put()));`
template <class Object, PetscErrorCode (*destroy)(Object*)>
class PetscOwner {
 public:
  PetscOwner() = default;
  ~PetscOwner() { reset(); }
  PetscOwner(const PetscOwner&) = delete;
  PetscOwner& operator=(const PetscOwner&) = delete;
  PetscOwner(PetscOwner&& other) noexcept : object_(std::exchange(other.object_, nullptr)) {}
  PetscOwner& operator=(PetscOwner&& other) noexcept {
    if (this != &other) {
      reset();
      object_ = std::exchange(other.object_, nullptr);
    }
    return *this;
  }
  [[nodiscard]] Object get() const { return object_; }
  operator Object() const { return object_; }  // NOLINT(google-explicit-constructor): a PETSc object in every call
  /// For a call that creates the object; what was held before is destroyed.
  [[nodiscard]] Object* put() {
    reset();
    return &object_;
  }
  void reset() {
    if (object_ != nullptr) (void)destroy(&object_);
    object_ = nullptr;
  }

 private:
  Object object_ = nullptr;
};

/// A piece of work whose time is in PETSc's log (-log_view) under a name, while an object of this lives.
class LoggedEvent {
 public:
  explicit LoggedEvent(PetscLogEvent event) : event_(event) {
    (void)PetscLogEventBegin(event_, nullptr, nullptr, nullptr, nullptr);
  }
  ~LoggedEvent() { (void)PetscLogEventEnd(event_, nullptr, nullptr, nullptr, nullptr); }
  LoggedEvent(const LoggedEvent&) = delete;
  LoggedEvent& operator=(const LoggedEvent&) = delete;
  /// The event of a name, the same one for the same name.
  [[nodiscard]] static PetscLogEvent named(const char* name) {
    PetscLogEvent event = -1;
    if (PetscLogEventGetId(name, &event) != 0 || event < 0)
      (void)PetscLogEventRegister(name, PETSC_OBJECT_CLASSID, &event);
    return event;
  }

 private:
  PetscLogEvent event_;
};

}  // namespace imic3d

/// A PETSc call that throws std::runtime_error if it fails (PETSc 3.18 has no PetscCallThrow).
#define IMIC3D_PETSC(call) ::imic3d::check_petsc((call), #call, __FILE__, __LINE__)
