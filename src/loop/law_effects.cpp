#include "imic3d/loop/law_effects.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace imic3d::loop {

namespace {
struct Words {
  const char *sentence, *confused_with, *separated_by;
  double mark = 1e-2;  // size at which its mark is taken, of the usual size
  const char* formula_for = "";
};
constexpr auto hardening_curve = "the hardening curve", rate_dependence = "the dependence on the rate";
const std::map<std::string, Words>& words() {
  static const std::map<std::string, Words> all = {
      {"kinematic",
       {"the material hardens kinematically (Bauschinger effect)", "H, S_y, force gain", "reverse yielding"}},
      {"kinematic_2",
       {"a second back-stress, with its own range of strain", "Voce term", "cycles of several amplitudes"}},
      {"kinematic_3",
       {"a third back-stress, with its own range of strain", "Voce term", "cycles of several amplitudes"}},
      {"hill",
       {"the material is plastically anisotropic (Hill 48)", "parallax, heating",
        "a second orientation, a second camera"}},
      {"viscosity",
       {"the material is viscous: a stress on top that grows with the rate", "rate, delay of the force",
        "a tenfold jump of the rate, a hold", 1e-2, rate_dependence}},
      {"rate",
       {"the yield stress depends on the strain rate", "viscosity, delay of the force",
        "a tenfold jump of the rate, a hold", 1e-2, rate_dependence}},
      {"heating",
       {"plastic work heats and softens the material", "Hill's ratios, Voce term, damage",
        "a thermometer; a slow test"}},
      {"voce_term",
       {"hardening that saturates is missing", "plateau, damage", "a longer range of strain", 1e-2, hardening_curve}},
      {"voce_term_2",
       {"the shape of isotropic hardening is not that of the law: one more term that saturates",
        "kinematic hardening, damage", "a longer range of strain; cycles", 1e-2, hardening_curve}},
      {"power_term",
       {"hardening by a power of the plastic strain is missing (Eq. 18 beside linear hardening)", "Voce term, plateau",
        "a longer range of strain", 1e-2, hardening_curve}},
      {"plateau",
       {"the material has a yield plateau (Lüders)", "Voce term", "the curve around first yield", 1.0,
        hardening_curve}},
      {"damage",
       {"the material softens with plastic strain (damage)", "heating, Voce term", "the stiffness on unloading"}},
      {"pressure",
       {"plastic flow depends on pressure: friction and dilatancy", "Hill's ratios",
        "compression beside tension; the change of volume"}}};
  return all;
}
}  // namespace

std::vector<Candidate> law_candidates(const std::vector<ParameterInfo>& information, const std::vector<char>& declared,
                                      int first) {
  std::vector<Candidate> candidates;
  for (std::size_t j = 0; j < information.size(); ++j) {
    const std::string& effect = information[j].effect;
    if (effect.empty() || declared[j] != 0) continue;
    auto found =
        std::find_if(candidates.begin(), candidates.end(), [&](const Candidate& c) { return c.name == effect; });
    if (found == candidates.end()) {
      const auto known = words().find(effect);
      const Words said = known != words().end() ? known->second : Words{"", "", ""};
      candidates.push_back({.name = effect,
                            .link = Link::material,
                            .parameters = {},
                            .sentence = said.sentence,
                            .confused_with = said.confused_with,
                            .separated_by = said.separated_by,
                            .after = effect == "kinematic_2"   ? "kinematic"
                                     : effect == "kinematic_3" ? "kinematic_2"
                                     : effect == "voce_term_2" ? "voce_term"
                                                               : "",
                            .formula_for = said.formula_for});
      found = candidates.end() - 1;
    }
    found->parameters.push_back(first + static_cast<int>(j));
  }
  return candidates;
}

Candidate poissons_ratio(int parameter) {
  return {.name = "Poisson's ratio",
          .link = Link::material,
          .parameters = {parameter},
          .sentence = "Poisson's ratio is not the declared one",
          .confused_with = "magnification drift, parallax",
          .separated_by = "a second camera; a handbook value",
          .after = {}};
}

Parameter at_null(ParameterInfo info, double rate) {
  if (rate > 0.0 && info.effect == "rate" && info.shape)
    info.null_value = info.scale = std::clamp(rate, info.lower, info.upper);
  const double value = info.null_value.value_or(0.0);
  // A short plateau is a shift along the curve, which the law's own parameters absorb: a usual one is not.
  const auto known = words().find(info.effect);
  const double mark = known != words().end() ? known->second.mark : 1e-2;
  return {.info = info,
          .value = value,
          .step = mark * (info.scale > 0.0 ? info.scale : std::max(1e-3, std::abs(value))),
          .prior = 0.0,
          .free = false};
}

}  // namespace imic3d::loop
