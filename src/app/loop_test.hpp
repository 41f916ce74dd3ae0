#pragma once
// A test that imic3d loop works on, whatever was measured.

#include <functional>
#include <memory>

#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/core/parallel.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/loop/closing.hpp"

namespace imic3d::app {

/// What the identified model leaves is told, or looked into.
enum class Aim { identify, close_the_loop };

class LoopTest {
 public:
  virtual ~LoopTest() = default;
  [[nodiscard]] virtual loop::Experiment& experiment() = 0;
  /// Places of the frames that are held out: those that the case names, else for a search what is chosen.
  [[nodiscard]] virtual std::vector<int> held_out() const = 0;
  /// Simulations made so far.
  [[nodiscard]] virtual int simulations() const = 0;
  /// What groups of ranks did with their time. Collective.
  [[nodiscard]] virtual GroupTimes group_times() const { return {}; }
  /// Leaves results.h5, result.json, report.html and what they show in the folder, and prints the verdict. Collective.
  virtual void write(const std::filesystem::path& folder, const loop::Report& report, double seconds) = 0;
};

/// imic3d identify of displacement fields, of several tests, and with effects that the case declares: all free
/// parameters at once, in the weights that imic3d loop gives the data, and what the model leaves beside what noise
/// leaves. Collective.
void identify_by_loop(const Communicator& world, const CommandOptions& options, const io::Case& test);

/// Images, correlated, whose light has been looked at, or displacement fields. `world` outlives it. Collective.
[[nodiscard]] std::unique_ptr<LoopTest> make_field_test(const Communicator& world, const io::Case& test, Aim aim,
                                                        const std::function<void(const std::string&)>& say);
/// Stress-strain curves of bars. `world` and `test` outlive it.
[[nodiscard]] std::unique_ptr<LoopTest> make_curve_test(const Communicator& world, const io::Case& test, Aim aim);

}  // namespace imic3d::app
