// What is to be done with a test: correlation, simulation, identification, loop, virtual test.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

#include "case_reader.hpp"
#include "image_files.hpp"

namespace imic3d::io {

void CaseReader::read_dic() {
  const auto section = root_.group("dic");
  auto& dic = case_.dic;
  section.get("regularisation", dic.regularisation);
  section.get("pyramid_levels", dic.pyramid_levels);
  section.get("max_iterations", dic.max_iterations);
  section.get("tolerance", dic.tolerance);
  section.get("low_pass", dic.low_pass);
  section.get("border", dic.border);
  section.get("brightness", dic.brightness);
  section.get("local_brightness", dic.local_brightness);
  section.get("groups", dic.groups);
}

void CaseReader::read_simulate() {
  if (!root_.has("simulate")) return;
  const auto section = root_.group("simulate");
  auto& simulate = case_.simulate.emplace();
  section.get("control", simulate.control);
  if (case_.specimen.element == "hex8r")
    mistake("specimen.element", "hex8r in a simulation without images", "hex8, hex8s, hex20");
  section.get("value", simulate.value);
  section.get("clamped", simulate.clamped);
  section.get("centred", simulate.centred);
  section.get("steps_per_frame", simulate.steps_per_frame);
  for (std::size_t i = 0; i < simulate.value.size(); ++i) simulate.time.push_back(static_cast<double>(i));
  section.get("time", simulate.time);
  if (simulate.time.size() != simulate.value.size())
    mistake(section.path("time"), fmt::format("a list of {}", simulate.time.size()),
            fmt::format("a list of {}, as many as value", simulate.value.size()));
  if (std::adjacent_find(simulate.time.begin(), simulate.time.end(), std::greater_equal<>()) != simulate.time.end())
    mistake(section.path("time"), "times that do not ascend", "ascending times");
  if (!simulate.value.empty() && simulate.value.front() != 0.0)
    mistake(section.path("value"), fmt::format("{} at frame 0", simulate.value.front()), "0 at frame 0, the reference");
}

void CaseReader::read_identify() {
  if (!root_.has("identify")) return;
  const auto section = root_.group("identify");
  auto& identify = case_.identify;
  for (const char* key : {"functional", "alpha", "boundary_smoothing", "driving", "steps_per_frame", "held_out"})
    if (on_curves() && section.has(key))
      mistake(section.path(key), "given for experiments", "only with images or displacement fields");
  section.get("functional", identify.functional);
  section.get("alpha", identify.alpha);
  const bool gap = identify.functional == "equilibrium_gap";
  if (identify.alpha > 0.0 && identify.functional != "force_driven" && !gap)
    mistake(section.path("alpha"), fmt::format("{} with functional: {}", identify.alpha, identify.functional),
            "functional: force_driven or equilibrium_gap, or alpha: 0");
  if (gap && identify.alpha == 0.0)
    mistake(section.path("alpha"), "not given, or 0, with functional: equilibrium_gap", "above 0, e.g. 1e-3");
  if (case_.specimen.element == "hex8r" && identify.alpha == 0.0)
    mistake(section.path("alpha"), "not given, or 0, with specimen.element: hex8r",
            "above 0, e.g. 1e-2, or element: hex8s");
  if (gap && !case_.specimen.plane_stress())
    mistake(section.path("functional"), "equilibrium_gap in 3D", "specimen.kinematics: plane_stress");
  if (gap && case_.material.law != "elastic")
    mistake(section.path("functional"), "equilibrium_gap with law: " + case_.material.law, "law: elastic");
  section.get("groups", identify.groups);
  // Where the images pull in equilibrium the iterations for the derivatives may not converge; simulations side by side
  // are perturbed ones.
  identify.sensitivities =
      case_.specimen.element == "hex8s" || identify.alpha > 0.0 || identify.groups > 1 ? "perturbed" : "direct";
  section.get("sensitivities", identify.sensitivities);
  if (case_.specimen.element == "hex8s" && identify.sensitivities == "direct")
    mistake(section.path("sensitivities"), "direct with specimen.element: hex8s", "perturbed, or element: hex8, hex20");
  section.get("eta", identify.eta);
  section.get("max_iterations", identify.max_iterations);
  identify.noise_draws = identify.sensitivities == "direct" && !gap ? 12 : 0;
  section.get("noise_draws", identify.noise_draws);
  section.get("boundary_smoothing", identify.boundary_smoothing);
  if (std::string driving; section.has("driving")) {
    section.get("driving", driving);
    identify.driving = (folder_ / driving).lexically_normal();
    if (!std::filesystem::exists(identify.driving))
      mistake(section.path("driving"), identify.driving.string(), "results.h5 of `imic3d dic`");
  }
  section.get("steps_per_frame", identify.steps_per_frame);
  if (section.has("held_out")) identify.held_out = frames_of(section, "held_out", case_.frames);
  const Frames at_rest = case_.fields ? case_.fields->at_rest : Frames();
  const auto is_not_fitted = [&](int frame) {
    return std::binary_search(identify.held_out.begin(), identify.held_out.end(), frame) ||
           std::binary_search(at_rest.begin(), at_rest.end(), frame);
  };
  std::vector<std::string> known = parameters_of_law_;
  if (known.empty())
    for (const auto& [name, parameter] : case_.material.parameters) known.push_back(name);
  for (const auto& stage_section : section.list("stages")) {
    auto& stage = identify.stages.emplace_back();
    stage_section.get("free", stage.free);
    for (std::size_t i = 0; i < stage.free.size(); ++i) {
      const auto path = item(stage_section.path("free"), i);
      if (std::find(known.begin(), known.end(), stage.free[i]) == known.end()) {
        const auto near = nearest(stage.free[i], known);
        mistake(path, fmt::format("no parameter \"{}\"{}", stage.free[i], near.empty() ? "" : ", near to " + near),
                fmt::format("{}", fmt::join(known, ", ")));
      } else if (std::count(stage.free.begin(), stage.free.begin() + static_cast<std::ptrdiff_t>(i), stage.free[i]) >
                 0) {
        mistake(path, fmt::format("\"{}\" twice", stage.free[i]), "each parameter once");
      }
    }
    stage.frames = case_.frames;
    if (on_curves() && stage_section.has("frames")) {
      mistake(stage_section.path("frames"), "given for experiments",
              "from, until and held_out of an experiment say which rows are fitted");
      continue;
    }
    if (stage_section.has("frames")) stage.frames = frames_of(stage_section, "frames", case_.frames);
    const bool any = !stage.frames.empty();
    std::erase_if(stage.frames, is_not_fitted);
    if (any && stage.frames.empty())
      mistake(stage_section.path("frames"),
              at_rest.empty() ? "only frames that are held out" : "only frames that are held out or at rest",
              "at least one frame to fit");
  }
}

void CaseReader::read_loop() {
  if (!root_.has("loop")) return;
  const auto section = root_.group("loop");
  auto& loop = case_.loop;
  loop.given = true;
  section.get("draws", loop.draws);
  section.get("modes", loop.modes);
  section.get("additions", loop.additions);
  section.get("rivals", loop.rivals);
  section.get("starts", loop.starts);
  section.get("leave_out", loop.leave_out);
  const auto prior = section.group("prior");
  for (const auto& [name, deviation] : prior.json().items()) {
    if (!case_.material.parameters.contains(name))
      mistake(prior.path(name), "no parameter of this name", "a parameter of the material");
    else if (std::none_of(case_.identify.stages.begin(), case_.identify.stages.end(), [&](const auto& stage) {
               return std::count(stage.free.begin(), stage.free.end(), name) > 0;
             }))
      mistake(prior.path(name), "of a parameter that is not free", "a parameter that a stage of identify frees");
    if (deviation.is_number()) loop.prior[name] = deviation;
  }
}

void CaseReader::read_effects() {
  const auto section = root_.group("effects");
  const auto possible = checks_.effects ? checks_.effects(case_) : std::map<std::string, std::vector<std::string>>();
  std::vector<std::string> known;
  for (const auto& [effect, quantities] : possible) known.push_back(effect);
  const auto is_known = [&](const std::string& path, const char* what, const std::string& name,
                            const std::vector<std::string>& names) {
    if (possible.empty() || std::find(names.begin(), names.end(), name) != names.end()) return true;
    const auto near = nearest(name, names);
    mistake(path, fmt::format("no {} \"{}\"{}", what, name, near.empty() ? "" : ", near to " + near),
            fmt::format("{}{}", fmt::join(names, ", "),
                        std::string_view(what) == "effect" ? "; those of the law in material.effects" : ""));
    return false;
  };
  for (const auto& [effect, declared] : section.json().items()) {
    if (!is_known(section.path(effect), "effect", effect, known)) continue;
    const auto quantities = section.group(effect);
    for (const auto& [quantity, value] : quantities.json().items()) {
      if (!possible.empty() && !is_known(quantities.path(quantity), "quantity", quantity, possible.at(effect)))
        continue;
      auto& one = case_.effects[effect][quantity];
      if (value.is_number()) one.value = value.get<double>();
      if (!value.is_object()) continue;
      const auto details = quantities.group(quantity);
      details.get("value", one.value);
      details.get("lower", one.lower);
      details.get("upper", one.upper);
      details.get("free", one.free);
      if (one.lower && one.upper && !(*one.lower < *one.upper))
        mistake(quantities.path(quantity), fmt::format("lower {}, upper {}", *one.lower, *one.upper),
                "lower below upper");
      else if (!one.value && !one.free)
        mistake(quantities.path(quantity), "neither a value nor free: true",
                "a number, or {value, lower, upper, free}");
    }
  }
}

void CaseReader::read_virtual() {
  if (!root_.has("virtual")) return;
  const auto section = root_.group("virtual");
  auto& test = case_.virtual_test.emplace();
  section.get("size", test.size);
  section.get("texture", test.texture);
  section.get("speckle_size", test.speckle_size);
  section.get("noise", test.noise);
  section.get("depth", test.depth);
  section.get("load_noise", test.load_noise);
  section.get("static_frames", test.static_frames);
  section.get("seed", test.seed);
  test.directory = folder_ / test.directory;
  section.get("directory", test.directory);
  section.get("declared_mesh", test.declared_mesh);
  if (section.has("declared_mesh") && !exists(test.declared_mesh))
    mistake(section.path("declared_mesh"), fmt::format("no such file: {}", test.declared_mesh.string()),
            "a .msh or .inp file");
  if (test.texture && !exists(*test.texture))
    mistake(section.path("texture"), fmt::format("no such file: {}", test.texture->string()), "an image file");
}

}  // namespace imic3d::io
