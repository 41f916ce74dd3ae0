#pragma once
// What can be said of a case of imic3d loop before anything is correlated or simulated.

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "imic3d/app/setup.hpp"

namespace imic3d::app {

/// The work, whose mistakes are added with the file before their places.
void collect(std::vector<Mistake>& mistakes, const std::filesystem::path& file, const std::function<void()>& work);

/// Throws InputError: candidates left out that no test has, cameras and laws that the loop does not take.
void check_loop_case(const io::Case& test);

/// The cases of the tests, read and checked together; `also` is called for each, and says what is wrong with an
/// InputError. Throws InputError that names every mistake of all.
[[nodiscard]] std::vector<io::Case> cases_of_tests(const io::Case& all, const CommandOptions& options,
                                                   const std::function<void(const io::Case&)>& also = {});

/// Candidates that a test may have; its data decide whether it has all of them (whether the specimen is unloaded).
[[nodiscard]] std::vector<std::string> possible_candidates(const io::Case& test);

}  // namespace imic3d::app
