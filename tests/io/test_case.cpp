#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "imic3d/core/error.hpp"
#include "imic3d/io/case.hpp"
#include "temporary_folder.hpp"

namespace imic3d::io {
namespace test_case {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// What the material's room would say of Eq. 18.
std::vector<ParameterInfo> parameters_of(const MaterialCase& material) {
  std::vector<ParameterInfo> infos{{"E", "MPa", "", 1.0, 1e7, {}},
                                   {"nu", "-", "", 0.0, 0.499, {}},
                                   {"S_y", "MPa", "", 1e-3, std::numeric_limits<double>::infinity(), {}},
                                   {"H", "MPa", "", 0.0, 1e6, {}},
                                   {"delta", "-", "", 1e-6, 1.0, {}}};
  if (!material.tie_initial_modulus) infos.push_back({"eps_0", "-", "", 0.0, 1.0, {}});
  return infos;
}

mesh::Mesh plate_mesh(const fs::path&) {
  mesh::Mesh mesh;
  mesh.nodes.setZero(3, 3);
  mesh.node_groups = {{"top", {0}}, {"bottom", {1}}, {"hole", {2}}};
  return mesh;
}

const CaseChecks all_checks{.parameters_of = parameters_of, .read_mesh = plate_mesh, .sections = {}, .images = true};

/// The shape of the case in the issue that asked for it.
const std::string good_case = R"(# yaml-language-server: $schema=../case.schema.json
title: Plate with a hole, 304L
units: {length: mm, force: N, time: s}
specimen: {mesh: plate.msh, thickness: 8.0, layers: 4, element: hex8, held: bottom, loaded: top, axis: y}
cameras:
  - {name: left, model: telecentric, pixel_size: 0.018, place: {auto: outline}, images: "left/*.png"}
loads: {file: loads.csv, image: frame, time: t_s, force: F_N}
material: {law: j2, hardening: power_linear, tie_initial_modulus: true,
           parameters: {E: 198e3, nu: 0.25, S_y: 284, H: {value: 1480, lower: 100, upper: 1e4}, delta: 0.042}}
identify:
  functional: force_driven
  stages:
    - {free: [E],        frames: "1-5"}
    - {free: [S_y],      frames: "1-10"}
    - {free: [H, delta], frames: "1-11"}
)";

class CaseFile : public ::testing::Test {
 protected:
  void SetUp() override {
    folder.write("plate.msh", "");
    std::string loads = "frame,t_s,F_N\n";
    for (int i = 0; i < 12; ++i) {
      // frame_2 comes before frame_10 in natural order only
      const auto file = folder.write("left/frame_" + std::to_string(i) + ".png", "");
      cv::imwrite(file.string(), cv::Mat(24, 32, CV_8U, cv::Scalar(i)));
      loads += std::to_string(i) + "," + std::to_string(i) + ",100\n";
    }
    folder.write("loads.csv", loads);
  }

  Case read(const std::string& text, const CaseChecks& checks = all_checks) const {
    return read_case(folder.write("case.yaml", text), checks);
  }
  std::string mistakes(const std::string& text, const CaseChecks& checks = all_checks) const {
    try {
      (void)read(text, checks);
      return "none";
    } catch (const InputError& error) {
      return folder.without_folder(error.what());
    }
  }
  static std::string changed(std::string text, const std::string& from, const std::string& to) {
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return text.replace(at, from.size(), to);
  }

  TemporaryFolder folder;
};

TEST_F(CaseFile, TheShapeOfTheIssueIsRead) {
  const Case test = read(good_case);
  EXPECT_EQ(test.title, "Plate with a hole, 304L");
  EXPECT_EQ(test.text, good_case);
  EXPECT_EQ(test.specimen.mesh, folder.path() / "plate.msh");
  EXPECT_EQ(test.specimen.thickness, 8.0);
  EXPECT_EQ(test.specimen.held, "bottom");
  ASSERT_EQ(test.cameras.size(), 1U);
  EXPECT_EQ(test.cameras[0].pixel_size, 0.018);
  EXPECT_EQ(test.cameras[0].place.automatic, "outline");
  ASSERT_EQ(test.cameras[0].images.size(), 12U);
  EXPECT_EQ(test.cameras[0].images[2].filename(), "frame_2.png");
  EXPECT_EQ(test.cameras[0].images[11].filename(), "frame_11.png");
  EXPECT_THAT(test.cameras[0].reference, ElementsAre(0));
  EXPECT_EQ(test.material.parameters.at("E").value, 198e3);
  EXPECT_EQ(test.material.parameters.at("H").upper, 1e4);
  EXPECT_FALSE(test.material.parameters.at("E").lower.has_value());
  ASSERT_EQ(test.identify.stages.size(), 3U);
  EXPECT_THAT(test.identify.stages[0].frames, ElementsAre(1, 2, 3, 4, 5));
  EXPECT_THAT(test.identify.stages[2].free, ElementsAre("H", "delta"));
  EXPECT_EQ(test.load(11).time, 11.0);
  EXPECT_EQ(test.output, folder.path() / "results");
}

/// What load increments err by is looked for, and all noise counts, where nothing else is said; perturbed simulations
/// of the noise are not made unasked.
TEST_F(CaseFile, IncrementsAndNoiseOfAnIdentification) {
  const auto identify = [&](const std::string& more) {
    return read(changed(good_case, "identify:\n", "identify:\n" + more)).identify;
  };
  EXPECT_EQ(identify("").steps_per_frame, 0);
  EXPECT_EQ(identify("").increments(), 1);
  EXPECT_EQ(identify("  steps_per_frame: auto\n").steps_per_frame, 0);
  EXPECT_EQ(identify("  steps_per_frame: 3\n").increments(), 3);
  EXPECT_EQ(identify("").noise_draws, 12);
  EXPECT_EQ(identify("  sensitivities: perturbed\n").noise_draws, 0);
  EXPECT_EQ(identify("  sensitivities: perturbed\n  noise_draws: 5\n").noise_draws, 5);
  EXPECT_EQ(identify("  noise_draws: 0\n").noise_draws, 0);
}

TEST_F(CaseFile, OtherSectionsAreRead) {
  const Case test = read(R"(title: virtual
specimen: {mesh: plate.msh, thickness: 2, held: bottom, loaded: top, axis: x, refine: 1, mid_plane_symmetry: true}
cameras: [{pixel_size: 0.02, place: {origin: [511.5, 400], rotation: -3.5, flip: true}}]
material: {hardening: table, table_strain: [0, 0.1, 1], parameters: {E: 2e5}}
dic: {regularisation: 4, brightness: true, groups: 2}
simulate: {control: force, value: [0, 1e3, 2.5e3], steps_per_frame: 2}
virtual: {size: [640, 480], depth: 16, noise: 0.02, seed: 7, static_frames: 2, load_noise: 20}
output: out
)",
                         {});
  EXPECT_TRUE(test.cameras[0].images.empty());
  EXPECT_EQ((*test.cameras[0].place.origin)[0], 511.5);
  EXPECT_TRUE(test.cameras[0].place.flip);
  EXPECT_THAT(test.material.table_strain, ElementsAre(0.0, 0.1, 1.0));
  EXPECT_THAT(test.simulate->time, ElementsAre(0.0, 1.0, 2.0));
  EXPECT_THAT(test.frames, ElementsAre(0, 1, 2));
  EXPECT_EQ(test.virtual_test->size[1], 480);
  EXPECT_EQ(test.virtual_test->seed, 7U);
  EXPECT_EQ(test.virtual_test->directory, folder.path() / "virtual");
  EXPECT_EQ(test.output, folder.path() / "out");
}

TEST_F(CaseFile, EffectsOfTheTestAreReadAndChecked) {
  CaseChecks checks = all_checks;
  checks.effects = [](const Case&) {
    return std::map<std::string, std::vector<std::string>>{{"force_zero", {"force_offset"}},
                                                           {"taper", {"taper_x", "taper_y"}}};
  };
  const Case test =
      read(good_case +
               "effects: {force_zero: {force_offset: 400}, taper: {taper_y: {lower: -0.1, upper: 0.2, free: true}}}\n",
           checks);
  EXPECT_EQ(test.effects.at("force_zero").at("force_offset").value, 400.0);
  EXPECT_FALSE(test.effects.at("force_zero").at("force_offset").free);
  const auto& taper = test.effects.at("taper");
  ASSERT_EQ(taper.size(), 1U);
  EXPECT_FALSE(taper.at("taper_y").value.has_value());
  EXPECT_TRUE(taper.at("taper_y").free);
  EXPECT_EQ(taper.at("taper_y").upper, 0.2);
  for (const auto& [effects, words] : std::map<std::string, std::string>{
           {"force zero: {force_offset: 1}",
            "effects.force zero: no effect \"force zero\", near to force_zero; allowed: force_zero, taper"},
           {"taper: {taper_z: 1}",
            "effects.taper.taper_z: no quantity \"taper_z\", near to taper_x; allowed: taper_x, taper_y"},
           {"taper: {taper_x: {upper: 1}}",
            "effects.taper.taper_x: neither a value nor free: true; allowed: a number, or {value, lower, upper, free}"},
           {"taper: {taper_x: {free: true, lower: 2, upper: 1}}",
            "effects.taper.taper_x: lower 2, upper 1; allowed: lower below upper"},
           {"taper: {taper_x: much}",
            "effects.taper.taper_x: \"much\"; allowed: a number, or {value, lower, upper, free}"}})
    EXPECT_THAT(mistakes(good_case + "effects: {" + effects + "}\n", checks), HasSubstr(words));
}

TEST_F(CaseFile, PlaneStressSaysWhatItHasNoUseFor) {
  const std::string plane = changed(good_case, "element: hex8", "kinematics: plane_stress, element: quad8");
  const Case test = read(plane);
  EXPECT_TRUE(test.specimen.plane_stress());
  EXPECT_TRUE(test.specimen.quadratic());
  EXPECT_THAT(test.specimen.unused, ElementsAre("layers"));
  EXPECT_FALSE(read(good_case).specimen.plane_stress());
  EXPECT_THAT(read(good_case).specimen.unused, ElementsAre());
  EXPECT_EQ(mistakes(changed(plane, "plane_stress", "3d")),
            "case.yaml:4 specimen.element: quad8 with kinematics: 3d; allowed: hex8, hex8r, hex8s, hex20; quad4, quad8 "
            "with kinematics: plane_stress");
}

TEST_F(CaseFile, OnePointWithoutStabilisationNeedsTheImages) {
  const std::string one_point = changed(good_case, "element: hex8", "element: hex8r");
  EXPECT_EQ(mistakes(one_point),
            "case.yaml:10 identify.alpha: not given, or 0, with specimen.element: hex8r; allowed: above 0, e.g. 1e-2, "
            "or element: hex8s");
  EXPECT_TRUE(read(changed(one_point, "functional: force_driven", "functional: force_driven\n  alpha: 0.1"))
                  .specimen.one_point());
  EXPECT_TRUE(read(changed(good_case, "element: hex8", "element: hex8s")).specimen.one_point());
  // Derivatives by differentiation, but where there are none or the images pull.
  EXPECT_EQ(read(good_case).identify.sensitivities, "direct");
  EXPECT_EQ(read(changed(good_case, "element: hex8", "element: hex8s")).identify.sensitivities, "perturbed");
  EXPECT_EQ(read(changed(good_case, "functional: force_driven", "functional: force_driven\n  groups: 2"))
                .identify.sensitivities,
            "perturbed");
  const std::string pulled = changed(good_case, "functional: force_driven", "functional: force_driven\n  alpha: 0.1");
  EXPECT_EQ(read(pulled).identify.sensitivities, "perturbed");
  EXPECT_EQ(read(changed(pulled, "alpha: 0.1", "alpha: 0.1\n  sensitivities: direct")).identify.sensitivities,
            "direct");
  EXPECT_EQ(mistakes(changed(good_case, "element: hex8", "element: hex8s, kinematics: plane_stress")),
            "case.yaml:4 specimen.element: hex8s with kinematics: plane_stress; allowed: quad4, quad8; hex8r, hex8s "
            "with kinematics: 3d");
}

TEST_F(CaseFile, EveryMistakeIsNamedInOneGo) {
  EXPECT_EQ(
      mistakes(R"(title: 12
units: {lenght: mm, force: t}
specimen:
  mesh: missing.msh
  thickness: -8
  thickness: 7
  layers: 2.5
  held: bottom
  loaded: top
cameras:
  - {model: fisheye, pixel_size: .nan, place: {points: [[1, 2, 3]]}, images: "right/*.png"}
material: {law: j3, parameters: {E: abc, nu: {value: 0.3, uper: 2}}}
colour: red
)",
               {}),
      "case.yaml:1 title: 12; allowed: a text\n"
      "case.yaml:2 units.force: \"t\"; allowed: N, kN\n"
      "case.yaml:2 units.lenght: unknown key, near to length; allowed: force, length, time\n"
      "case.yaml:4 specimen.mesh: no such file: missing.msh; allowed: a .msh or .inp file\n"
      "case.yaml:5 specimen.thickness: -8; allowed: a positive number [mm]\n"
      "case.yaml:6 specimen.thickness: key given twice (first in line 5); allowed: each key once\n"
      "case.yaml:7 specimen.layers: 2.5; allowed: an integer from 1 to 100\n"
      "case.yaml:11 cameras[0].pixel_size: .nan; allowed: a finite number\n"
      "case.yaml:11 cameras[0].model: \"fisheye\"; allowed: telecentric, pinhole\n"
      "case.yaml:11 cameras[0].place.points: a list of 1; allowed: a list of at least 2 rows [x, y, column, row]\n"
      "case.yaml:11 cameras[0].place.points[0]: a list of 3; allowed: a row [x, y, column, row]\n"
      "case.yaml:11 cameras[0].images: no file \"right/*.png\"; allowed: images that exist\n"
      "case.yaml:12 material.law: \"j3\"; allowed: j2, elastic\n"
      "case.yaml:12 material.parameters.E: \"abc\"; allowed: a number, or {value, lower, upper}\n"
      "case.yaml:12 material.parameters.nu.uper: unknown key, near to upper; allowed: lower, upper, value\n"
      "case.yaml:13 colour: unknown key; allowed: cameras, dic, effects, experiments, fields, identify, loads, loop, "
      "material, output, simulate, "
      "specimen, tests, title, units, virtual");
}

TEST_F(CaseFile, PinholeCamerasAndTheSpecimensPlace) {
  folder.write("cal.xml", "");
  const std::string start = "title: stereo\nspecimen: {mesh: plate.msh";
  const std::string cameras =
      "}\ncameras:\n"
      "  - {name: left, model: pinhole, calibration: cal.xml, images: \"left/*.png\"}\n"
      "  - {name: right, model: pinhole, calibration: cal.xml, images: \"left/*.png\"}\n";
  const std::string place =
      ", place: {camera: right, points: [[0, 0, 1, 2], [10, 0, 20, 2], [0, 5, 1, 12]], shape: 4, refine_cameras: true}";
  const Case test = read(start + place + cameras);
  EXPECT_EQ(test.cameras[0].index, 0);
  EXPECT_EQ(test.cameras[1].index, 1);  // the next of the same file
  EXPECT_EQ(test.cameras[1].calibration.filename(), "cal.xml");
  ASSERT_TRUE(test.specimen.place);
  EXPECT_EQ(test.specimen.place->points.size(), 3U);
  EXPECT_EQ(test.specimen.place->camera, "right");
  EXPECT_EQ(test.specimen.place->shape, 4.0);
  EXPECT_TRUE(test.specimen.place->refine_cameras);

  EXPECT_THAT(mistakes(start + cameras), HasSubstr("specimen.place: not given"));
  EXPECT_THAT(
      mistakes(start + ", place: {camera: rihgt, points: [[0, 0, 1, 2], [10, 0, 20, 2], [0, 5, 1, 12]]}" + cameras),
      HasSubstr("one of left, right"));
  EXPECT_THAT(mistakes(start + ", place: {points: [[0, 0, 1, 2], [10, 0, 20, 2]]}" + cameras),
              HasSubstr("at least 3 rows"));
  EXPECT_THAT(mistakes(start + place + "}\ncameras: [{name: right, model: pinhole, images: \"left/*.png\"}]\n"),
              HasSubstr("calibration: not given"));
  EXPECT_THAT(mistakes(start + place +
                       "}\ncameras: [{name: right, model: pinhole, calibration: none.xml, pixel_size: 0.1, images: "
                       "\"left/*.png\"}]\n"),
              ::testing::AllOf(HasSubstr("no such file"), HasSubstr("given for a pinhole camera")));
  EXPECT_THAT(
      mistakes(
          start + place +
          "}\ncameras: [{calibration: cal.xml, pixel_size: 0.1, place: {auto: outline}, images: \"left/*.png\"}]\n"),
      ::testing::AllOf(HasSubstr("only with model: pinhole"), HasSubstr("given without a pinhole camera")));
  std::string other = cameras;
  other.insert(other.size() - 2, ", reference: 0-1");
  EXPECT_THAT(mistakes(start + place + other),
              HasSubstr("cameras[1].reference: 0,1; allowed: 0 as for left: all cameras record at once"));
}

TEST_F(CaseFile, CamerasOfBothFaces) {
  folder.write("cal.xml", "");
  const std::string start = "title: faces\nspecimen: {mesh: plate.msh}\ncameras:\n";
  const Case test = read(
      start +
      "  - {name: mono, pixel_size: 0.1, place: {auto: outline}, images: \"left/*.png\", calibration_sd: {pixel_size: "
      "1e-4}}\n"
      "  - {name: back, model: pinhole, face: back, frame: specimen, calibration: cal.xml, images: \"left/*.png\"}\n");
  EXPECT_EQ(test.cameras[0].face, "front");
  EXPECT_EQ(test.cameras[0].calibration_sd.at("pixel_size"), 1e-4);
  EXPECT_EQ(test.cameras[1].face, "back");
  EXPECT_EQ(test.cameras[1].frame, "specimen");
  const Case made = read(start +
                         "  - {model: pinhole, size: [300, 200], view: {focal: 5000, from: [1, 2, -300], at: [0, 0, "
                         "-4], roll: 3, distortion: [0.1]}}\n");
  EXPECT_EQ(made.cameras[0].view->focal, 5000.0);
  EXPECT_EQ(made.cameras[0].view->from[2], -300.0);
  EXPECT_EQ(made.cameras[0].view->distortion, std::vector<double>{0.1});
  EXPECT_EQ((*made.cameras[0].size)[1], 200);
  EXPECT_THAT(mistakes(start + "  - {face: side, pixel_size: 0.1, place: {auto: outline}, images: \"left/*.png\"}\n"),
              HasSubstr("allowed: front, back"));
  EXPECT_THAT(
      mistakes(start + "  - {frame: specimen, pixel_size: 0.1, place: {auto: outline}, images: \"left/*.png\"}\n"),
      HasSubstr("only with model: pinhole"));
  EXPECT_THAT(mistakes("title: faces\nspecimen: {mesh: plate.msh, place: {points: [[0, 0, 1, 2], [10, 0, 20, 2], [0, "
                       "5, 1, 12]]}}\ncameras:\n"
                       "  - {name: a, model: pinhole, calibration: cal.xml, images: \"left/*.png\"}\n"
                       "  - {name: b, model: pinhole, face: back, calibration: cal.xml, images: \"left/*.png\"}\n"),
              HasSubstr("specimen.place places one rig"));
}

TEST_F(CaseFile, NumbersAreNumbersAndTextsAreTexts) {
  EXPECT_EQ(read(changed(good_case, "8.0", "+.8e1")).specimen.thickness, 8.0);
  EXPECT_EQ(mistakes(changed(good_case, "8.0", "\"8.0\"")),
            "case.yaml:4 specimen.thickness: \"8.0\"; allowed: a positive number [mm]");
  for (const char* text : {".inf", "-.inf", "NaN", "1e999"})
    EXPECT_EQ(mistakes(changed(good_case, "8.0", text)),
              std::string("case.yaml:4 specimen.thickness: ") + text + "; allowed: a finite number");
  EXPECT_THAT(mistakes(changed(good_case, "8.0", "8,0")), HasSubstr("; the decimal sign is the point"));
  EXPECT_EQ(mistakes(changed(good_case, "8.0", "")),
            "case.yaml:4 specimen.thickness: nothing; allowed: a positive number [mm]");
}

TEST_F(CaseFile, ParametersAreThoseOfTheMaterial) {
  EXPECT_EQ(
      mistakes(changed(good_case, "nu: 0.25, S_y", "nu: 0.6, Sy")),
      "case.yaml:9 material.parameters.nu: 0.6; allowed: a number from 0 to 0.499 [-]\n"
      "case.yaml:9 material.parameters.S_y: not given; allowed: a number from 0.001 [MPa]\n"
      "case.yaml:9 material.parameters.Sy: not a parameter of this material, near to S_y; allowed: E, nu, S_y, H, "
      "delta");
  EXPECT_EQ(
      mistakes(changed(good_case, "lower: 100, upper: 1e4", "lower: 2000, upper: 1e4")),
      "case.yaml:9 material.parameters.H: value 1480; allowed: a value between its bounds, from 2000, up to 10000");
  EXPECT_EQ(mistakes(changed(good_case, "lower: 100, upper: 1e4", "lower: 1e4, upper: 1e4")),
            "case.yaml:9 material.parameters.H: lower 10000, upper 10000; allowed: lower below upper");
}

TEST_F(CaseFile, GroupsAreThoseOfTheMesh) {
  EXPECT_EQ(mistakes(changed(changed(good_case, "held: bottom", "held: botom"), " thickness: 8.0,", "")),
            "case.yaml:4 specimen.held: no group \"botom\", near to bottom; allowed: bottom, hole, top\n"
            "case.yaml:4 specimen.thickness: not given; allowed: a positive number [mm]");
  EXPECT_EQ(mistakes(changed(good_case, "held: bottom, loaded: top", "held: top, loaded: top")),
            "case.yaml:4 specimen.loaded: top; allowed: another group than held");
  EXPECT_EQ(mistakes(changed(good_case, "held: bottom, ", "")),
            "case.yaml:4 specimen.held: not given; allowed: the name of a group of the mesh");
}

TEST_F(CaseFile, FramesMustExist) {
  EXPECT_EQ(mistakes(changed(good_case, "1-11", "1-40")),
            "case.yaml:15 identify.stages[2].frames: frames 1-40; allowed: among the frames 0-11");
  EXPECT_EQ(mistakes(changed(good_case, "\"1-5\"", "12")),
            "case.yaml:13 identify.stages[0].frames: frame 12; allowed: one of the frames 0-11");
  EXPECT_THAT(mistakes(changed(good_case, "1-11", "one to eleven")),
              HasSubstr("\"one to eleven\"; allowed: frame numbers"));
  const Case test = read(changed(good_case, "  stages", "  held_out: \"0-11:4\"\n  stages"));
  EXPECT_THAT(test.identify.held_out, ElementsAre(0, 4, 8));
  EXPECT_THAT(test.identify.stages[0].frames, ElementsAre(1, 2, 3, 5));
}

TEST_F(CaseFile, ImagesAreAlikeAndHaveLoads) {
  cv::imwrite((folder.path() / "left/frame_3.png").string(), cv::Mat(24, 30, CV_8U, cv::Scalar(0)));
  cv::imwrite((folder.path() / "left/frame_4.png").string(), cv::Mat(24, 32, CV_16U, cv::Scalar(0)));
  folder.write("left/frame_5.png", "this is no image, but it is long enough for one");
  fs::resize_file(folder.path() / "left/frame_6.png", fs::file_size(folder.path() / "left/frame_6.png") - 8);
  std::string loads = "frame,t_s,F_N\n";
  for (int i : {0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11}) loads += std::to_string(i) + ",1,100\n";
  folder.write("loads.csv", loads);
  EXPECT_EQ(mistakes(good_case),
            "left/frame_3.png: 30 x 24 px; allowed: 32 x 24 px as in left/frame_0.png\n"
            "left/frame_4.png: 16 bits; allowed: 8 bits as in left/frame_0.png\n"
            "left/frame_5.png: not an image; allowed: a PNG, TIFF or BMP image\n"
            "left/frame_6.png: an incomplete file; allowed: a whole image\n"
            "loads.csv: no row for frame 7 (left/frame_7.png); allowed: a row for each image");
}

TEST_F(CaseFile, HeadersOfEveryFormat) {
  fs::remove_all(folder.path() / "left");
  fs::create_directory(folder.path() / "left");
  for (const char* name : {"0.tif", "1.bmp", "2.png"})
    ASSERT_TRUE(cv::imwrite((folder.path() / "left" / name).string(), cv::Mat(24, 32, CV_8U, cv::Scalar(0))));
  ASSERT_TRUE(cv::imwrite((folder.path() / "left/3.tif").string(), cv::Mat(50, 32, CV_16U, cv::Scalar(0))));
  auto text = changed(good_case, "\"left/*.png\"", "\"left/*\", frames: sequence");
  for (const char* frames : {"1-5", "1-10", "1-11"}) text = changed(text, frames, "0-3");
  EXPECT_EQ(mistakes(text),
            "left/3.tif: 32 x 50 px; allowed: 32 x 24 px as in left/0.tif\n"
            "left/3.tif: 16 bits; allowed: 8 bits as in left/0.tif");
  fs::resize_file(folder.path() / "left/0.tif", fs::file_size(folder.path() / "left/0.tif") / 2);
  fs::resize_file(folder.path() / "left/1.bmp", fs::file_size(folder.path() / "left/1.bmp") - 8);
  EXPECT_THAT(mistakes(text), HasSubstr("left/0.tif: an incomplete file"));
  EXPECT_THAT(mistakes(text), HasSubstr("left/1.bmp: an incomplete file"));
}

TEST_F(CaseFile, ImagesFromTheLoadRecordKeepItsFrameNumbers) {
  folder.write("loads.csv",
               "frame,t_s,F_kN,image_file\n0,0,0,left/frame_0.png\n1,1,1,\n2,2,2,left/frame_1.png\n"
               "5,3,2.5,left/frame_2.png\n9,4,3,left/frame_3.png\n");
  auto text = changed(good_case, "\"left/*.png\"", "from_loads, reference: \"0,2\"");
  text = changed(text, "force: F_N", "force: F_kN, force_unit: kN");
  for (const char* frames : {"1-5", "1-10", "1-11"}) text = changed(text, frames, "1-9");
  const Case test = read(text);
  EXPECT_THAT(test.frames, ElementsAre(0, 2, 5, 9));
  EXPECT_THAT(test.cameras[0].reference, ElementsAre(0, 2));
  EXPECT_THAT(test.identify.stages[0].frames, ElementsAre(2, 5, 9));
  EXPECT_EQ(test.index_of(5), 2);
  EXPECT_EQ(test.load(2).force, 2500.0);
  EXPECT_THROW((void)test.index_of(1), std::out_of_range);
}

TEST_F(CaseFile, ImagesCanBeNumberedByNameOrList) {
  for (const char* name : {"left/frame_11.png", "left/frame_10.png", "left/frame_7.png"})
    fs::remove(folder.path() / name);
  for (const char* frames : {"from_names", "\"0-6,8,9\"", "[0, 1, 2, 3, 4, 5, 6, 8, 9]"}) {
    auto text = changed(good_case, "images:", std::string("frames: ") + frames + ", images:");
    text = changed(changed(text, "1-10", "1-9"), "1-11", "1-9");
    EXPECT_EQ(read(text).index_of(9), 8) << frames;
  }
  auto counted = changed(changed(good_case, "1-10", "1-8"), "1-11", "1-8");
  EXPECT_EQ(
      mistakes(counted),
      "case.yaml:6 cameras[0].images: 9 images; allowed: 12, one for each row of loads.csv; else say which they are: "
      "frames: from_names, or a list");
  EXPECT_EQ(mistakes(changed(counted, "images:", "frames: sequence, images:")), "none");
  EXPECT_THAT(mistakes(changed(good_case, "images:", "frames: \"0-7\", images:")),
              HasSubstr("cameras[0].frames: 8 frames; allowed: 9, one for each image"));
}

TEST_F(CaseFile, WhatTheEquilibriumGapNeedsIsSaid) {
  const auto gap = changed(good_case, "functional: force_driven", "functional: equilibrium_gap");
  EXPECT_EQ(
      mistakes(gap),
      "case.yaml:10 identify.alpha: not given, or 0, with functional: equilibrium_gap; allowed: above 0, e.g. 1e-3\n"
      "case.yaml:11 identify.functional: equilibrium_gap in 3D; allowed: specimen.kinematics: plane_stress\n"
      "case.yaml:11 identify.functional: equilibrium_gap with law: j2; allowed: law: elastic");
  EXPECT_THAT(mistakes(changed(good_case, "force_driven", "combined\n  alpha: 0.1")),
              HasSubstr("identify.alpha: 0.1 with functional: combined"));
}

TEST_F(CaseFile, TheDrivingDisplacementMustBeThere) {
  const auto driven = changed(good_case, "force_driven", "force_driven\n  driving: other.h5");
  EXPECT_THAT(mistakes(driven), HasSubstr("other.h5; allowed: results.h5 of `imic3d dic`"));
  folder.write("other.h5", "");
  EXPECT_EQ(read(driven).identify.driving, folder.path() / "other.h5");
}

TEST_F(CaseFile, AnEndThatLiesAcrossTheAxisIsDoubted) {
  CaseChecks checks = all_checks;
  checks.read_mesh = [](const fs::path& file) {
    mesh::Mesh mesh = plate_mesh(file);
    mesh.nodes.row(0) << 1.0, 20.0, 0.0;  // top
    return mesh;
  };
  EXPECT_TRUE(read(good_case, checks).doubts.empty());
  const auto doubts = read(changed(good_case, "axis: y", "axis: x"), checks).doubts;
  ASSERT_EQ(doubts.size(), 1U);
  EXPECT_THAT(doubts[0], HasSubstr("specimen.axis: x, but the middle of \"top\" lies along y from that of \"bottom\""));
}

TEST_F(CaseFile, EndsThatArePointsOrSidesAreDoubted) {
  CaseChecks checks = all_checks;
  std::vector<int> top{6, 7, 8};
  checks.read_mesh = [&](const fs::path&) {
    mesh::Mesh mesh;  // 2 x 2 quadrilaterals, the nodes in rows
    mesh.nodes.setZero(9, 3);
    for (int node = 0; node < 9; ++node) mesh.nodes.row(node) << node % 3, 3.0 * (node / 3), 0.0;
    mesh.cells.resize(4, 4);
    mesh.cells << 0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7;
    mesh.node_groups = {{"top", top}, {"bottom", {0, 1, 2}}};
    return mesh;
  };
  EXPECT_TRUE(read(good_case, checks).doubts.empty());
  top = {6, 8};
  EXPECT_THAT(
      read(good_case, checks).doubts,
      ElementsAre("specimen.loaded: 2 nodes, among which no whole side of an element: is a group of points meant?"));
  top = {2, 5, 8};
  EXPECT_THAT(read(good_case, checks).doubts,
              ElementsAre("specimen.loaded: its nodes lie on a line along y, the axis of the load: a side, no end"));
}

TEST_F(CaseFile, UnitsOfNoSolidAreDoubted) {
  const auto doubts = [&](const std::string& from, const std::string& to) {
    return read(changed(good_case, from, to), all_checks).doubts;
  };
  const auto units = testing::Contains(HasSubstr("material.parameters."));
  EXPECT_THAT(doubts("length: mm", "length: m"), testing::Contains(HasSubstr("softer than rubber")));
  EXPECT_THAT(doubts("E: 198e3", "E: 198"), testing::Contains(HasSubstr("it would yield at a strain of")));
  EXPECT_THAT(read(good_case).doubts, testing::Not(units));
}

TEST_F(CaseFile, WhatTheCommandNeedsMustBeThere) {
  EXPECT_EQ(mistakes("title: x\nspecimen: {mesh: plate.msh}\n",
                     {.parameters_of = {}, .read_mesh = {}, .sections = {"cameras", "loads"}}),
            "case.yaml:1 cameras: not given; allowed: a section cameras\n"
            "case.yaml:1 loads: not given; allowed: a section loads");
  // One message where bars are given to a command that simulates a mesh.
  EXPECT_THAT(mistakes("title: x\nexperiments:\n  - {name: a, file: a.csv, strain: e, stress: s}\n",
                       {.parameters_of = {}, .read_mesh = {}, .sections = {"specimen", "material", "simulate"}}),
              testing::AllOf(HasSubstr("experiments: bars, which have no mesh"),
                             testing::Not(HasSubstr("a section simulate"))));
}

TEST_F(CaseFile, WhatIsNotACaseFile) {
  EXPECT_EQ(mistakes("title: [a\nspecimen: {"), "case.yaml:2: not YAML at column 9: end of sequence flow not found");
  // yaml-cpp's own reader of several documents never ends here.
  EXPECT_THAT(mistakes(", lower: 1}\n"), testing::HasSubstr("case.yaml: no sections"));
  EXPECT_THAT(mistakes(good_case + "---\ntitle: another\n"), testing::HasSubstr("case.yaml: several YAML documents"));
  EXPECT_EQ(mistakes("a: &x {b: *x}"), "case.yaml:1: too many levels or values; allowed: a plain case file");
  EXPECT_THAT(mistakes(""), HasSubstr("no sections"));
  EXPECT_THAT(mistakes("just a text"), HasSubstr("no sections"));
  EXPECT_THROW((void)read_case("nowhere.yaml"), InputError);
  EXPECT_THROW((void)read_case("/tmp"), InputError);
}

TEST(CaseFileMeasured, TensionTest) {
  const char* given = std::getenv("IMIC3D_DATA");
  const fs::path data = given ? fs::path(given) : fs::path(IMIC3D_SOURCE_DIRECTORY) / "../shared/data";
  if (!fs::exists(data)) GTEST_SKIP() << "no measured data at " << data << " (IMIC3D_DATA)";
  const TemporaryFolder folder;
  folder.write("dumbbell.msh", "");
  const auto file =
      folder.write("case.yaml",
                   "title: PC/ABS\n"
                   "specimen: {mesh: dumbbell.msh, thickness: 3.2, held: left, loaded: right, axis: x}\n"
                   "cameras: [{pixel_size: 0.03929, place: {auto: outline}, images: from_loads, reference: \"0-2\"}]\n"
                   "loads: {file: " +
                       (data / "pcabs_tension/frames.csv").string() +
                       ", force: force_kN, force_unit: kN}\n"
                       "material: {parameters: {E: 2000, nu: 0.4}}\n"
                       "identify: {stages: [{free: [E], frames: \"0-58\"}], held_out: \"100-278\"}\n");
  const Case test = read_case(file);
  EXPECT_EQ(test.frames.size(), 51U);
  EXPECT_EQ(test.identify.stages[0].frames.size(), 36U);
  EXPECT_NEAR(test.load(test.index_of(8)).force, 60.81, 1e-9);
}

}  // namespace test_case
}  // namespace imic3d::io
