#pragma once
// All effects, in the order in which their parameters follow those of the law.

#include <array>
#include <cstddef>

#include "imic3d/material/effects/damage.hpp"
#include "imic3d/material/effects/heating.hpp"
#include "imic3d/material/effects/hill48.hpp"
#include "imic3d/material/effects/johnson_cook_rate.hpp"
#include "imic3d/material/effects/kinematic_hardening.hpp"
#include "imic3d/material/effects/plateau.hpp"
#include "imic3d/material/effects/power_term.hpp"
#include "imic3d/material/effects/pressure.hpp"
#include "imic3d/material/effects/viscosity.hpp"
#include "imic3d/material/effects/voce_term.hpp"

namespace imic3d::material::effects {

enum class Effect : std::size_t {
  kinematic,
  kinematic_2,
  kinematic_3,
  hill,
  viscosity,
  rate,
  heating,
  voce_term,
  plateau,
  damage,
  pressure,
  voce_term_2,
  power_term
};

struct Entry {
  const char* name;
  const char* summary;
  std::vector<ParameterInfo> (*parameters)();
};

template <class E>
constexpr Entry entry() {
  return {E::name, E::summary, E::parameters};
}

/// In the order of `Effect`.
inline constexpr std::array list = {entry<KinematicHardening<1>>(),
                                    entry<KinematicHardening<2>>(),
                                    entry<KinematicHardening<3>>(),
                                    entry<Hill48>(),
                                    entry<Viscosity>(),
                                    entry<JohnsonCookRate>(),
                                    entry<Heating>(),
                                    entry<VoceTerm<1>>(),
                                    entry<Plateau>(),
                                    entry<Damage>(),
                                    entry<Pressure>(),
                                    entry<VoceTerm<2>>(),
                                    entry<PowerTerm>()};

/// Which effects a law has, and where their parameters stand.
class Selection {
 public:
  Selection() { count_.fill(0), first_.fill(0); }
  /// Switches an effect on. Effects that are switched on must be placed by `place` afterwards.
  void add(Effect effect) {
    count_[static_cast<std::size_t>(effect)] =
        static_cast<int>(list[static_cast<std::size_t>(effect)].parameters().size());
  }
  [[nodiscard]] bool has(Effect effect) const { return count_[static_cast<std::size_t>(effect)] > 0; }
  /// Puts the parameters behind the `first` ones of the law.
  void place(int first) {
    for (std::size_t i = 0; i < list.size(); ++i) first_[i] = first, first += count_[i];
  }
  /// The effect's own parameters out of all of the law; empty if it is not switched on.
  template <Scalar T>
  [[nodiscard]] std::span<const T> of(Effect effect, std::span<const T> all) const {
    const auto i = static_cast<std::size_t>(effect);
    return all.subspan(static_cast<std::size_t>(first_[i]), static_cast<std::size_t>(count_[i]));
  }

 private:
  std::array<int, list.size()> first_, count_;
};

}  // namespace imic3d::material::effects
