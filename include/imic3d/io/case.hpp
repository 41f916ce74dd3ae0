#pragma once
// The case file as data: what a user declares about one test, and how it is read.
//
// Frame numbers. A frame has the number that the load record gives it (its `image` column), and this number is used
// everywhere: in the case file, in the messages and in the results. It need not count the images: a record of 281
// frames with 51 images has the frames 0-280, and "0-58" selects those of them that have an image. Without a load
// record the images are numbered 0, 1, 2 … (or as the camera's `frames` says). Case::index_of turns a number into a
// place in the series of images.

#include <algorithm>
#include <array>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "imic3d/core/parameter.hpp"
#include "imic3d/io/experiments.hpp"
#include "imic3d/io/fields.hpp"
#include "imic3d/io/frames.hpp"
#include "imic3d/io/loads.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::io {

struct Units {
  std::string length = "mm", force = "N", time = "s";  ///< stress is force/length^2
};

/// force/length^2 by its usual name: MPa, Pa, GPa, kPa.
[[nodiscard]] std::string stress_unit(const Units& units);

/// Where the specimen lies in front of calibrated cameras (correlation/specimen_pose.hpp).
struct SpecimenPlaceCase {
  /// name of the one that the points were read in; the first if not given
  std::string camera;
  /// rows x [length], y [length], column [px], row [px]; at least 3
  std::vector<std::array<double, 4>> points;
  double deviation = 1.0;       ///< standard deviation of the points [px]
  bool refine_cameras = false;  ///< also the poses of the cameras but the first pinhole one
  double shape = 0.0;           ///< shortest wave of a correction of the shape [length]; 0: flat
};

struct SpecimenCase {
  std::filesystem::path mesh;       ///< resolved against the case file's folder
  std::string kinematics = "3d";    ///< `3d`, or `plane_stress` on the quadrilaterals of a 2D mesh
  std::vector<std::string> unused;  ///< keys that are given and say nothing in plane stress
  double thickness = 0.0;           ///< [length]; 2D meshes only
  int layers = 4;                   ///< hexahedra through the thickness (of the half, with mid-plane symmetry)
  double layer_ratio = 1.0;         ///< thickness of a layer over that of its neighbour nearer to the free face
  /// uniform refinements of the simulation's mesh (the DIC mesh is the file's own)
  int refine = 0;
  /// `hex8r`, `hex8s`: one point, without and with stabilisation; `hex20`; in plane stress the face of it: `quad4` for
  /// hex8, `quad8` for hex20
  std::string element = "hex8";
  bool mid_plane_symmetry = false;  ///< simulate the camera's half of the thickness
  [[nodiscard]] bool plane_stress() const { return kinematics == "plane_stress"; }
  [[nodiscard]] bool one_point() const { return element == "hex8r" || element == "hex8s"; }
  [[nodiscard]] bool quadratic() const { return element == "hex20" || element == "quad8"; }
  std::string held, loaded;                ///< node groups at the ends
  std::string axis = "y";                  ///< direction of the load: x or y
  std::string front = "front";             ///< 3D meshes: group of the face that the camera sees
  std::optional<SpecimenPlaceCase> place;  ///< with pinhole cameras
};

struct PlaceCase {
  std::string automatic;  ///< "outline": from the specimen's outline and hole; empty if points are given
  /// rows x [length], y [length], column [px], row [px]; at least 2
  std::vector<std::array<double, 4>> points;
  std::optional<std::array<double, 2>> origin;  ///< pixel of the mesh's origin (with pixel_size and rotation)
  /// of the specimen's x axis in the image, counter-clockwise [degree]
  double rotation = 0.0;
  bool flip = false;  ///< the image is mirrored
};

/// A pinhole camera of a virtual test, in the specimen's frame.
struct ViewCase {
  double focal = 0.0;                  ///< [px]
  std::array<double, 3> from{}, at{};  ///< its centre; the point in the middle of the image [length]
  double roll = 0.0;                   ///< [degree]; 0: the specimen's y axis points upwards
  std::vector<double> distortion;      ///< k1 k2 p1 p2 k3 …
};

struct CameraCase {
  std::string name = "camera";
  std::string model = "telecentric";             ///< `telecentric`, `pinhole`
  std::string face = "front";                    ///< of the specimen that it looks at: `front` (+z), `back`
  std::filesystem::path calibration;             ///< pinhole: file with its lens and its pose in the rig
  int index = 0;                                 ///< which camera of that file, from 0
  std::string frame = "rig";                     ///< pinhole: of the calibration's poses; `rig`, `specimen`
  std::optional<ViewCase> view;                  ///< pinhole: for a virtual test
  std::optional<std::array<int, 2>> size;        ///< virtual: columns, rows of its images [px]
  std::map<std::string, double> calibration_sd;  ///< standard deviations of its numbers, by their names
  double pixel_size = 0.0;                       ///< [length/px]
  PlaceCase place;
  /// in frame order, glob already expanded and sorted; may be empty (virtual)
  std::vector<std::filesystem::path> images;
  Frames frames;                ///< number of the frame of each image, ascending
  Frames reference;             ///< frames averaged to the reference image; the first one if not given
  std::optional<double> noise;  ///< standard deviation [grey level], measured if not given
};

/// Displacement fields of the specimen's face that another program correlated, in the place of cameras.
struct FieldsCase {
  std::vector<std::filesystem::path> files;  ///< one table for each frame, in their order
  /// number of the frame of each; 1, 2, 3 … if not given (0 is the reference)
  Frames frames;
  PointColumns columns;
  double scale = 1.0;              ///< the tables' unit [length]
  std::array<double, 2> origin{};  ///< of the mesh in the tables [their unit]
  /// of the specimen's x axis in the tables, counter-clockwise as it is seen [degree]
  double rotation = 0.0;
  bool y_down = false;  ///< the tables' y axis points downwards, as in an image
  /// standard deviation of a component at a point [their unit]; else from frames at rest, else from the scatter
  std::optional<double> noise;
  /// size of what one point is the mean of [their unit]: nearer points share their noise
  double subset = 0.0;
  Frames at_rest;                  ///< frames without load, which tell the noise and are not fitted
  std::optional<int> references;   ///< images that the reference is the mean of; else as the frames at rest tell
  std::vector<PointTable> tables;  ///< one for each file
};

/// When the images were taken by a clock of their own: at intervals, or as a table says.
struct FrameTimesCase {
  double start = 0.0;          ///< what the load record's clock reads where that of the images reads 0 [time]
  double interval = 0.0;       ///< frame n was taken at n intervals [time]; 0: by the table
  std::filesystem::path file;  ///< of the table
  LoadColumns columns{.force = ""};
};

struct LoadsCase {
  std::filesystem::path file;
  LoadColumns columns;                        ///< which column holds what
  double force_scale = 1.0;                   ///< multiplies the column (e.g. 1000 for a column in kN)
  std::optional<double> noise;                ///< standard deviation [force], measured on static frames if not given
  double lag = 0.0;                           ///< time constant of the force recorder, a first-order low-pass [time]
  double offset = 0.0;                        ///< reading without load, subtracted [force]
  std::optional<FrameTimesCase> frame_times;  ///< else the record has a column of frames
  /// every row (with frame_times one for each frame), force already in the case's unit; empty without a file
  std::vector<LoadRecord> records;
};

struct ParameterCase {
  double value = 0.0;
  std::optional<double> lower, upper;
};

struct MaterialCase {
  std::string law = "j2", hardening = "power_linear";
  bool tie_initial_modulus = false;
  std::string yield_stress = "kirchhoff";  ///< what the hardening curve is compared with: kirchhoff, cauchy
  std::vector<double> table_strain;
  std::vector<std::string> effects;  ///< what the law is extended by (material/effects)
  /// those of effects that are not given are at their null values
  std::map<std::string, ParameterCase> parameters;
};

/// Uniform tests of one kind, one file each: repetitions of each other.
struct ExperimentCase {
  std::string name;
  std::vector<std::filesystem::path> files;  ///< patterns already expanded
  CurveColumns columns;
  bool engineering_strain = true, engineering_stress = true;  ///< else true: ln(1+e), s (1+e)
  /// multiply the columns; the stress then is in the case's unit. Negative where tension is recorded as negative.
  double strain_scale = 1.0, stress_scale = 1.0;
  double time_scale = 1.0;  ///< multiplies the column
  /// standard deviation [stress]; the scatter of the repetitions, or of the points, if not given
  std::optional<double> noise;
  std::optional<double> rate;  ///< strain rate where there is no time column [1/time]
  double direction = 0.0;      ///< of the bar in the material's plane, from its x axis [degree]
  double from = 0.0;           ///< rows before this strain is reached are simulated but not judged [-]
  bool until_maximum = false;  ///< rows after the largest force are left out
  /// a strain that turns back is noise: it stays at its largest so far, and the row is not judged
  bool monotonic = false;
  bool held_out = false;  ///< simulated but never fitted: all of it, or
  Frames held_out_rows;   ///< only these rows (from 0)
  /// one per file, as recorded, a force over the section, an extension over the gauge length
  std::vector<CurveTable> tables;
};

struct DicCase {
  std::optional<double>
      /// cut-off wavelength of the elastic regularisation [length]; none if 0 or not given
      regularisation;
  int pyramid_levels = -1;  ///< -1: chosen from the image size
  int max_iterations = 50;
  double tolerance = 1e-3;        ///< largest nodal update [px]
  double low_pass = 1.0;          ///< standard deviation of the Gaussian that smooths all images [px]
  double border = 3.0;            ///< pixels along the mesh's contour that are left out [px]
  bool brightness = false;        ///< per-frame gain and offset are fitted with the displacement
  bool local_brightness = false;  ///< the same for each element
  int groups = 0;                 ///< 0: auto
};

struct StageCase {
  std::vector<std::string> free;
  Frames frames;  ///< those with an image, not held out
};

struct IdentifyCase {
  std::string functional = "force_driven";  ///< `force_driven`, `displacement_driven`, `combined`, `equilibrium_gap`
  double alpha = 0.0;                       ///< penalty parameter of Eq. 16; 0: the limit alpha -> 0
  std::vector<StageCase> stages;
  std::string sensitivities;  ///< `direct`, `perturbed`
  double eta = 1e-3;          ///< Eq. 13
  int max_iterations = 20;
  std::optional<double> boundary_smoothing;  ///< longest waves that the driving displacement may lose [length]
  /// results.h5 of `imic3d dic`, whose displacement drives the ends; this run's own if empty
  std::filesystem::path driving;
  int noise_draws = 12;     ///< of the noise of force and driving displacement, for the covariance
  Frames held_out;          ///< frames that are simulated but never fitted
  int groups = 0;           ///< concurrent groups of ranks; 0: auto
  int steps_per_frame = 0;  ///< load increments between two frames; 0: auto
  [[nodiscard]] int increments() const { return std::max(1, steps_per_frame); }  ///< that a simulation takes
};

/// How the loop is closed (imic3d loop); it asks for nothing.
struct LoopCase {
  bool given = false;                            ///< whether the case file has the section
  int draws = 100;                               ///< of the null ensemble
  int modes = 100;                               ///< numbers that the displacement residual of a frame is written in
  int additions = 3;                             ///< effects added at most
  int rivals = 4;                                ///< candidates tried at a time
  std::vector<std::string> leave_out;            ///< candidates that are not considered
  std::vector<double> starts = {1.0, 0.9, 1.1};  ///< of the identification, relative to the declared values
  /// standard deviation of a declared value as it is known beforehand
  std::map<std::string, double> prior;
};

/// One quantity of an effect of the test (`imic3d effects` lists them) as it is declared.
struct EffectCase {
  std::optional<double> value;  ///< its null value if not given
  std::optional<double> lower, upper;
  bool free = false;  ///< to be identified by imic3d loop
};

struct SimulateCase {
  std::string control = "displacement";  ///< `displacement`, `force`
  std::vector<double> time;              ///< one entry per frame (frame 0 is the reference)
  std::vector<double> value;             ///< displacement of `loaded` along `axis` [length], or force [force]
  bool clamped = true;                   ///< the ends cannot move across the axis
  bool centred = false;                  ///< both ends move, each by half
  int steps_per_frame = 1;
};

struct VirtualCase {
  std::array<int, 2> size = {1024, 1024};        ///< columns, rows [px]
  std::optional<std::filesystem::path> texture;  ///< a speckle image to use; generated if not given
  double speckle_size = 4.0;                     ///< mean speckle diameter [px]
  double noise = 0.01;                           ///< of the dynamic (grey-level range of the depth)
  int depth = 8;                                 ///< bits per pixel: 8 or 16
  double load_noise = 0.0;                       ///< standard deviation [force]
  int static_frames = 3;                         ///< frames before loading
  unsigned seed = 1;
  std::filesystem::path directory = "virtual";
  /// 2D mesh of the part that is identified: effects are sized by it; specimen.mesh if empty
  std::filesystem::path declared_mesh;
};

/// One of several tests of a material, each a case of its own.
struct TestCase {
  std::string name;
  std::filesystem::path file;
};

struct Case {
  std::filesystem::path file;  ///< the case file
  std::string text;            ///< its contents, kept with the results
  std::string title;
  Units units;
  SpecimenCase specimen;
  std::vector<CameraCase> cameras;
  std::optional<FieldsCase> fields;  ///< in the place of cameras
  LoadsCase loads;
  MaterialCase material;
  std::vector<ExperimentCase> experiments;
  std::vector<TestCase> tests;    ///< in the place of all but title, loop and output
  std::vector<Mistake> mistakes;  ///< of the list of tests, to be said with those of their cases
  DicCase dic;
  IdentifyCase identify;
  LoopCase loop;
  std::map<std::string, std::map<std::string, EffectCase>> effects;  ///< of the test, by effect and quantity
  std::optional<SimulateCase> simulate;
  std::optional<VirtualCase> virtual_test;
  std::filesystem::path output;     ///< folder for results
  std::vector<std::string> doubts;  ///< what is allowed, but hardly meant, a sentence each

  /// Numbers of the frames of the series: those with an image, or 0, 1, 2 … of `simulate` where there are no images.
  Frames frames;
  /// Place of frame `number` in `frames`; throws std::out_of_range.
  [[nodiscard]] int index_of(int number) const;
  /// Time [time] and force [force] of the frame at place `index` of the series; throws std::out_of_range if the record
  /// has none.
  [[nodiscard]] const LoadRecord& load(int index) const;
};

/// What read_case has to know from other rooms, and what the command needs.
struct CaseChecks {
  /// Parameters that the declared material has; may throw InputError. Names and bounds are not checked without it.
  std::function<std::vector<ParameterInfo>(const MaterialCase&)> parameters_of;
  /// Reads the mesh (mesh::read); groups and the need of a thickness are not checked without it.
  std::function<mesh::Mesh(const std::filesystem::path&)> read_mesh;
  /// Quantities of each effect that a test with what has been read of it may have, by the effect's key; neither names
  /// are checked without it.
  std::function<std::map<std::string, std::vector<std::string>>(const Case&)> effects{};
  /// Sections that must be there: `cameras`, `loads`, `material`, `identify`, `simulate`, `virtual`.
  std::vector<std::string> sections;
  /// Whether the images must be there (all of one size and depth), and a row of loads for each.
  bool images = true;
  /// Whether displacement fields will do in the place of cameras and, then, no load record.
  bool fields = false;
  /// Whether several tests will do, each in a case of its own.
  bool several = false;
};

/// Reads a case file: YAML, checked against the schema, then for its meaning. Throws InputError that names every
/// mistake found, in the order of the file's lines.
[[nodiscard]] Case read_case(const std::filesystem::path& file, const CaseChecks& checks = {});

/// The JSON schema (draft-07) of the case file, the text of inputs/case.schema.json.
[[nodiscard]] std::string_view case_schema();

}  // namespace imic3d::io
