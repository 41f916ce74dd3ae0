#include "imic3d/io/results_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <hdf5.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "imic3d/core/error.hpp"

namespace imic3d::io {

namespace {

/// What the operating system had to say, e.g. `No space left on device`; empty if it was not asked.
std::string system_error() {
  std::string reason;
  const auto look = [](unsigned, const H5E_error2_t* entry, void* data) -> herr_t {
    const std::string_view text = entry->desc != nullptr ? entry->desc : "", begin = "error message = '";
    if (const auto at = text.find(begin); at != std::string_view::npos) {
      const auto rest = text.substr(at + begin.size());
      *static_cast<std::string*>(data) = rest.substr(0, rest.find('\''));
    }
    return 0;
  };
  H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, look, &reason);
  return reason;
}

[[noreturn]] void failed(const std::string& what) {
  if (const auto reason = system_error(); !reason.empty())
    throw InputError("HDF5", fmt::format("cannot {} ({})", what, reason),
                     "files that can be read and written, and free space for them");
  throw std::runtime_error("HDF5: cannot " + what);
}

/// Owns an HDF5 identifier.
class Handle {
 public:
  Handle() = default;
  Handle(hid_t id, herr_t (*close)(hid_t), const std::string& what) : id_(id), close_(close) {
    if (id < 0) failed(what);
  }
  Handle(Handle&& other) noexcept : id_(std::exchange(other.id_, -1)), close_(other.close_) {}
  Handle& operator=(Handle&& other) noexcept {
    if (this == &other) return *this;
    if (id_ >= 0) close_(id_);
    id_ = std::exchange(other.id_, -1);
    close_ = other.close_;
    return *this;
  }
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  operator hid_t() const { return id_; }  // NOLINT(google-explicit-constructor): passed to the C interface

 private:
  hid_t id_ = -1;
  herr_t (*close_)(hid_t) = nullptr;
};

void must(herr_t status, const std::string& what) {
  if (status < 0) failed(what);
}

/// Errors become exceptions; HDF5 itself prints nothing.
void be_quiet() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

/// No file lock, so that others may read while the file grows; no buffer, so that a write is a write.
Handle access_properties() {
  Handle properties(H5Pcreate(H5P_FILE_ACCESS), H5Pclose, "make properties");
  must(H5Pset_file_locking(properties, false, true), "set file locking");
  must(H5Pset_sieve_buf_size(properties, 0), "set the buffer");
  must(H5Pset_fclose_degree(properties, H5F_CLOSE_STRONG), "set the close degree");
  return properties;
}

Handle string_type(std::size_t length) {
  Handle type(H5Tcopy(H5T_C_S1), H5Tclose, "make a type");
  must(H5Tset_size(type, std::max<std::size_t>(length, 1)), "set a length");
  must(H5Tset_strpad(type, H5T_STR_NULLPAD), "set padding");
  must(H5Tset_cset(type, H5T_CSET_UTF8), "set UTF-8");
  return type;
}

std::string without_padding(const char* text, std::size_t length) {
  return {text, std::find(text, text + length, '\0')};
}

void set_attribute(hid_t object, const std::string& name, const std::string& text) {
  const Handle type = string_type(text.size());
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose, "make a space");
  const Handle attribute(H5Acreate2(object, name.c_str(), type, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose,
                         "make the attribute " + name);
  std::string padded = text;
  padded.resize(std::max<std::size_t>(text.size(), 1));
  must(H5Awrite(attribute, type, padded.data()), "write the attribute " + name);
}

std::string attribute(hid_t object, const std::string& name) {
  if (H5Aexists(object, name.c_str()) <= 0) return {};
  const Handle attribute(H5Aopen(object, name.c_str(), H5P_DEFAULT), H5Aclose, "open the attribute " + name);
  const Handle type(H5Aget_type(attribute), H5Tclose, "read a type");
  std::string text(H5Tget_size(type), '\0');
  must(H5Aread(attribute, type, text.data()), "read the attribute " + name);
  return without_padding(text.data(), text.size());
}

/// Nothing of the file (or of the names in the folder) is left in memory only. Folders cannot be asked everywhere.
void to_disk(const std::filesystem::path& path) {
  const int file = ::open(path.empty() ? "." : path.c_str(), O_RDONLY | O_CLOEXEC);
  const bool done = file >= 0 && ::fsync(file) == 0;
  const int error = errno;
  if (file >= 0) ::close(file);
  if (!done && !std::filesystem::is_directory(path))
    throw InputError(path.string(), fmt::format("cannot be written ({})", std::strerror(error)),
                     "a place with enough free space");
}

std::size_t product(const std::vector<std::size_t>& shape, std::size_t first = 0) {
  return std::accumulate(shape.begin() + static_cast<std::ptrdiff_t>(std::min(first, shape.size())), shape.end(),
                         std::size_t{1}, std::multiplies<>());
}

std::vector<hsize_t> dimensions(const std::vector<std::size_t>& shape) { return {shape.begin(), shape.end()}; }

}  // namespace

struct ResultsFile::Impl {
  std::filesystem::path path;
  Handle file;
  bool started = false;

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() {
    std::error_code error;
    if (!started && !path.empty()) std::filesystem::remove(part(), error);
  }

  /// Where the file is made until it has its structure, so that a kill before that leaves what was there.
  [[nodiscard]] std::filesystem::path part() const { return path.string() + ".part"; }

  [[nodiscard]] Handle dataset(const std::string& name) const {
    return {H5Dopen2(file, name.c_str(), H5P_DEFAULT), H5Dclose, fmt::format("open {} in {}", name, path.string())};
  }

  Handle create(const std::string& name, hid_t type, const std::vector<std::size_t>& shape, const std::string& unit,
                const std::string& description) const {
    if (started) throw std::logic_error("ResultsFile: " + name + " declared after start()");
    const Handle links(H5Pcreate(H5P_LINK_CREATE), H5Pclose, "make properties");
    must(H5Pset_create_intermediate_group(links, 1), "set properties");
    const Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose, "make properties");
    must(H5Pset_layout(properties, H5D_CONTIGUOUS), "set the layout");
    must(H5Pset_alloc_time(properties, H5D_ALLOC_TIME_EARLY), "set the time of allocation");
    must(H5Pset_fill_time(properties, H5D_FILL_TIME_ALLOC), "set the time of filling");
    if (H5Tget_class(type) == H5T_FLOAT) {
      const double nan = std::numeric_limits<double>::quiet_NaN();
      must(H5Pset_fill_value(properties, H5T_NATIVE_DOUBLE, &nan), "set the fill value");
    }
    const auto sizes = dimensions(shape);
    const Handle space(
        sizes.empty() ? H5Screate(H5S_SCALAR) : H5Screate_simple(static_cast<int>(sizes.size()), sizes.data(), nullptr),
        H5Sclose, "make a space");
    Handle data(H5Dcreate2(file, name.c_str(), type, space, links, properties, H5P_DEFAULT), H5Dclose,
                fmt::format("make {} in {}", name, path.string()));
    if (!unit.empty()) set_attribute(data, "unit", unit);
    set_attribute(data, "description", description);
    return data;
  }

  [[nodiscard]] static std::vector<std::size_t> shape_of(hid_t data) {
    const Handle space(H5Dget_space(data), H5Sclose, "read a space");
    std::vector<hsize_t> sizes(static_cast<std::size_t>(std::max(0, H5Sget_simple_extent_ndims(space))));
    H5Sget_simple_extent_dims(space, sizes.data(), nullptr);
    return {sizes.begin(), sizes.end()};
  }

  /// The part of the file's space that is row `index`, and the space of its numbers in memory.
  static std::pair<Handle, Handle> row(hid_t data, const std::vector<std::size_t>& shape, std::size_t index,
                                       const std::string& name) {
    if (shape.empty() || index >= shape[0])
      throw std::invalid_argument(fmt::format("ResultsFile: no row {} in {}", index, name));
    std::vector<hsize_t> start(shape.size(), 0), count = dimensions(shape);
    start[0] = index;
    count[0] = 1;
    Handle space(H5Dget_space(data), H5Sclose, "read a space");
    must(H5Sselect_hyperslab(space, H5S_SELECT_SET, start.data(), nullptr, count.data(), nullptr), "select a row");
    const hsize_t size = product(shape, 1);
    Handle memory(H5Screate_simple(1, &size, nullptr), H5Sclose, "make a space");
    return {std::move(space), std::move(memory)};
  }
};

ResultsFile::ResultsFile(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ResultsFile::ResultsFile(ResultsFile&&) noexcept = default;
ResultsFile& ResultsFile::operator=(ResultsFile&&) noexcept = default;
ResultsFile::~ResultsFile() = default;

ResultsFile ResultsFile::create(const std::filesystem::path& path) {
  be_quiet();
  std::error_code error;
  if (!path.parent_path().empty()) std::filesystem::create_directories(path.parent_path(), error);
  const Handle properties = access_properties();
  auto impl = std::make_unique<Impl>();
  impl->path = path;
  const hid_t file = H5Fcreate(impl->part().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, properties);
  if (file < 0) throw InputError(path.string(), "cannot be written", "a place where results can be written");
  impl->file = Handle(file, H5Fclose, "make a file");
  return ResultsFile(std::move(impl));
}

ResultsFile ResultsFile::open(const std::filesystem::path& path, bool writable) {
  be_quiet();
  const Handle properties = access_properties();
  const hid_t file = H5Fopen(path.c_str(), writable ? H5F_ACC_RDWR : H5F_ACC_RDONLY, properties);
  if (file < 0) throw InputError(path.string(), "cannot be read", "a results file (.h5)");
  auto impl = std::make_unique<Impl>();
  impl->path = path;
  impl->file = Handle(file, H5Fclose, "open a file");
  impl->started = true;
  return ResultsFile(std::move(impl));
}

void ResultsFile::declare(const std::string& name, const std::vector<std::size_t>& shape, const std::string& unit,
                          const std::string& description, Storage storage) {
  const hid_t type = storage == Storage::real64   ? H5T_IEEE_F64LE
                     : storage == Storage::real32 ? H5T_IEEE_F32LE
                                                  : H5T_STD_I32LE;
  impl_->create(name, type, shape, unit, description);
}

void ResultsFile::declare_frames_done(const std::string& group, std::size_t frames) {
  declare(group + "/frames_done", {frames}, "-", "1 where the frame is whole", Storage::integer);
}

void ResultsFile::store(const std::string& name, const std::vector<std::size_t>& shape, std::span<const double> values,
                        const std::string& unit, const std::string& description, Storage storage) {
  declare(name, shape, unit, description, storage);
  write(name, values);
}

void ResultsFile::store(const std::string& name, const std::vector<std::size_t>& shape, std::span<const int> values,
                        const std::string& unit, const std::string& description) {
  if (values.size() != product(shape)) throw std::invalid_argument("ResultsFile: wrong size of " + name);
  const Handle data = impl_->create(name, H5T_STD_I32LE, shape, unit, description);
  if (!values.empty())
    must(H5Dwrite(data, H5T_NATIVE_INT, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
         fmt::format("write {} in {}", name, impl_->path.string()));
}

void ResultsFile::store_text(const std::string& name, const std::string& text, const std::string& description) {
  const Handle type = string_type(text.size());
  const Handle data = impl_->create(name, type, {}, "", description);
  std::string padded = text;
  padded.resize(std::max<std::size_t>(text.size(), 1));
  must(H5Dwrite(data, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, padded.data()),
       fmt::format("write {} in {}", name, impl_->path.string()));
}

void ResultsFile::store_texts(const std::string& name, const std::vector<std::string>& texts,
                              const std::string& description) {
  std::size_t length = 1;
  for (const auto& text : texts) length = std::max(length, text.size());
  std::string packed;
  for (const auto& text : texts) packed += text + std::string(length - text.size(), '\0');
  const Handle type = string_type(length);
  const Handle data = impl_->create(name, type, {texts.size()}, "", description);
  if (!texts.empty())
    must(H5Dwrite(data, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, packed.data()),
         fmt::format("write {} in {}", name, impl_->path.string()));
}

void ResultsFile::start() {
  if (impl_->started) return;
  must(H5Fflush(impl_->file, H5F_SCOPE_GLOBAL), "write " + impl_->path.string());
  impl_->file = Handle();
  to_disk(impl_->part());
  std::filesystem::rename(impl_->part(), impl_->path);
  to_disk(impl_->path.parent_path());
  const Handle properties = access_properties();
  impl_->file = Handle(H5Fopen(impl_->path.c_str(), H5F_ACC_RDWR, properties), H5Fclose, "open a file");
  impl_->started = true;
}

void ResultsFile::write(const std::string& name, std::span<const double> values) {
  const Handle data = impl_->dataset(name);
  if (values.size() != product(Impl::shape_of(data))) throw std::invalid_argument("ResultsFile: wrong size of " + name);
  if (values.empty()) return;
  must(H5Dwrite(data, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
       fmt::format("write {} in {}", name, impl_->path.string()));
}

void ResultsFile::write(const std::string& name, std::size_t index, std::span<const double> values) {
  const Handle data = impl_->dataset(name);
  const auto shape = Impl::shape_of(data);
  const auto [space, memory] = Impl::row(data, shape, index, name);
  if (values.size() != product(shape, 1))
    throw std::invalid_argument(
        fmt::format("ResultsFile: {} numbers for a row of {} with {}", values.size(), name, product(shape, 1)));
  if (values.empty()) return;
  must(H5Dwrite(data, H5T_NATIVE_DOUBLE, memory, space, H5P_DEFAULT, values.data()),
       fmt::format("write {} in {}", name, impl_->path.string()));
}

void ResultsFile::mark_done(const std::string& group, std::size_t frame, bool whole) {
  const double done = whole ? 1.0 : 0.0;
  write(group + "/frames_done", frame, {&done, 1});
}

bool ResultsFile::has(const std::string& name) const {
  std::string path;
  for (std::size_t at = 0; at < name.size();) {
    const auto end = std::min(name.find('/', at), name.size());
    path = name.substr(0, end);
    if (H5Lexists(impl_->file, path.c_str(), H5P_DEFAULT) <= 0) return false;
    at = end + 1;
  }
  return !name.empty();
}

std::vector<std::string> ResultsFile::names() const {
  std::vector<std::string> found;
  const auto visit = [](hid_t, const char* name, const H5O_info_t* info, void* data) -> herr_t {
    if (info->type == H5O_TYPE_DATASET) static_cast<std::vector<std::string>*>(data)->emplace_back(name);
    return 0;
  };
  must(H5Ovisit2(impl_->file, H5_INDEX_NAME, H5_ITER_INC, visit, &found, H5O_INFO_BASIC), "list the datasets");
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<std::size_t> ResultsFile::shape(const std::string& name) const {
  return Impl::shape_of(impl_->dataset(name));
}

std::string ResultsFile::unit(const std::string& name) const { return attribute(impl_->dataset(name), "unit"); }
std::string ResultsFile::description(const std::string& name) const {
  return attribute(impl_->dataset(name), "description");
}

std::vector<double> ResultsFile::read(const std::string& name) const {
  const Handle data = impl_->dataset(name);
  std::vector<double> values(product(Impl::shape_of(data)));
  if (!values.empty())
    must(H5Dread(data, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), "read " + name);
  return values;
}

std::vector<double> ResultsFile::read(const std::string& name, std::size_t index) const {
  const Handle data = impl_->dataset(name);
  const auto shape = Impl::shape_of(data);
  const auto [space, memory] = Impl::row(data, shape, index, name);
  std::vector<double> values(product(shape, 1));
  if (!values.empty())
    must(H5Dread(data, H5T_NATIVE_DOUBLE, memory, space, H5P_DEFAULT, values.data()), "read " + name);
  return values;
}

std::vector<int> ResultsFile::read_integers(const std::string& name) const {
  const Handle data = impl_->dataset(name);
  std::vector<int> values(product(Impl::shape_of(data)));
  if (!values.empty())
    must(H5Dread(data, H5T_NATIVE_INT, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), "read " + name);
  return values;
}

std::vector<std::string> ResultsFile::read_texts(const std::string& name) const {
  const Handle data = impl_->dataset(name);
  const Handle type(H5Dget_type(data), H5Tclose, "read a type");
  const std::size_t length = H5Tget_size(type), n = product(Impl::shape_of(data));
  std::string packed(length * n, '\0');
  if (n > 0) must(H5Dread(data, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, packed.data()), "read " + name);
  std::vector<std::string> texts;
  for (std::size_t i = 0; i < n; ++i) texts.push_back(without_padding(packed.data() + i * length, length));
  return texts;
}

std::string ResultsFile::read_text(const std::string& name) const {
  const auto texts = read_texts(name);
  return texts.empty() ? std::string() : texts.front();
}

std::vector<std::size_t> ResultsFile::frames_done(const std::string& group) const {
  std::vector<std::size_t> frames;
  if (!has(group + "/frames_done")) return frames;
  const auto done = read_integers(group + "/frames_done");
  for (std::size_t i = 0; i < done.size(); ++i)
    if (done[i] != 0) frames.push_back(i);
  return frames;
}

const std::filesystem::path& ResultsFile::path() const { return impl_->path; }

}  // namespace imic3d::io
