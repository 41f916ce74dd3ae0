// Files that once made the readers of cases, load records and images fail in another way than with an InputError
// (tests/fuzz).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "../../src/io/yaml_document.hpp"
#include "../fuzz/case_input.hpp"
#include "../fuzz/image_input.hpp"
#include "../fuzz/loads_input.hpp"
#include "temporary_folder.hpp"

namespace imic3d {
namespace test_found {

template <class Read>
int read_all(const char* kind, const Read& read) {
  int files = 0;
  fuzz::for_each_found(std::string(IMIC3D_SOURCE_DIRECTORY "/tests/fuzz/found/") + kind,
                       [&](const std::string& name, const std::uint8_t* data, std::size_t size) {
                         EXPECT_NO_THROW(read(data, size)) << kind << "/" << name;
                         ++files;
                       });
  return files;
}

TEST(Found, CasesLoadsAndImagesGiveAResultOrAnInputError) {
  EXPECT_GE(read_all("case", fuzz::case_file), 4);
  EXPECT_GE(read_all("loads", fuzz::loads), 1);
  EXPECT_GE(read_all("image", fuzz::image), 6);
}

// A decoder holds a whole strip: 65524 x 2560 pixels here, of a file of 380 bytes.
TEST(Found, StripsThatPromiseMoreThanTheFileHoldsAreRefused) {
  try {
    (void)imaging::read_image(IMIC3D_SOURCE_DIRECTORY "/tests/fuzz/found/image/tiff_of_long_strips");
    ADD_FAILURE();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("in 380 bytes, in strips or tiles of 167741440 pixels"));
  }
}

TEST(Found, TiffOfTwoWidthsIsRefused) {
  // The first of its widths makes strips of 671 MB, the second is one pixel.
  EXPECT_THROW((void)imaging::read_image(IMIC3D_SOURCE_DIRECTORY "/tests/fuzz/found/image/tiff_of_two_widths"),
               InputError);
  EXPECT_THROW((void)imaging::read_header(IMIC3D_SOURCE_DIRECTORY "/tests/fuzz/found/image/tiff_of_two_widths"),
               InputError);
}

TEST(Found, AScalarOfAMegabyteIsReadWithoutRecursion) {
  const io::TemporaryFolder folder;
  const auto document = io::read_yaml(folder.write("case.yaml", "title: " + std::string(1'000'000, '7') + "x\n"));
  EXPECT_EQ(document.root["title"].get<std::string>().size(), 1'000'001U);
}

TEST(Found, TextThatIsNotUtf8IsRefusedWithItsLine) {
  const io::TemporaryFolder folder;
  for (const std::string good : {"Pr\xc3\xbc"
                                 "fung",
                                 "\xe2\x82\xac", "\xf0\x9f\x94\xa7"})
    EXPECT_NO_THROW((void)io::read_yaml(folder.write("case.yaml", "a: 1\ntitle: " + good + "\n"))) << good;
  for (const std::string bad : {"Pr\xfc"
                                "fung",
                                "\xc3", "\xe2\x82", "\xc0\xaf", "\xed\xa0\x80", "\xf5\x80\x80\x80"}) {
    try {
      (void)io::read_yaml(folder.write("case.yaml", "a: 1\ntitle: " + bad + "\n"));
      ADD_FAILURE() << bad;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), ::testing::AllOf(::testing::HasSubstr("case.yaml:2"), ::testing::HasSubstr("UTF-8")));
    }
  }
}

TEST(Found, PlainScalarsAreWhatYamlSaysTheyAre) {
  const io::TemporaryFolder folder;
  const auto root = io::read_yaml(folder.write("case.yaml",
                                               "a: [12, -3, +4, 1.5, .5, 5., 1e3, -1.e-2, +.5E+1, 12a, 1e, e3, ., -, "
                                               "1.2.3, +-1, 1e+, 0x10, infinity]\n"))
                        .root["a"];
  const std::vector<nlohmann::json> expected{12,   -3,   4,   1.5, 0.5,     5.0,   1000.0, -0.01,  5.0,       "12a",
                                             "1e", "e3", ".", "-", "1.2.3", "+-1", "1e+",  "0x10", "infinity"};
  EXPECT_EQ(root.get<std::vector<nlohmann::json>>(), expected);
  const auto mistakes = io::read_yaml(folder.write("case.yaml", "a: [.inf, -.INF, nan, +inf, 1e999]\n")).mistakes;
  EXPECT_EQ(mistakes.size(), 5U);
}

}  // namespace test_found
}  // namespace imic3d
