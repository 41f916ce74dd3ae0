#pragma once
// How the program says that something is wrong, and with which exit status it ends.

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace imic3d {

/// Exit status of every command.
enum class ExitStatus : int { done = 0, internal_error = 1, bad_input = 2, not_converged = 3, can_be_resumed = 4 };

/// One mistake in the input: where it stands, what was found there and what is allowed.
struct Mistake {
  std::string place;    ///< e.g. `case.yaml:12 specimen.thickness` or `loads.csv:17 column "F_N"`
  std::string found;    ///< e.g. `-8`
  std::string allowed;  ///< e.g. `a positive number [mm]`

  /// `place: found …; allowed: …` on one line.
  [[nodiscard]] std::string message() const;
};

/// Bad input, with everything that is wrong with it (exit status 2).
class InputError : public std::runtime_error {
 public:
  explicit InputError(std::vector<Mistake> mistakes);
  InputError(std::string place, std::string found, std::string allowed);
  [[nodiscard]] const std::vector<Mistake>& mistakes() const { return mistakes_; }

 private:
  std::vector<Mistake> mistakes_;
};

/// A computation that did not converge (exit status 3); what was computed before is kept.
class ConvergenceError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace imic3d
