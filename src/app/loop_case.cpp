#include "loop_case.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <span>

#include "imic3d/loop/law_effects.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

/// Candidates that are left out are of those that there may be, in several tests with the test's name; which there are
/// is known when the data are read.
std::vector<Mistake> unknown_candidates(const std::vector<std::string>& leave_out, std::span<const io::Case> cases,
                                        const std::vector<io::TestCase>& tests) {
  std::vector<std::string> known = material::known_effects();
  const auto add = [&](const std::string& name) {
    if (tests.empty()) known.push_back(name);
    for (const auto& test : tests) known.push_back(loop::key_of(name + " (" + test.name + ")"));
  };
  add("Poisson's_ratio");
  std::map<std::string, std::vector<std::string>> effects;
  for (const auto& one : cases) effects.merge(effect_quantities(one));
  for (const auto& [effect, quantities] : effects) add(effect);
  std::vector<Mistake> mistakes;
  for (const auto& name : leave_out)
    if (std::find(known.begin(), known.end(), loop::key_of(name)) == known.end())
      mistakes.push_back({"loop.leave_out", name, fmt::format("any of {}", fmt::join(known, ", "))});
  return mistakes;
}

/// What would else be said after the tests before have been correlated.
void check_law_and_cameras(const io::Case& test) {
  if (!test.experiments.empty()) static_cast<void>(make_extended_material(test));
  for (const char* face : {"front", "back"}) {
    int telecentric = 0, pinhole = 0;
    for (const auto& camera : test.cameras)
      if (camera.face == face) ++(camera.model == "pinhole" ? pinhole : telecentric);
    if (telecentric == 0 && pinhole == 1)
      throw InputError("cameras", fmt::format("one perspective camera on the {}", face),
                       "for imic3d loop a telecentric camera, or several perspective ones, on each face");
  }
}

void check_units(const io::Units& units, const io::Case& first) {
  const auto text = [](const io::Units& of) { return fmt::format("{}, {}, {}", of.length, of.force, of.time); };
  if (text(units) != text(first.units))
    throw InputError("units", text(units), text(first.units) + " as in " + first.file.string());
}

/// The numbers of the law are one in all tests: value, bounds, prior, and whether they are free.
void check_law(const io::Case& test, const io::Case& other) {
  const auto declared = [](const io::Case& of, const std::string& name) {
    const bool free = std::any_of(of.identify.stages.begin(), of.identify.stages.end(), [&](const auto& stage) {
      return std::count(stage.free.begin(), stage.free.end(), name) > 0;
    });
    const auto prior = of.loop.prior.find(name);
    const auto& its = of.material.parameters.at(name);
    return fmt::format("{}{}{}{}{}", its.value, free ? " free" : " not free",
                       its.lower && free ? fmt::format(", from {}", *its.lower) : "",
                       its.upper && free ? fmt::format(", up to {}", *its.upper) : "",
                       prior == of.loop.prior.end() ? "" : fmt::format(" with the prior {}", prior->second));
  };
  std::vector<Mistake> mistakes;
  for (const auto& [name, parameter] : test.material.parameters)
    if (other.material.parameters.contains(name) && declared(test, name) != declared(other, name))
      mistakes.push_back({"material.parameters." + name, declared(test, name),
                          declared(other, name) + " as in " + other.file.string()});
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
}

}  // namespace

void collect(std::vector<Mistake>& mistakes, const std::filesystem::path& file, const std::function<void()>& work) {
  try {
    work();
  } catch (const InputError& error) {
    for (auto mistake : error.mistakes()) {
      if (!mistake.place.starts_with(file.string())) mistake.place = file.string() + ": " + mistake.place;
      mistakes.push_back(std::move(mistake));
    }
  }
}

void check_loop_case(const io::Case& test) {
  check_law_and_cameras(test);
  if (auto mistakes = unknown_candidates(test.loop.leave_out, {&test, 1}, {}); !mistakes.empty())
    throw InputError(std::move(mistakes));
}

std::vector<io::Case> cases_of_tests(const io::Case& all, const CommandOptions& options,
                                     const std::function<void(const io::Case&)>& also) {
  std::vector<io::Case> cases;
  std::vector<Mistake> mistakes = all.mistakes;
  for (const auto& test : all.tests) {
    if (!exists(test.file)) continue;  // the list's mistakes say so
    CommandOptions own = options;
    own.case_file = test.file;
    const auto read = cases.size();
    collect(mistakes, test.file, [&] {
      cases.push_back(read_case(own, {"cameras", "material", "identify"}, true, true));
    });
    if (cases.size() == read) continue;
    collect(mistakes, test.file, [&] { check_units(cases.back().units, cases.front()); });
    collect(mistakes, test.file, [&] { check_law(cases.back(), cases.front()); });
    collect(mistakes, test.file, [&] { check_law_and_cameras(cases.back()); });
    if (also) collect(mistakes, test.file, [&] { also(cases.back()); });
  }
  for (std::size_t k = 0; k < all.tests.size(); ++k)
    for (std::size_t other = 0; other < k; ++other)
      if (std::error_code error; std::filesystem::equivalent(all.tests[k].file, all.tests[other].file, error))
        mistakes.push_back({fmt::format("{}: tests[{}].case", all.file.string(), k),
                            fmt::format("the case of {} once more", all.tests[other].name),
                            "tests that were made, each once"});
  if (cases.size() == all.tests.size())  // else names of bars are not known
    for (auto& mistake : unknown_candidates(all.loop.leave_out, cases, all.tests))
      mistakes.push_back({all.file.string() + ": " + mistake.place, mistake.found, mistake.allowed});
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
  for (std::size_t k = 0; k < cases.size(); ++k) cases[k].title = all.tests[k].name + ": " + cases[k].title;
  return cases;
}

std::vector<std::string> possible_candidates(const io::Case& test) {
  std::vector<std::string> names;
  if (test.material.law != "elastic") {
    const ExtendedMaterial material = make_extended_material(test);
    for (const auto& candidate : loop::law_candidates(material.information, material.declared))
      names.push_back(candidate.name);
  }
  const auto add_effects = [&](const loop::Scene& scene, const std::string& face) {
    for (const auto& effect : loop::effects()) {
      const auto name = effect->describe(scene).name;
      const bool again = face.starts_with("back") && !effect->of_each_camera();
      if (!again && effect->applies(scene) && (scene.surface != nullptr || effect->acts_on_curves()))
        names.push_back((effect->of_each_camera() ? face : "") + name);
    }
  };
  loop::Scene known = unit_scene();
  known.elongation = Eigen::VectorXd::Unit(3, 1);  // it may be unloaded
  if (!test.experiments.empty()) {
    add_effects(known, "");
    if (test.experiments.size() > 1)
      for (const auto& group : test.experiments)
        for (const auto& effect : loop::effects())
          if (effect->of_each_group()) names.push_back(loop::in_group(effect->describe(known).name, group.name));
  } else {
    const auto specimen = make_specimen(test);
    for (const auto& face : specimen.faces) {
      loop::Scene scene = known;
      scene.surface = &face.surface.mesh, scene.components = face.components, scene.axis = specimen.axis,
      scene.plane = test.specimen.plane_stress(), scene.images = !test.fields;
      loop::measure(scene, face.surface.mesh);
      add_effects(scene, specimen.faces.size() == 1 ? "" : face.back ? "back " : "front ");
      if (face.components == 3)
        for (const int c : cameras_of(test, face.back))
          for (const auto& effect : loop::effects())
            if (effect->of_one_of_several())
              names.push_back(test.cameras[static_cast<std::size_t>(c)].name + " " + effect->describe(scene).name);
    }
    const bool free = std::any_of(test.identify.stages.begin(), test.identify.stages.end(), [](const auto& stage) {
      return std::count(stage.free.begin(), stage.free.end(), "nu") > 0;
    });
    if (!free) names.emplace_back("Poisson's ratio");
  }
  std::erase_if(names, [&](const std::string& name) {
    const auto same = [&](const std::string& left_out) { return loop::key_of(left_out) == loop::key_of(name); };
    return test.effects.contains(loop::key_of(name)) ||
           std::any_of(test.loop.leave_out.begin(), test.loop.leave_out.end(), same);
  });
  return names;
}

}  // namespace imic3d::app
