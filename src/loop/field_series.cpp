#include "field_series.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace imic3d::loop {

namespace id = identification;

namespace {
/// Of series whose differences are marks, and whose derivatives are marks and noise; of those that are only looked at.
constexpr mechanics::Accuracy accuracy_of_series{.forces = 1e-10, .derivatives = 1e-6},
    accuracy_of_bias{.forces = 1e-7};

/// Of a synthetic test that is made again, of other values: strain that softens the law localises on the finer mesh,
/// and takes its series hundreds of increments a frame, if it can be followed at all.
constexpr int cuts_of_bias = 2;

Eigen::Matrix<double, Eigen::Dynamic, 2> in_plane(const mesh::Mesh& surface) { return surface.nodes.leftCols<2>(); }

/// Of two faces: x and y of each as the mean of both at the same place [unknowns square].
Eigen::SparseMatrix<double> mean_of(const std::vector<FieldFace>& faces) {
  std::vector<Eigen::Triplet<double>> entries;
  const Eigen::Index first[2] = {0, faces[0].unknowns()}, unknowns = faces[0].unknowns() + faces[1].unknowns();
  for (std::size_t to = 0; to < 2; ++to)
    for (std::size_t from = 0; from < 2; ++from) {
      const Eigen::SparseMatrix<double> weights = id::interpolation(faces[from].surface, in_plane(faces[to].surface));
      for (int j = 0; j < weights.outerSize(); ++j)
        for (Eigen::SparseMatrix<double>::InnerIterator entry(weights, j); entry; ++entry)
          for (int k = 0; k < 2; ++k)
            entries.emplace_back(static_cast<int>(first[to] + faces[to].components * entry.row() + k),
                                 static_cast<int>(first[from] + faces[from].components * j + k), 0.5 * entry.value());
    }
  Eigen::SparseMatrix<double> mean(unknowns, unknowns);
  mean.setFromTriplets(entries.begin(), entries.end());
  return mean;
}
}  // namespace

Eigen::VectorXd of_cells(const mesh::Mesh& mesh, const std::function<double(const Eigen::Vector3d&)>& of_point) {
  Eigen::VectorXd values(mesh.cells.rows());
  const int corners = mesh::corners_per_cell(mesh.type);
  for (Eigen::Index cell = 0; cell < mesh.cells.rows(); ++cell) {
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (int a = 0; a < corners; ++a) middle += mesh.nodes.row(mesh.cells(cell, a)).transpose() / corners;
    values[cell] = of_point(middle);
  }
  return values;
}

MeshChange FieldExperiment::mesh_of(const Key& wanted) const {
  const std::vector<double>& values = wanted.specimen;
  MeshChange change;
  change.numerics = wanted.numerics;
  if (values.empty()) return change;
  change.place = [this, values](Eigen::Vector2d& point) {
    for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->place(values_of(k, values), scene_of(k), point);
  };
  change.section = [this, values](const Eigen::Vector3d& point) {
    double factor = 1.0;
    for (std::size_t k = 0; k < effects_.size(); ++k)
      factor *= effects_[k]->section(values_of(k, values), scene_of(k), point);
    return factor;
  };
  for (std::size_t k = 0; k < effects_.size(); ++k) change.thickness *= effects_[k]->thickness(values_of(k, values));
  if (wanted.before_test)
    change.initial_strain = [this, values](const Eigen::Vector3d& point) {
      double strain = 0.0;
      for (std::size_t k = 0; k < effects_.size(); ++k)
        strain += effects_[k]->initial_strain(values_of(k, values), scene_of(k), point);
      return strain;
    };
  return change;
}

FieldExperiment::Variant& FieldExperiment::variant(const Key& wanted) {
  auto& variants = wanted.synthetic ? groups_->synthetic_variants : groups_->variants;
  for (auto it = variants.begin(); it != variants.end(); ++it)
    if (it->first == wanted) {
      variants.splice(variants.begin(), variants, it);
      return variants.front().second;
    }
  while (variants.size() > (wanted.synthetic ? 3 : 6)) variants.erase(std::prev(variants.end()));
  variants.emplace_front(wanted, Variant{});
  Variant& made = variants.front().second;
  made.specimen = model_.specimen(mesh_of(wanted));
  made.before_test = wanted.before_test;
  const auto unknowns = made.specimen.projection.rows();
  const bool same = std::equal(made.specimen.faces.begin(), made.specimen.faces.end(), measured_.faces.begin(),
                               measured_.faces.end(), [](const auto& a, const auto& b) {
                                 return a.surface.mesh.nodes.rows() == b.surface.nodes.rows() &&
                                        a.surface.mesh.nodes == b.surface.nodes;
                               });
  if (same && unknowns == measured_.unknowns()) {
    made.to_variant.resize(unknowns, unknowns);
    made.to_variant.setIdentity();
    made.from_variant = made.to_variant;
  } else {
    std::size_t k = 0;
    made.to_variant = blocks(measured_.faces, [&](const FieldFace& face) {
      return id::between(face.surface, made.specimen.faces[k++].surface.mesh, face.components);
    });
    k = 0;
    made.from_variant = blocks(measured_.faces, [&](const FieldFace& face) {
      return id::between(made.specimen.faces[k++].surface.mesh, face.surface, face.components);
    });
  }
  if (measured_.faces.size() == 2) made.to_variant = (made.to_variant * mean_of(measured_.faces)).eval();
  const Eigen::Index before = wanted.before_test ? 1 : 0, frames = measured_.force.size() + before;
  id::Record record;
  record.time.resize(frames);
  record.time.tail(measured_.force.size()) = measured_.time;
  record.start_time = measured_.start_time;
  if (wanted.before_test)
    record.time[0] = measured_.start_time, record.start_time -= 1e-9 * (1.0 + std::abs(measured_.start_time));
  record.force = Eigen::VectorXd::Zero(frames);
  record.surface_displacement = record.driving = Eigen::MatrixXd::Zero(unknowns, frames);
  made.model = std::make_unique<id::ForwardModel>(
      groups_->of(wanted).group(), made.specimen,
      wanted.law_effects.empty() && !wanted.numerics.in_space
          ? model_.law
          : model_.extended(wanted.law_effects, wanted.numerics.in_space),
      std::move(record),
      mechanics::EquilibriumOptions{.increments = model_.increments * wanted.numerics.increments_factor,
                                    .derivative_tolerance = 1e-5,
                                    .memory_of_factors = 100.0,
                                    .with_fields = false},
      1, 1);
  // Nearly the same series as the last one of these ranks, of another law or specimen.
  const auto alike = std::find_if(std::next(variants.begin()), variants.end(), [&](const auto& other) {
    return !other.first.before_test && other.first.numerics.of_thickness == wanted.numerics.of_thickness &&
           other.second.specimen.volume.nodes.rows() == made.specimen.volume.nodes.rows();
  });
  if (!wanted.before_test && alike != variants.end()) {
    auto solutions = alike->second.model->solutions();
    for (auto& solution : solutions) solution.free.clear();
    made.model->start_from(std::move(solutions));
  }
  return made;
}

Eigen::MatrixXd FieldExperiment::driven_beyond(const Variant& with, const std::vector<double>& loading) const {
  if (loading.empty()) return {};
  const auto& dofs = with.specimen.displacement_dofs;
  const double front = with.specimen.volume.nodes.col(2).maxCoeff();
  const Eigen::Index before = with.before_test ? 1 : 0, frames = measured_.force.size();
  Eigen::MatrixXd beyond = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(dofs.size()), frames + before);
  for (std::size_t i = 0; i < dofs.size(); ++i) {
    if (dofs[i] % 3 != scene().axis ||
        !std::binary_search(with.specimen.loaded.begin(), with.specimen.loaded.end(), dofs[i] / 3))
      continue;
    const double z = with.specimen.volume.nodes(dofs[i] / 3, 2) - front;
    for (Eigen::Index t = 0; t < frames; ++t)
      for (std::size_t k = 0; k < effects_.size(); ++k)
        beyond(static_cast<Eigen::Index>(i), t + before) +=
            effects_[k]->driven(values_of(k, loading), scene_of(k), static_cast<int>(t), z);
  }
  return beyond;
}

int FieldExperiment::uneven_shapes() const { return faces_.size() == 1 ? 6 * (uneven_degree + 1) : 0; }

id::Direction FieldExperiment::uneven_end(const Variant& with, int shape) const {
  const int kind = shape / 2 % 3, across = 1 - scene().axis, degree = shape / 6;
  const auto& nodes = with.specimen.volume.nodes;
  const auto& end = shape % 2 == 0 ? with.specimen.loaded : with.specimen.held;
  const double face = measured_.faces.front().name == "back" ? nodes.col(2).minCoeff() : nodes.col(2).maxCoeff();
  const double middle = 0.5 * (scene().low[across] + scene().high[across]), half = 0.5 * scene().span(across);
  const auto depth = [&](int node) {
    return std::abs(nodes(node, 2) - face) / (0.5 * scene().thickness);
  };  // 1 in the middle
  const auto over_width = [&](int node) {
    return std::legendre(static_cast<unsigned>(degree), std::clamp((nodes(node, across) - middle) / half, -1.0, 1.0));
  };
  const auto at_end = [&](int node) { return std::binary_search(end.begin(), end.end(), node); };
  const auto& dofs = with.specimen.displacement_dofs;
  const Eigen::Index before = with.before_test ? 1 : 0, frames = measured_.force.size();
  id::Direction direction{.prescribed = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(dofs.size()), frames + before)};
  if (kind < 2) {
    for (std::size_t i = 0; i < dofs.size(); ++i) {
      const int node = dofs[i] / 3;
      if (dofs[i] % 3 != (kind == 0 ? scene().axis : across) || !at_end(node)) continue;
      direction.prescribed.row(static_cast<Eigen::Index>(i)).tail(frames) =
          uneven_motion * depth(node) * (2.0 - depth(node)) * over_width(node) * scene().elongation.transpose();
    }
    return direction;
  }
  Eigen::VectorXd force = Eigen::VectorXd::Zero(3 * nodes.rows());  // for a mean axial stress of 1
  const mesh::Cells facets = mesh::boundary_facets(with.specimen.volume).nodes,
                    whole = mesh::with_middles(with.specimen.volume, facets);
  for (Eigen::Index f = 0; f < facets.rows(); ++f) {
    if (!std::all_of(facets.row(f).begin(), facets.row(f).end(), at_end)) continue;
    const auto corner = [&](int i) -> Eigen::Vector3d { return nodes.row(facets(f, i)); };
    const double area = 0.5 * (corner(2) - corner(0)).cross(corner(3) - corner(1)).norm();
    for (const int node : whole.row(f))
      force[3 * node + 2] += uneven_traction * std::sin(std::numbers::pi * depth(node)) * over_width(node) * area /
                             static_cast<double>(whole.cols());
  }
  Eigen::MatrixXd in_time = Eigen::MatrixXd::Zero(force.size(), frames + before);
  in_time.rightCols(frames) = force * measured_.force.transpose() / (scene().span(across) * scene().thickness);
  direction.force = in_time.sparseView();
  return direction;
}

std::vector<FieldExperiment::Series> FieldExperiment::simulate(const std::vector<Simulation>& wanted) {
  const auto frames = measured_.force.size();
  std::vector<Series> results(wanted.size());
  std::vector<double> done(wanted.size(), 0.0);
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    results[k].U.setZero(measured_.unknowns(), frames), results[k].R.setZero(frames);
    const auto derivatives =
        wanted[k].free.size() + wanted[k].directions.size() + wanted[k].uneven.size() + wanted[k].sections.size();
    results[k].dU.assign(derivatives, results[k].U), results[k].dR.assign(derivatives, results[k].R);
  }
  const bool synthetic = !wanted.empty() && wanted.front().variant.synthetic;
  const auto& layout = synthetic ? groups_->halves : groups_->layout;
  std::vector<std::size_t> order(wanted.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  // Series of one specimen one after another: its forward model is kept.
  if (!synthetic)
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return wanted[a].variant < wanted[b].variant; });
  for (std::size_t k = 0; synthetic && k < wanted.size(); ++k) {
    results[k].specimen = model_.specimen(mesh_of(wanted[k].variant));
    results[k].surface.setZero(results[k].specimen.projection.rows(), frames);
  }
  // Of a synthetic test the first takes as long as all others.
  const auto group_of = [&](std::size_t place) {
    return static_cast<int>((synthetic ? std::min<std::size_t>(place, 1) : place) %
                            static_cast<std::size_t>(layout.groups()));
  };
  (synthetic ? groups_->clock_of_halves : groups_->clock).side_by_side([&] {
    for (std::size_t place = 0; place < order.size(); ++place) {
      if (group_of(place) != layout.index()) continue;
      const Simulation& one = wanted[order[place]];
      Series& result = results[order[place]];
      Variant& with = variant(one.variant);
      const Eigen::Index before = with.before_test ? 1 : 0;
      const auto on_variant = [&](const Eigen::MatrixXd& field) {
        Eigen::MatrixXd all = Eigen::MatrixXd::Zero(with.to_variant.rows(), frames + before);
        all.rightCols(frames) = with.to_variant * field;
        return all;
      };
      const Eigen::MatrixXd driving = on_variant(one.driving), beyond = driven_beyond(with, one.loading);
      id::Run run{.parameters = one.law,
                  .driving = &driving,
                  .free = one.free,
                  .straight = one.straight,
                  .accuracy = one.variant.synthetic ? accuracy_of_bias : accuracy_of_series};
      if (one.variant.synthetic && !bias_->at.empty()) run.accuracy.cuts = cuts_of_bias;
      if (beyond.size() > 0) run.beyond = &beyond;
      for (const auto& direction : one.directions)
        run.directions.push_back(
            {.prescribed = with.specimen.from_surface(id::Control::displacement) * on_variant(direction)});
      for (const int shape : one.uneven) run.directions.push_back(uneven_end(with, shape));
      for (const auto& other : one.sections)
        run.directions.push_back(
            {.prescribed = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(with.specimen.displacement_dofs.size()),
                                                 frames + before),
             .section = change_of_section(with.specimen, one.variant, other)});
      id::Path path;
      try {
        path = with.model->simulate(id::Control::displacement, {run}, static_cast<int>(frames + before)).front();
      } catch (const ConvergenceError&) {  // of derivatives, alike on all ranks of the group
        continue;
      }
      if (path.frames < frames + before || !layout.group().is_root()) continue;
      const auto of_frames = [&](const Eigen::MatrixXd& surface) -> Eigen::MatrixXd {
        if (!with.before_test) return surface;
        return surface.rightCols(frames).colwise() - surface.col(0);
      };
      result.U = with.from_variant * of_frames(path.surface), result.R = path.reaction.tail(frames);
      for (std::size_t k = 0; k < result.dU.size(); ++k)
        result.dU[k] = with.from_variant * of_frames(path.d_surface[k]), result.dR[k] = path.d_reaction[k].tail(frames);
      if (synthetic) result.surface = of_frames(path.surface);
      done[order[place]] = 1.0;
    }
  });
  world_.sum(done);
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    const auto share = [&](auto& values) {
      world_.sum(std::span(values.data(), static_cast<std::size_t>(values.size())));
    };
    share(results[k].U), share(results[k].R), share(results[k].surface);
    for (auto& values : results[k].dU) share(values);
    for (auto& values : results[k].dR) share(values);
    if (done[k] < 0.5) results[k].R.resize(0);
  }
  simulations_ += static_cast<int>(wanted.size());
  return results;
}

std::map<std::string, std::vector<GroupTime>> FieldExperiment::group_times() const {
  return {{"simulations", groups_->clock.times()}, {"synthetic_tests", groups_->clock_of_halves.times()}};
}

FieldExperiment::Simulation FieldExperiment::simulation_of(const std::vector<double>& values,
                                                           const Eigen::MatrixXd& driving) const {
  const auto count = static_cast<std::ptrdiff_t>(model_.values.size());
  Simulation one{{values.begin(), values.begin() + count}, {}, driving, {}};
  // Effects of the law cost time: only those that are there.
  for (std::size_t j = model_.values.size(); j < model_.values.size() + model_.lacking.size(); ++j) {
    const auto& info = parameters_[j].info;
    auto& there = one.variant.law_effects;
    if (!info.shape && values[j] != *info.null_value &&
        std::find(there.begin(), there.end(), info.effect) == there.end())
      there.push_back(info.effect);
  }
  if (!one.variant.law_effects.empty()) {
    one.law.clear();
    const auto law = model_.extended(one.variant.law_effects, false);
    for (const auto& info : law->parameters()) {
      const auto same = [&](const Parameter& p) { return p.info.name == info.name; };
      one.law.push_back(values[static_cast<std::size_t>(std::find_if(parameters_.begin(), parameters_.end(), same) -
                                                        parameters_.begin())]);
    }
  }
  std::vector<double> own(parameters_.size(), 0.0);
  bool changed = false, before_test = false, loaded = false;
  for (std::size_t k = 0; k < effects_.size(); ++k) {
    const auto its = values_of(k, values);
    const bool simulated = effects_[k]->changes_simulation(scene_of(k));
    for (std::size_t i = 0; i < its.size(); ++i) {
      const std::size_t j = first_[k] + i;
      own[j] = simulated ? its[i] : *parameters_[j].info.null_value;
      if (simulated && its[i] != *parameters_[j].info.null_value) {
        const Link link = effects_[k]->describe(scene_of(k)).link;
        if (link == Link::loading)
          loaded = true;
        else if (link != Link::numerics)
          changed = true, before_test = before_test || link == Link::initial;
      }
    }
  }
  if (changed) {
    one.variant.specimen = own;
    one.variant.before_test = before_test;
  }
  if (loaded) one.loading = own;
  return one;
}

Eigen::MatrixXd FieldExperiment::true_motion(const std::vector<double>& values, Eigen::MatrixXd driving) const {
  for (Eigen::Index t = 0; t < driving.cols(); ++t) driving.col(t) -= seen_beyond(values, t, motion_.col(t));
  return driving;
}

Eigen::VectorXd FieldExperiment::seen_beyond(const std::vector<double>& values, Eigen::Index t,
                                             const Eigen::VectorXd& U) const {
  Eigen::VectorXd all(U.size());
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    const Eigen::VectorXd own = U.segment(faces_[f].first, measured_.faces[f].unknowns());
    Eigen::VectorXd error = Eigen::VectorXd::Zero(own.size());
    Scene scene = faces_[f].scene;
    scene.elastic *= parameters_.front().value / values.front();  // Young's modulus: that of `elastic` was declared
    for (std::size_t k = 0; k < effects_.size(); ++k)
      if (face_of_[k] < 0 || face_of_[k] == static_cast<int>(f))
        effects_[k]->see(values_of(k, values), scene, static_cast<int>(t), own, error);
    all.segment(faces_[f].first, own.size()) = error;
  }
  return all;
}

FieldExperiment::Prediction FieldExperiment::observed(const std::vector<double>& values, Prediction true_one) const {
  for (Eigen::Index t = 0; t < true_one.displacement.cols(); ++t) {
    const Eigen::VectorXd U = true_one.displacement.col(t);
    true_one.displacement.col(t) += seen_beyond(values, t, U);
  }
  for (std::size_t k = 0; k < effects_.size(); ++k)
    if (!effects_[k]->changes_simulation(scene_of(k))) true_one.force *= effects_[k]->thickness(values_of(k, values));
  for (std::size_t k = 0; k < effects_.size(); ++k)
    effects_[k]->record(values_of(k, values), scene_of(k), true_one.force);
  return true_one;
}

FieldExperiment::Simulation FieldExperiment::with_section(Simulation one, const std::vector<double>& values) const {
  const auto put = [&](std::span<double> own) {
    for (std::size_t k = 0; k < effects_.size(); ++k)
      if (effects_[k]->acts_on_section())
        std::ranges::copy(values_of(k, values), own.begin() + static_cast<std::ptrdiff_t>(first_[k]));
  };
  if (one.variant.specimen.empty())
    for (const auto& p : parameters_) one.variant.specimen.push_back(p.info.null_value.value_or(0.0));
  put(one.variant.specimen);
  if (!one.loading.empty()) put(one.loading);
  return one;
}

Eigen::VectorXd FieldExperiment::change_of_section(const identification::Specimen& specimen, const Key& from,
                                                   const Key& to) const {
  const auto section = [&](const Key& key) { return of_cells(specimen.volume, mesh_of(key).section).array().eval(); };
  const Eigen::ArrayXd there = section(to);
  if (from.specimen.empty()) return there - 1.0;
  return there / section(from) - 1.0;
}

std::vector<std::pair<double, FieldExperiment::Simulation>> FieldExperiment::simulations_of(
    const std::vector<double>& values, const Eigen::MatrixXd& driving) const {
  std::vector<std::pair<double, Simulation>> all;
  all.emplace_back(1.0, simulation_of(values, driving));
  for (std::size_t k = 0; k < effects_.size(); ++k) {
    Numerics numerics;
    effects_[k]->numerics(numerics);
    const auto its = values_of(k, values);
    if (numerics == Numerics{} || its[0] == 0.0) continue;
    Simulation other = simulation_of(values, smooth_ends_);
    other.variant.numerics = numerics;
    all.emplace_back(its[0], std::move(other));
    all.emplace_back(-its[0], simulation_of(values, smooth_ends_));
  }
  return all;
}

std::vector<FieldExperiment::Prediction> FieldExperiment::predict(const std::vector<std::vector<double>>& sets,
                                                                  const std::vector<const Eigen::MatrixXd*>& drivings) {
  std::vector<Simulation> wanted;
  struct Use {
    std::size_t set;
    double weight;
    std::size_t simulation;
  };
  std::vector<Use> uses;
  for (std::size_t s = 0; s < sets.size(); ++s)
    for (auto& [weight, one] : simulations_of(sets[s], true_motion(sets[s], *drivings[s]))) {
      std::size_t k = 0;
      while (k < wanted.size() && !(wanted[k].law == one.law && wanted[k].variant == one.variant &&
                                    wanted[k].loading == one.loading && wanted[k].driving == one.driving))
        ++k;
      if (k == wanted.size()) wanted.push_back(std::move(one));
      uses.push_back({s, weight, k});
    }
  const auto series = simulate(wanted);
  std::vector<Prediction> predictions(sets.size());
  std::vector<char> good(sets.size(), 1);
  for (auto& p : predictions)
    p.displacement.setZero(measured_.displacement.rows(), measured_.force.size()),
        p.force.setZero(measured_.force.size());
  for (const Use& use : uses) {
    const Series& one = series[use.simulation];
    if (one.R.size() == 0) {
      good[use.set] = 0;
      continue;
    }
    predictions[use.set].displacement += use.weight * one.U;
    predictions[use.set].force += use.weight * one.R;
  }
  for (std::size_t s = 0; s < sets.size(); ++s) {
    if (good[s])
      predictions[s] = observed(sets[s], std::move(predictions[s]));
    else
      predictions[s].force.resize(0);
  }
  return predictions;
}

std::pair<FieldExperiment::Prediction, std::vector<FieldExperiment::Prediction>> FieldExperiment::differentiate(
    const std::vector<double>& values, const std::vector<Tangent>& tangents) {
  const Eigen::MatrixXd driving = true_motion(values, measured_.driving);
  // So many at once that the histories' derivatives stay small (some hundred numbers of an element each; 320 MB), and
  // no fewer batches than groups of ranks.
  const auto groups = static_cast<std::size_t>(groups_->layout.groups()),
             room =
                 std::max<std::size_t>(20, 400000 / static_cast<std::size_t>(variant({}).specimen.volume.cells.rows()));
  const auto most = std::clamp<std::size_t>((tangents.size() + groups - 1) / groups, 1, room);
  std::vector<Simulation> wanted;
  struct Use {
    double weight;
    std::size_t first;               // tangent
    std::vector<std::size_t> order;  // tangents of the derivatives
  };
  std::vector<Use> uses;
  for (std::size_t first = 0; first == 0 || first < tangents.size(); first += most) {
    bool follows = true;  // the measured ends: what numerics change does not
    for (auto& [weight, one] : simulations_of(values, driving)) {
      Use use{weight, first, {}};
      const auto last = std::min(tangents.size(), first + most);
      for (std::size_t k = first; k < last; ++k)
        if (tangents[k].parameter >= 0) one.free.push_back(tangents[k].parameter), use.order.push_back(k);
      for (std::size_t k = first; k < last && follows; ++k)
        if (tangents[k].driving.size() > 0) one.directions.push_back(tangents[k].driving), use.order.push_back(k);
      for (std::size_t k = first; k < last; ++k)
        if (tangents[k].uneven >= 0) one.uneven.push_back(tangents[k].uneven), use.order.push_back(k);
      for (std::size_t k = first; k < last; ++k)
        if (!tangents[k].section.empty())
          one.sections.push_back(with_section(one, tangents[k].section).variant), use.order.push_back(k);
      wanted.push_back(std::move(one));
      uses.push_back(std::move(use));
      follows = false;
    }
  }
  const auto series = simulate(wanted);
  const Prediction none{Eigen::MatrixXd::Zero(measured_.displacement.rows(), measured_.force.size()),
                        Eigen::VectorXd::Zero(measured_.force.size())};
  std::pair<Prediction, std::vector<Prediction>> result{none, std::vector<Prediction>(tangents.size(), none)};
  auto& [nominal, derivatives] = result;
  for (std::size_t s = 0; s < series.size(); ++s) {
    const Use& use = uses[s];
    if (series[s].R.size() == 0) {
      nominal.force.resize(0);
      return result;
    }
    if (use.first == 0) nominal.displacement += use.weight * series[s].U, nominal.force += use.weight * series[s].R;
    for (std::size_t k = 0; k < use.order.size(); ++k)
      derivatives[use.order[k]].displacement += use.weight * series[s].dU[k],
          derivatives[use.order[k]].force += use.weight * series[s].dR[k];
  }
  return result;
}

}  // namespace imic3d::loop
