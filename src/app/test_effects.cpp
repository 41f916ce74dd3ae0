#include "test_effects.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

namespace imic3d::app {

loop::Scene unit_scene() {
  loop::Scene scene;
  scene.low = Eigen::Vector2d(-0.5, -0.5), scene.high = Eigen::Vector2d(0.5, 0.5);
  scene.hole.setZero(), scene.axis_of_lens.setZero(), scene.pixels.setIdentity();
  scene.time = Eigen::VectorXd::LinSpaced(2, 0.5, 1.0), scene.force = Eigen::VectorXd::Ones(2), scene.radius = 0.1;
  return scene;
}

bool is_one_of_several(const io::CameraCase& camera, const std::vector<io::CameraCase>& cameras) {
  int count = 0, perspective = 0;
  for (const auto& other : cameras)
    if (other.face == camera.face) ++count, perspective += other.model == "pinhole" ? 1 : 0;
  return count > 1 && perspective > 0;
}

namespace {
/// Whether a camera has the effect for itself.
bool has_for_itself(const loop::Effect& effect, const io::CameraCase& camera,
                    const std::vector<io::CameraCase>& cameras) {
  if (!effect.of_one_of_several()) return false;
  return effect.describe(unit_scene()).link == loop::Link::light ? cameras.size() > 1
                                                                 : is_one_of_several(camera, cameras);
}
}  // namespace

std::map<std::string, std::vector<std::string>> effect_quantities(const io::Case& test) {
  std::map<std::string, std::vector<std::string>> quantities;
  for (const auto& effect : loop::all_effects()) {
    const auto description = effect->describe(unit_scene());
    for (const auto& q : description.quantities) {
      quantities[loop::key_of(description.name)].push_back(q.name);
      std::set<std::string> whose;
      if (effect->of_each_camera()) whose = {"front ", "back "};  // where cameras look at both faces
      for (const auto& camera : test.cameras)
        if (has_for_itself(*effect, camera, test.cameras)) whose.insert(camera.name + " ");
      for (const auto& which : whose) quantities[loop::key_of(which + description.name)].push_back(q.name);
      if (effect->of_each_group() && test.experiments.size() > 1)
        for (const auto& group : test.experiments)
          quantities[loop::key_of(loop::in_group(description.name, group.name))].push_back(q.name);
    }
  }
  return quantities;
}

void refuse_effects(const io::Case& test, const std::string& command) {
  if (test.effects.empty()) return;
  throw InputError("effects", fmt::format("{} declared, for imic3d {}", test.effects.begin()->first, command),
                   "no section effects: imic3d virtual plants them, imic3d identify and loop have them in their model");
}

std::vector<loop::DeclaredEffect> declared_effects(const io::Case& test, bool of_light) {
  std::set<std::string> lights;
  for (const auto& effect : loop::light_effects()) {
    const std::string name = effect->describe(unit_scene()).name;
    lights.insert(loop::key_of(name));
    for (const auto& camera : test.cameras) lights.insert(loop::key_of(camera.name + " " + name));
  }
  std::vector<loop::DeclaredEffect> all;
  for (const auto& [effect, quantities] : test.effects)
    for (const auto& [quantity, declared] : quantities)
      if (lights.contains(effect) == of_light)
        all.push_back({effect, quantity, declared.value, declared.lower, declared.upper, declared.free});
  return all;
}

PlantedEffects::PlantedEffects(const io::Case& test) : test_(test) {
  if (test.effects.empty()) return;
  io::Case declared = test;
  if (!test.virtual_test->declared_mesh.empty()) declared.specimen.mesh = test.virtual_test->declared_mesh;
  const auto specimen = make_specimen(declared);
  declared_ = specimen.faces.front().surface.mesh;
  scene_.surface = &declared_;
  loop::measure(scene_, declared_);
  scene_.axis = specimen.axis;
  scene_.plane = test.specimen.plane_stress();
  const auto z = specimen.volume.nodes.col(2);
  scene_.thickness =
      test.specimen.thickness > 0.0 ? test.specimen.thickness : specimen.section_factor * (z.maxCoeff() - z.minCoeff());
  if (const auto nu = test.material.parameters.find("nu"); nu != test.material.parameters.end())
    scene_.poisson = nu->second.value;
  const auto& simulate = *test.simulate;
  const auto frames = static_cast<Eigen::Index>(simulate.value.size()) - 1;
  scene_.time = Eigen::Map<const Eigen::VectorXd>(simulate.time.data() + 1, frames);
  scene_.start_time = scene_.reference_time = simulate.time.front();
  scene_.force = Eigen::VectorXd::Ones(frames);
  scene_.dynamic = test.virtual_test->depth == 16 ? 65535.0 : 255.0;
  // A bent end is a share of the elongation between the ends, whatever the distance between them.
  scene_.elongation = Eigen::Map<const Eigen::VectorXd>(simulate.value.data() + 1, frames);

  const bool both = std::any_of(test.cameras.begin(), test.cameras.end(),
                                [&](const auto& camera) { return camera.face != test.cameras.front().face; });
  for (const auto& effect : loop::all_effects()) {
    if (!effect->of_each_camera() || !both)
      plant(effect, "");
    else
      for (const char* face : {"front", "back"}) plant(effect, face);
    for (const auto& camera : test.cameras)
      if (has_for_itself(*effect, camera, test.cameras)) plant(effect, camera.face, camera.name);
  }
  for (const auto& [key, quantities] : test.effects)
    if (std::none_of(planted_.begin(), planted_.end(), [&](const Planted& one) { return one.key == key; }))
      throw InputError("effects." + key, both ? "with cameras on both faces" : "with cameras on one face",
                       both ? fmt::format("front_{0} or back_{0}", key) : "its name without the face");
  check_bounds(simulate.control == "force");
}

void PlantedEffects::plant(const std::shared_ptr<const loop::Effect>& effect, const std::string& face,
                           const std::string& camera) {
  const io::Case& test = test_;
  const auto description = effect->describe(scene_);
  const std::string whose = camera.empty() ? face : camera,
                    key = loop::key_of((whose.empty() ? "" : whose + " ") + description.name);
  const auto its = test.effects.find(key);
  if (its == test.effects.end()) return;
  if (description.link == loop::Link::numerics)
    throw InputError(
        "effects." + key, "an effect of the numerics, for imic3d virtual",
        "effects of the test; a virtual test's own mesh and increments are its specimen and simulate sections");
  if (!effect->applies(scene_))
    throw InputError("effects." + key, "declared for a specimen that lacks what it acts on",
                     "an effect that this test can have");
  if (description.link == loop::Link::loading && effect->changes_simulation(scene_) &&
      (test.specimen.mid_plane_symmetry || test.simulate->control == "force"))
    throw InputError("effects." + key,
                     test.specimen.mid_plane_symmetry
                         ? "with specimen.mid_plane_symmetry, which holds the middle of the thickness straight"
                         : "with simulate.control: force",
                     "mid_plane_symmetry: false and control: displacement");
  Planted planted{effect, key, face, camera, {}};
  for (const auto& q : description.quantities) {
    const auto one = its->second.find(q.name);
    if (one != its->second.end() && !one->second.value)
      throw InputError("effects." + key + "." + q.name, "no value", "the value to be planted");
    planted.values.push_back(one == its->second.end() ? q.null : *one->second.value);
  }
  planted_.push_back(std::move(planted));
}

void PlantedEffects::check_bounds(bool with_force) const {
  for (const auto& planted : planted_) {
    const auto description = planted.effect->describe(scene_);
    for (std::size_t i = 0; i < planted.values.size(); ++i) {
      const auto& q = description.quantities[i];
      if (q.unit == "force" && !with_force) continue;
      if (planted.values[i] >= q.lower && planted.values[i] <= q.upper) continue;
      throw InputError(
          "effects." + planted.key + "." + q.name, fmt::format("{:.6g}", planted.values[i]),
          fmt::format("a number from {:.6g} to {:.6g} [{}]", q.lower, q.upper, unit_in(q.unit, test_.units)));
    }
  }
}

loop::MeshChange PlantedEffects::change() const {
  loop::MeshChange change;
  for (const auto& planted : planted_) {
    const loop::Link link = planted.effect->describe(scene_).link;
    change.thickness *= planted.effect->thickness(planted.values);
    if (link == loop::Link::geometry)
      change.place = [this](Eigen::Vector2d& point) {
        for (const auto& one : planted_) one.effect->place(one.values, scene_, point);
      };
    if (link == loop::Link::geometry || link == loop::Link::material)
      change.section = [this](const Eigen::Vector3d& point) {
        double factor = 1.0;
        for (const auto& one : planted_) factor *= one.effect->section(one.values, scene_, point);
        if (factor <= 0.0)
          throw InputError("effects", fmt::format("no section is left at x = {:.4g}, y = {:.4g}", point[0], point[1]),
                           "smaller effects, or a shorter specimen");
        return factor;
      };
    if (link == loop::Link::initial && planted.effect->changes_simulation(scene_))
      change.initial_strain = [this](const Eigen::Vector3d& point) {
        double strain = 0.0;
        for (const auto& one : planted_) strain += one.effect->initial_strain(one.values, scene_, point);
        return strain;
      };
  }
  return change;
}

std::function<double(int, double)> PlantedEffects::beyond() const {
  if (std::none_of(planted_.begin(), planted_.end(),
                   [&](const auto& one) { return one.effect->describe(scene_).link == loop::Link::loading; }))
    return {};
  return [this](int frame, double z) {
    double sum = 0.0;
    for (const auto& one : planted_) sum += one.effect->driven(one.values, scene_, frame - 1, z);
    return sum;
  };
}

void PlantedEffects::simulated(const Eigen::VectorXd& force) {
  if (planted_.empty()) return;
  scene_.force = force;
  check_bounds(true);
}

std::string PlantedEffects::seen(const std::string& face) const {
  for (const auto& one : planted_) {
    const loop::Link link = one.effect->describe(scene_).link;
    const bool before = link == loop::Link::initial && !one.effect->changes_simulation(scene_);
    if (before || (link == loop::Link::camera && one.camera.empty() && (one.face.empty() || one.face == face)))
      return one.key;
  }
  return "";
}

Eigen::MatrixXd PlantedEffects::seen_beyond(const std::string& face, const mesh::Mesh& mesh,
                                            const Eigen::MatrixXd& displacement, const Eigen::Matrix2d& pixels,
                                            const Eigen::Vector2d& axis_of_lens) const {
  loop::Scene scene = scene_;
  scene.surface = &mesh;
  scene.pixels = pixels, scene.axis_of_lens = axis_of_lens;
  // The last frame before the force reaches 0.3 of its largest is taken for elastic, as in FieldExperiment.
  Eigen::Index elastic = 0;
  for (Eigen::Index t = 0; t < scene.force.size() && std::abs(scene.force[t]) < 0.3 * scene.force.cwiseAbs().maxCoeff();
       ++t)
    elastic = t;
  scene.elastic = displacement.col(elastic) / scene.force[elastic];
  Eigen::MatrixXd beyond = Eigen::MatrixXd::Zero(displacement.rows(), displacement.cols());
  for (Eigen::Index t = 0; t < displacement.cols(); ++t) {
    Eigen::VectorXd error = Eigen::VectorXd::Zero(displacement.rows());
    for (const auto& one : planted_)
      if (one.camera.empty() && (one.face.empty() || one.face == face))
        one.effect->see(one.values, scene, static_cast<int>(t), displacement.col(t), error);
    beyond.col(t) = error;
  }
  return beyond;
}

bool PlantedEffects::has_own(const std::string& camera) const {
  return std::any_of(planted_.begin(), planted_.end(), [&](const Planted& one) {
    return one.camera == camera && one.effect->describe(scene_).link != loop::Link::light;
  });
}

loop::Pixels PlantedEffects::pixels_beyond(const loop::Sight& sight, const mesh::Mesh& surface, int frame,
                                           const loop::Pixels& motion) const {
  const loop::ImagePlane plane(sight, surface, scene_);
  loop::Pixels beyond = loop::Pixels::Zero(motion.rows(), 2);
  for (const auto& one : planted_)
    if (one.camera == sight.camera && one.effect->describe(scene_).link != loop::Link::light)
      beyond += plane.error(*one.effect, one.values, frame, motion);
  return beyond;
}

bool PlantedEffects::lit() const {
  return std::any_of(planted_.begin(), planted_.end(),
                     [&](const auto& one) { return one.effect->describe(scene_).link == loop::Link::light; });
}

loop::Light PlantedEffects::light(const std::string& camera, int frame, const Eigen::Vector2d& point,
                                  const Eigen::Vector2d& now) const {
  loop::Light light;
  for (const auto& one : planted_)
    if (one.camera.empty() || one.camera == camera) one.effect->light(one.values, scene_, frame, point, now, light);
  return light;
}

Eigen::VectorXd PlantedEffects::recorded(Eigen::VectorXd force) const {
  for (const auto& one : planted_) one.effect->record(one.values, scene_, force);
  return force;
}

/// The record counts from the reference where the specimen was loaded before it: there it reads zero.
double PlantedEffects::recorded_still(double still) const {
  Eigen::VectorXd force = Eigen::VectorXd::Constant(scene_.force.size(), still);
  for (const auto& one : planted_)
    if (one.effect->describe(scene_).link != loop::Link::initial) one.effect->record(one.values, scene_, force);
  return force.size() > 0 ? force[force.size() - 1] : still;
}

nlohmann::json PlantedEffects::truth() const {
  nlohmann::json all;
  for (const auto& one : planted_) {
    const auto description = one.effect->describe(scene_);
    for (std::size_t i = 0; i < one.values.size(); ++i)
      all[one.key][description.quantities[i].name] = {{"value", one.values[i]},
                                                      {"unit", unit_in(description.quantities[i].unit, test_.units)}};
  }
  return all;
}

}  // namespace imic3d::app
