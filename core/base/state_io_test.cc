// SPDX-License-Identifier: Apache-2.0
#include "core/base/state_io.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <new>

#include "core/base/paced_yields.h"
#include "core/base/yields_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

enum class Colour { kRed, kGreen, kLast = kGreen };

// Has the interface of an Eigen matrix of fixed size; base does not depend on Eigen.
struct Matrix2 {
  static constexpr int SizeAtCompileTime = 4;
  std::array<double, 4> elements{};
  double* data() { return elements.data(); }
  const double* data() const { return elements.data(); }
  friend bool operator==(const Matrix2&, const Matrix2&) = default;
};

struct Point {
  int16_t x = 0;
  double y = 0.0;
  static void VisitState(auto& archive, auto& self) {
    auto& [x, y] = self;
    archive(x, Finite(y));
  }
  friend bool operator==(const Point&, const Point&) = default;
};

// Saves and loads itself.
class Countdown {
 public:
  explicit Countdown(int left = 0) : left_(left) {}
  void SaveState(StateWriter& writer) const { writer(left_); }
  void LoadState(StateReader& reader) { reader(InRange(left_, -1, 10)); }
  friend bool operator==(const Countdown&, const Countdown&) = default;

 private:
  int left_;
};

struct Everything {
  bool flag = false;
  uint8_t small = 0;
  int64_t large = 0;
  float single = 0.0f;
  double real = 0.0;
  Colour colour = Colour::kRed;
  std::string bytes;
  std::optional<Point> none;
  std::optional<Point> some;
  std::pair<int, bool> pair;
  std::array<uint16_t, 3> array{};
  std::vector<Point> points;
  std::vector<bool> flags;
  std::vector<std::vector<double>> nested;
  std::deque<int32_t> queue;
  Matrix2 matrix;
  Countdown countdown;
  static void VisitState(auto& archive, auto& self) {
    auto& [flag, small, large, single, real, colour, bytes, none, some, pair, array, points, flags, nested, queue,
           matrix, countdown] = self;
    archive(flag, small, large, single, real, AtMost(colour, Colour::kLast), bytes, none, some, pair, array, points,
            flags, nested, queue, Finite(matrix), countdown);
  }
  friend bool operator==(const Everything&, const Everything&) = default;
};

Everything Example() {
  Everything everything;
  everything.flag = true;
  everything.small = 200;
  everything.large = std::numeric_limits<int64_t>::min();
  everything.single = 0.1f;
  everything.real = -std::numeric_limits<double>::infinity();
  everything.colour = Colour::kGreen;
  everything.bytes = std::string("a\0b", 3);
  everything.some = Point{-3, 0.25};
  everything.pair = {-7, true};
  everything.array = {1, 2, 65535};
  everything.points = {{1, 2.0}, {3, 4.0}};
  everything.flags = {true, false, true};
  everything.nested = {{}, {1e-300, 5.0}, {0.5}};
  everything.queue = {9, -8};
  everything.matrix.elements = {1.0, 2.0, 3.0, 4.0};
  everything.countdown = Countdown(10);
  return everything;
}

template <typename... Fields>
std::string Write(const Fields&... fields) {
  StateWriter writer;
  writer(fields...);
  return writer.Take();
}

template <typename Field>
absl::Status Read(const std::string& bytes, Field&& field) {
  StateReader reader(bytes);
  reader(field);
  return reader.Finish();
}

TEST(StateIoTest, EveryTypeRoundTrips) {
  const std::string bytes = Write(Example());
  Everything read;
  read.none = Point{};  // the old value is discarded
  read.queue = {1, 2, 3};
  ASSERT_EQ(Read(bytes, read), absl::OkStatus());
  EXPECT_EQ(read, Example());
  EXPECT_EQ(Write(read), bytes);
}

TEST(StateIoTest, NumbersAreLittleEndianAndOfFixedWidth) {
  EXPECT_EQ(Write(uint32_t{0x01020304}), std::string("\x04\x03\x02\x01", 4));
  EXPECT_EQ(Write(1.0), std::string("\0\0\0\0\0\0\xf0\x3f", 8));
  EXPECT_EQ(Write(std::string("xy")), std::string("\2\0\0\0\0\0\0\0xy", 10));
  EXPECT_EQ(Write(std::vector<uint16_t>{5}), std::string("\1\0\0\0\0\0\0\0\5\0", 10));
}

TEST(StateIoTest, EveryBitOfANumberIsKept) {
  const auto payload = std::bit_cast<double>(uint64_t{0xfff4000000000123});
  double read = 0.0;
  ASSERT_EQ(Read(Write(payload), read), absl::OkStatus());
  EXPECT_EQ(std::bit_cast<uint64_t>(read), std::bit_cast<uint64_t>(payload));
  ASSERT_EQ(Read(Write(-0.0), read), absl::OkStatus());
  EXPECT_TRUE(std::signbit(read));
}

TEST(StateIoTest, EveryTruncationIsAnError) {
  const std::string bytes = Write(Example());
  for (size_t size = 0; size < bytes.size(); ++size) {
    Everything read;
    EXPECT_EQ(Read(bytes.substr(0, size), read).code(), absl::StatusCode::kDataLoss) << size;
  }
  Everything read;
  EXPECT_EQ(Read(bytes + "x", read).message(),
            "saved state, byte " + std::to_string(bytes.size()) + ": 1 bytes remain after the last field");
}

TEST(StateIoTest, TheFirstErrorStaysAndTheRestIsZero) {
  const std::string bytes = Write(uint8_t{7}, uint32_t{5});
  StateReader reader(bytes);
  bool flag = true;
  reader(flag);
  const absl::Status first = reader.status();
  EXPECT_EQ(first.message(), "saved state, byte 1: a bool is neither 0 nor 1");
  uint32_t number = 1;
  std::vector<int> list = {1};
  std::optional<int> maybe = 1;
  reader(number, list, maybe);
  EXPECT_FALSE(flag);
  EXPECT_EQ(number, 0u);
  EXPECT_TRUE(list.empty());
  EXPECT_FALSE(maybe.has_value());
  EXPECT_EQ(reader.Bytes(), "");
  reader.Fail("another");
  EXPECT_EQ(reader.Finish(), first);
}

TEST(StateIoTest, AFalseCountAllocatesNothing) {
  std::vector<double> list;
  EXPECT_EQ(Read(Write(std::numeric_limits<uint64_t>::max()), list).message(),
            "saved state, byte 8: a list has 18446744073709551615 elements, but only 0 bytes remain");
  // A count equal to the number of bytes, but each element has more than one.
  EXPECT_EQ(Read(Write(uint64_t{16}, uint64_t{0}, uint64_t{0}), list).code(), absl::StatusCode::kDataLoss);
  EXPECT_LE(list.capacity(), 4u);
  std::string bytes;
  EXPECT_EQ(Read(Write(uint64_t{1} << 62), bytes).code(), absl::StatusCode::kDataLoss);
}

TEST(StateIoTest, SmallNumbersAreShort) {
  const uint64_t numbers[] = {0, 127, 128, 300, uint64_t{1} << 35, std::numeric_limits<uint64_t>::max()};
  StateWriter writer;
  for (const uint64_t number : numbers) writer.Varint(number);
  EXPECT_EQ(writer.size(), 1u + 1 + 2 + 2 + 6 + 10);
  const std::string bytes = writer.Take();
  StateReader reader(bytes);
  for (const uint64_t number : numbers) {
    uint64_t read = 1;
    reader.Varint(read);
    EXPECT_EQ(read, number);
  }
  EXPECT_EQ(reader.Finish(), absl::OkStatus());
  const std::string ones(20, '\xff');
  StateReader endless(ones);
  uint64_t read = 1;
  endless.Varint(read);
  EXPECT_EQ(endless.Finish().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(read, 0u);
}

TEST(PacedYieldsTest, AYieldPointFollowsSoManySteps) {
  PacedYields yields(100);
  const auto add = [&yields](std::initializer_list<size_t> steps) {
    return CountYields([&] {
      for (const size_t count : steps) yields.Add(count);
    });
  };
  EXPECT_EQ(add({50, 49}), 0u);
  EXPECT_EQ(add({1}), 1u);
  EXPECT_EQ(add({99, 300, 99, 2}), 2u) << "one body is never divided";
}

TEST(StateIoTest, LargeStatesHaveYieldPoints) {
  constexpr uint64_t kNumbers = 50'000;
  const std::string large(3 * StateWriter::kPieceBytes, 'x');
  StateWriter writer;
  const size_t num_yields = CountYields([&] {
    for (uint64_t i = 0; i < kNumbers; ++i) {
      writer(i);
      writer.Varint(i);
    }
    writer.Bytes(large);
  });
  const size_t size = writer.size();
  EXPECT_EQ(num_yields, size / StateWriter::kPieceBytes - 2) << "a field has one yield point at most";
  std::string bytes;
  EXPECT_EQ(CountYields([&] { bytes = writer.Take(); }), num_yields) << "one for each piece";
  EXPECT_EQ(bytes.size(), size);
  StateReader reader(bytes);
  for (uint64_t i = 0; i < kNumbers; ++i) {
    uint64_t number = 0, varint = 0;
    reader(number);
    reader.Varint(varint);
    ASSERT_EQ(number, i);
    ASSERT_EQ(varint, i);
  }
  EXPECT_TRUE(reader.Bytes() == large);
  EXPECT_EQ(reader.Finish(), absl::OkStatus());
}

TEST(StateIoTest, CodeThatMayHoldLocksIsNotPaused) {
  const size_t num_yields = CountYields([] {
    {
      const ScopedWithoutYielder without;
      YieldPoint();
    }
    YieldPoint();
  });
  EXPECT_EQ(num_yields, 1u);
}

TEST(StateIoTest, ADestructorGoesOnIfItCannotBePaused) {
  class Throws : public Yielder {
   public:
    void Yield() override { throw std::bad_alloc(); }
  } yielder;
  const ScopedYielder scope(yielder);
  EXPECT_THROW(YieldPoint(), std::bad_alloc);
  YieldPointOfDestructor();
}

TEST(StateIoTest, RangesAreKept) {
  Colour colour = Colour::kGreen;
  EXPECT_EQ(Read(Write(2), AtMost(colour, Colour::kLast)).code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(colour, Colour::kRed);
  EXPECT_EQ(Read(Write(-1), AtMost(colour, Colour::kLast)).code(), absl::StatusCode::kDataLoss);
  int number = 0;
  EXPECT_EQ(Read(Write(-3), InRange(number, -3, 4)), absl::OkStatus());
  EXPECT_EQ(number, -3);
  EXPECT_EQ(Read(Write(5), InRange(number, -3, 4)).code(), absl::StatusCode::kDataLoss);
  double real = 0.0;
  EXPECT_EQ(Read(Write(std::nan("")), InRange(real, 0.0, 1.0)).code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(Read(Write(HUGE_VAL), Finite(real)).code(), absl::StatusCode::kDataLoss);
  Matrix2 matrix;
  matrix.elements[3] = std::nan("");
  EXPECT_EQ(Read(Write(matrix), Finite(matrix)).code(), absl::StatusCode::kDataLoss);
}

TEST(StateIoTest, FlippedBitsAreReadOrRefused) {
  const std::string bytes = Write(Example());
  Random random(1);
  for (int i = 0; i < 20'000; ++i) {
    std::string damaged = bytes;
    for (uint64_t flips = 1 + random.UniformInt(4); flips > 0; --flips) {
      damaged[random.UniformInt(damaged.size())] ^= static_cast<char>(1 << random.UniformInt(8));
    }
    Everything read;
    const absl::Status status = Read(damaged, read);
    if (status.ok()) {
      EXPECT_EQ(Write(read), damaged);
    } else {
      EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
    }
  }
}

}  // namespace
}  // namespace evpose
