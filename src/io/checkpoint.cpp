#include "imic3d/io/checkpoint.hpp"

#include <fmt/format.h>

#include <bit>
#include <cstdint>
#include <fstream>
#include <iterator>

#include "imic3d/core/error.hpp"
#include "imic3d/io/results_file.hpp"
#include "yaml_document.hpp"

namespace imic3d::io {

namespace {

constexpr const char* numbers_group = "numbers/";
constexpr const char* texts_group = "texts/";
constexpr const char* kind = "imic3d checkpoint 2";
constexpr const char* whole_checkpoint = "a whole checkpoint of this run; without --resume the run starts anew";

/// FNV-1a, of 64 bits, by bytes or by words. Tells accidents, not forgeries.
class Hash {
 public:
  void add(std::string_view text) {
    for (const char c : text) mix(static_cast<unsigned char>(c));
    mix(text.size());
  }
  void add(double value) { mix(std::bit_cast<std::uint64_t>(value)); }
  void add(const Eigen::MatrixXd& matrix) {
    mix(static_cast<std::uint64_t>(matrix.rows())), mix(static_cast<std::uint64_t>(matrix.cols()));
    for (const double value : matrix.reshaped()) add(value);
  }
  /// A file's contents.
  void add_file(const std::filesystem::path& file) {
    std::ifstream stream(file, std::ios::binary);
    add(std::string(std::istreambuf_iterator<char>(stream), {}));
  }
  [[nodiscard]] std::string text() const { return fmt::format("{:016x}", state_); }

 private:
  void mix(std::uint64_t word) { state_ = (state_ ^ word) * 1099511628211ULL, state_ ^= state_ >> 29U; }
  std::uint64_t state_ = 14695981039346656037ULL;
};

}  // namespace

void Checkpoint::put(const std::string& name, const Eigen::MatrixXd& matrix) { numbers_[name] = matrix; }
void Checkpoint::put(const std::string& name, const std::string& text) { texts_[name] = text; }

const Eigen::MatrixXd& Checkpoint::matrix(const std::string& name) const {
  const auto found = numbers_.find(name);
  if (found == numbers_.end()) throw InputError("checkpoint", "no " + name, whole_checkpoint);
  return found->second;
}

const std::string& Checkpoint::text(const std::string& name) const {
  const auto found = texts_.find(name);
  if (found == texts_.end()) throw InputError("checkpoint", "no " + name, whole_checkpoint);
  return found->second;
}

void Checkpoint::erase(const std::string& beginning) {
  std::erase_if(numbers_, [&](const auto& entry) { return entry.first.starts_with(beginning); });
  std::erase_if(texts_, [&](const auto& entry) { return entry.first.starts_with(beginning); });
}

void Checkpoint::broadcast(const Communicator& world) {
  double size[2] = {static_cast<double>(numbers_.size()), static_cast<double>(texts_.size())};
  world.broadcast(size);
  auto number = numbers_.cbegin();
  std::map<std::string, Eigen::MatrixXd> numbers;
  for (double k = 0.0; k < size[0]; ++k) {
    std::string name = world.is_root() ? number->first : "";
    world.broadcast(name);
    double shape[2] = {};
    if (world.is_root())
      shape[0] = static_cast<double>(number->second.rows()), shape[1] = static_cast<double>(number->second.cols());
    world.broadcast(shape);
    Eigen::MatrixXd matrix(static_cast<Eigen::Index>(shape[0]), static_cast<Eigen::Index>(shape[1]));
    if (world.is_root()) matrix = (number++)->second;
    world.broadcast(std::span(matrix.data(), static_cast<std::size_t>(matrix.size())));
    numbers[name] = std::move(matrix);
  }
  auto text = texts_.cbegin();
  std::map<std::string, std::string> texts;
  for (double k = 0.0; k < size[1]; ++k) {
    std::string name = world.is_root() ? text->first : "", value = world.is_root() ? text->second : "";
    if (world.is_root()) ++text;
    world.broadcast(name), world.broadcast(value);
    texts[name] = value;
  }
  numbers_ = std::move(numbers), texts_ = std::move(texts);
}

std::string Checkpoint::sum() const {
  Hash hash;
  for (const auto& [name, matrix] : numbers_) hash.add(name), hash.add(matrix);
  for (const auto& [name, text] : texts_) hash.add(name), hash.add(text);
  return hash.text();
}

void Checkpoint::write(const std::filesystem::path& path) const {
  auto file = ResultsFile::create(path);
  file.store_text("kind", kind, "what this file is");
  file.store_text("sum", sum(), "hash of all numbers and texts");
  for (const auto& [name, matrix] : numbers_)
    file.store(numbers_group + name, {static_cast<std::size_t>(matrix.cols()), static_cast<std::size_t>(matrix.rows())},
               std::span(matrix.data(), static_cast<std::size_t>(matrix.size())), "", name);
  for (const auto& [name, text] : texts_) file.store_text(texts_group + name, text, name);
  file.start();
}

Checkpoint Checkpoint::read(const std::filesystem::path& path) {
  Checkpoint result;
  std::string found = "not a whole checkpoint";
  try {
    const auto file = ResultsFile::open(path);
    if (!file.has("kind") || file.read_text("kind") != kind)
      throw InputError(path.string(), "not a checkpoint of this version", whole_checkpoint);
    for (const auto& name : file.names()) {
      if (name.starts_with(numbers_group)) {
        const auto shape = file.shape(name);
        if (shape.size() != 2) throw std::runtime_error("shape");
        const auto values = file.read(name);
        result.numbers_[name.substr(std::char_traits<char>::length(numbers_group))] = Eigen::Map<const Eigen::MatrixXd>(
            values.data(), static_cast<Eigen::Index>(shape[1]), static_cast<Eigen::Index>(shape[0]));
      }
      if (name.starts_with(texts_group))
        result.texts_[name.substr(std::char_traits<char>::length(texts_group))] = file.read_text(name);
    }
    if (file.read_text("sum") == result.sum()) return result;
  } catch (const InputError& error) {
    if (error.mistakes().front().found != "cannot be read") throw;
  } catch (const std::exception& error) {
    found += fmt::format(" ({})", error.what());
  }
  throw InputError(path.string(), found, whole_checkpoint);
}

std::map<std::string, std::string> fingerprint(const Case& test, bool of_loop) {
  std::map<std::string, Hash> parts;
  auto keys = read_yaml(test.file).root;
  for (const char* section : {"dic", "identify"})
    if (keys.contains(section) && keys[section].is_object()) keys[section].erase("groups");
  std::vector<std::string> sections = {"units", "specimen", "cameras", "loads", "material", "dic", "identify"};
  if (of_loop) sections.insert(sections.end(), {"fields", "effects", "loop"});
  for (const auto& section : sections) parts[section].add(keys.contains(section) ? keys[section].dump() : "");
  if (of_loop && test.fields)
    for (const auto& file : test.fields->files) parts["fields"].add_file(file);
  parts["specimen"].add_file(test.specimen.mesh);
  for (const auto& camera : test.cameras) {
    Hash& hash = parts["cameras"];
    if (!camera.calibration.empty()) hash.add_file(camera.calibration);
    for (std::size_t i = 0; i < camera.images.size(); ++i) {
      std::error_code error;
      if (i < camera.frames.size()) hash.add(static_cast<double>(camera.frames[i]));
      hash.add(camera.images[i].filename().string());
      hash.add(static_cast<double>(std::filesystem::file_size(camera.images[i], error)));
    }
  }
  for (const int frame : test.frames) parts["loads"].add(static_cast<double>(frame));
  for (const auto& record : test.loads.records)
    parts["loads"].add(static_cast<double>(record.frame)), parts["loads"].add(record.time),
        parts["loads"].add(record.force);
  if (!test.identify.driving.empty()) parts["identify"].add_file(test.identify.driving);
  std::map<std::string, std::string> result;
  for (const auto& [section, hash] : parts) result[section] = hash.text();
  return result;
}

}  // namespace imic3d::io
