#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "imic3d/imaging/compression.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/imaging/noise.hpp"

namespace imic3d::imaging {
namespace test_image {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Files : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder); }
  void TearDown() override { fs::remove_all(folder); }
  const fs::path folder = fs::temp_directory_path() / ("imic3d_images_" + std::to_string(getpid()));
};

Image ramp(int width, int height, int depth) {
  Image image(width, height, depth);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) image(x, y) = static_cast<float>((x * 7 + y * 131) % (depth == 16 ? 60000 : 250));
  return image;
}

using ImageFiles = Files;

TEST_F(ImageFiles, AreReadAsTheyWereWritten) {
  for (const char* name : {"a.tif", "a.png", "a.bmp", "b.tif", "b.png"}) {
    const int depth = name[0] == 'a' ? 8 : 16;
    const Image written = ramp(37, 23, depth);
    write_image(written, folder / name);
    EXPECT_EQ(read_header(folder / name), written.header()) << name;
    const Image read = read_image(folder / name);
    EXPECT_EQ(read.header(), written.header()) << name;
    EXPECT_EQ(read.grey, written.grey) << name;
  }
}

TEST_F(ImageFiles, GreyLevelsAreRoundedAndClipped) {
  Image image(2, 2);
  image.grey = {-3.0F, 12.6F, 254.4F, 300.0F};
  write_image(image, folder / "clipped.png");
  EXPECT_EQ(read_image(folder / "clipped.png").grey, (std::vector<float>{0.0F, 13.0F, 254.0F, 255.0F}));
}

TEST_F(ImageFiles, ColourBecomesGrey) {
  const cv::Mat red(4, 5, CV_8UC3, cv::Scalar(0, 0, 200));
  for (const char* name : {"red.png", "red.tif"}) {
    cv::imwrite((folder / name).string(), red);
    EXPECT_EQ(read_header(folder / name), (ImageHeader{5, 4, 8}));
    EXPECT_NEAR(read_image(folder / name)(2, 2), 0.299 * 200, 0.6);
  }
}

TEST_F(ImageFiles, MistakesNameTheFile) {
  const auto message = [](const fs::path& file) -> std::string {
    try {
      (void)read_image(file);
    } catch (const InputError& error) {
      return error.what();
    }
    return "nothing was thrown";
  };
  EXPECT_THAT(message(folder / "absent.tif"), HasSubstr("absent.tif: no such file"));
  EXPECT_THAT(message(folder), HasSubstr("not a file"));
  std::ofstream(folder / "text.png") << "not an image";
  EXPECT_THAT(message(folder / "text.png"), HasSubstr("cannot be decoded"));
  cv::imwrite((folder / "float.tif").string(), cv::Mat(4, 4, CV_32F, cv::Scalar(1.0)));
  EXPECT_THAT(message(folder / "float.tif"), HasSubstr("8 or 16 bits"));
  EXPECT_THROW(write_image(Image(2, 2), folder / "no" / "folder.png"), InputError);
  EXPECT_THROW(write_image(Image(2, 2), folder / "twelve.png", 12), InputError);
  EXPECT_THROW(write_image(Image(2, 2), folder / "deep.bmp", 16), InputError);
}

TEST_F(ImageFiles, SequenceIsCheckedAndAveraged) {
  Image a(8, 6, 8, 10.0F), b(8, 6, 8, 14.0F), wide(9, 6), deep(8, 6, 16);
  std::vector<fs::path> files;
  for (const auto& [name, image] :
       {std::pair<const char*, Image*>{"0.tif", &a}, {"1.tif", &b}, {"2.tif", &wide}, {"3.tif", &deep}}) {
    write_image(*image, folder / name);
    files.push_back(folder / name);
  }
  files.push_back(folder / "4.tif");
  const ImageSequence sequence(files);
  const std::vector<Mistake> mistakes = sequence.check();
  ASSERT_EQ(mistakes.size(), 3U);
  EXPECT_EQ(mistakes[0].place, (folder / "2.tif").string());
  EXPECT_EQ(mistakes[0].found, "9 x 6 pixels of 8 bits");
  EXPECT_EQ(mistakes[1].found, "8 x 6 pixels of 16 bits");
  EXPECT_EQ(mistakes[2].found, "no such file");
  EXPECT_THROW((void)sequence.read(2), InputError);
  EXPECT_THROW((void)sequence.read(7), InputError);
  EXPECT_FLOAT_EQ(sequence.reference(std::vector<int>{0, 1})(3, 3), 12.0F);
  EXPECT_THROW((void)sequence.reference(std::vector<int>{}), InputError);
}

TEST_F(ImageFiles, OfAHundredMegapixelsAreRead) {
  write_image(Image(12000, 9000, 8, 77.0F), folder / "large.png");
  const Image image = read_image(folder / "large.png");
  EXPECT_EQ(image.width, 12000);
  EXPECT_EQ(image(11999, 8999), 77.0F);
}

/// Each block of 8 x 8 px loses the upper half of its cosines, as at a strong compression; the image may be a part of a
/// larger one.
TEST(Compression, BlocksAreFoundWhereThereAreAny) {
  std::mt19937 generator(6);
  std::normal_distribution<float> noise(0.0F, 3.0F);
  const int width = 200, height = 160;
  Image plain(width, height), compressed(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      plain(x, y) = std::round(120.0F +
                               40.0F * std::sin(0.9F * static_cast<float>(x) + 0.3F * static_cast<float>(y)) *
                                   std::cos(0.7F * static_cast<float>(y)) +
                               noise(generator));
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const int left = x / 8 * 8, top = y / 8 * 8;
      double sum = 0.0;
      for (int u = 0; u < 4; ++u)
        for (int v = 0; v < 4; ++v) {
          double amplitude = 0.0;
          const auto wave = [](int frequency, int place) {
            return std::cos(M_PI * frequency * (place + 0.5) / 8.0) * (frequency == 0 ? std::sqrt(0.125) : 0.5);
          };
          for (int j = 0; j < 8; ++j)
            for (int i = 0; i < 8; ++i) amplitude += plain(left + i, top + j) * wave(u, i) * wave(v, j);
          sum += amplitude * wave(u, x - left) * wave(v, y - top);
        }
      compressed(x, y) = static_cast<float>(std::round(sum));
    }
  Image part(width - 13, height - 21);
  for (int y = 0; y < part.height; ++y)
    for (int x = 0; x < part.width; ++x) part(x, y) = compressed(x + 5, y + 11);
  EXPECT_EQ(block_excess(plain), 0.0);
  EXPECT_GT(block_excess(compressed), 0.1);
  EXPECT_GT(block_excess(part), 0.1);
  Image columns = plain;  // every eighth column reads too much, as of a sensor: no blocks
  for (int y = 0; y < height; ++y)
    for (int x = 3; x < width; x += 8) columns(x, y) += 20.0F;
  EXPECT_EQ(block_excess(columns), 0.0);
  EXPECT_EQ(block_excess(Image(50, 50, 8, 100.0F)), 0.0);
  EXPECT_EQ(block_excess(Image(200, 200, 8, 100.0F)), 0.0);
}

TEST(Noise, OfStaticFramesIsFoundDespiteQuantisationAndOutliers) {
  std::mt19937 generator(5);
  for (const double sigma : {0.6, 1.0, 1.53, 2.0, 2.6, 5.0}) {
    std::normal_distribution<float> noise(0.0F, static_cast<float>(sigma));
    std::vector<Image> frames;
    for (int k = 0; k < 3; ++k) {
      Image frame = ramp(200, 200, 8);
      for (float& g : frame.grey) g = std::round(g + 20.0F + static_cast<float>(k) + noise(generator));
      for (int x = 0; x < 20; ++x) frame(x, 50 + k) = 255.0F;  // a reflection that moves
      frames.push_back(frame);
    }
    // Rounding adds a twelfth to the variance.
    EXPECT_NEAR(noise_of_static_frames(frames), std::sqrt(sigma * sigma + 1.0 / 12), 0.01 * sigma) << sigma;
  }
  const std::vector<Image> one(1, Image(3, 3));
  EXPECT_THROW((void)noise_of_static_frames(one), InputError);
}

}  // namespace test_image
}  // namespace imic3d::imaging
