#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "imic3d/core/error.hpp"
#include "imic3d/io/frames.hpp"

namespace imic3d::io {
namespace test_frames {

using ::testing::ElementsAre;

TEST(Frames, AreWrittenAsNumbersRangesAndSteps) {
  EXPECT_THAT(expand(parse_frames("1-5")), ElementsAre(1, 2, 3, 4, 5));
  EXPECT_THAT(expand(parse_frames("0,2, 7-9")), ElementsAre(0, 2, 7, 8, 9));
  EXPECT_THAT(expand(parse_frames("10-40:5")), ElementsAre(10, 15, 20, 25, 30, 35, 40));
  EXPECT_THAT(expand(parse_frames("3-4,1-3,2")), ElementsAre(1, 2, 3, 4));
}

TEST(Frames, AnythingElseIsRefused) {
  for (const char* text : {"", "a", "1-", "-1", "5-1", "1-5:0", "1,,2", "1-5:", "1.5", "1-2-3", "9999999999"})
    EXPECT_THROW(parse_frames(text), InputError) << text;
}

TEST(Frames, ARangeSelectsThoseThatHaveAnImage) {
  const Frames available{0, 1, 2, 4, 6, 10, 20};
  EXPECT_THAT(select(parse_frames("1-6"), available), ElementsAre(1, 2, 4, 6));
  EXPECT_THAT(select(parse_frames("0-20:4"), available), ElementsAre(0, 4, 20));
  EXPECT_THAT(select(parse_frames("20,1-4"), available), ElementsAre(1, 2, 4, 20));
  EXPECT_THROW(select(parse_frames("3"), available), InputError);
  EXPECT_THROW(select(parse_frames("7-9"), available), InputError);
  EXPECT_THROW(select(parse_frames("10-21"), available), InputError);
}

TEST(Frames, AreShownInShort) {
  EXPECT_EQ(to_text({0, 1, 2, 3, 7, 9, 10}), "0-3,7,9,10");
  EXPECT_EQ(to_text({}), "(none)");
  const Frames many{0, 1, 2, 5, 6, 7, 8, 20};
  EXPECT_EQ(expand(parse_frames(to_text(many))), many);
}

}  // namespace test_frames
}  // namespace imic3d::io
