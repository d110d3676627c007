// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/pose_columns.h"

#include <zlib.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <new>
#include <optional>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/geometry/single_precision.h"
#include "evpose/storage/v1/session.pb.h"
#include "google/protobuf/arena.h"
#include "server/runtime/enum_number.h"

namespace evpose::server {
namespace {

namespace pb = storage::v1;

constexpr size_t kDoubles = 6, kFloats = 29, kElements = 9;
// Numbers of PoseColumns::doubles and PoseColumns::floats, and room for the other fields.
constexpr size_t kMaxBytesOfPose = 8 * kDoubles + 4 * kFloats + 10 * (kElements + 8);

// A rotation as in PoseColumns.
struct CodedRotation {
  uint32_t largest = 0;
  std::array<double, 3> others{};
  std::array<int64_t, kElements> ulps{};
};

// Consecutive numbers of the doubles in their order.
uint64_t NumberOf(double value) {
  const auto bits = std::bit_cast<uint64_t>(value);
  constexpr uint64_t kSign = uint64_t{1} << 63;
  return (bits & kSign) != 0 ? ~bits : bits | kSign;
}
double DoubleOf(uint64_t number) {
  constexpr uint64_t kSign = uint64_t{1} << 63;
  return std::bit_cast<double>((number & kSign) != 0 ? number & ~kSign : ~number);
}

// Only operations that IEEE 754 rounds correctly, so that the result has the same bits on every machine.
Eigen::Matrix3d MatrixOf(uint32_t largest, const std::array<double, 3>& others) {
  std::array<double, 4> quaternion{};
  double rest = 1.0;
  for (size_t i = 0, next = 0; i < quaternion.size(); ++i) {
    if (i == largest) continue;
    quaternion[i] = others[next++];
    rest -= quaternion[i] * quaternion[i];
  }
  quaternion[largest] = std::sqrt(std::max(rest, 0.0));
  const auto [w, x, y, z] = quaternion;
  Eigen::Matrix3d matrix;
  matrix(0, 0) = 1.0 - 2.0 * (y * y + z * z);
  matrix(1, 0) = 2.0 * (x * y + w * z);
  matrix(2, 0) = 2.0 * (x * z - w * y);
  matrix(0, 1) = 2.0 * (x * y - w * z);
  matrix(1, 1) = 1.0 - 2.0 * (x * x + z * z);
  matrix(2, 1) = 2.0 * (y * z + w * x);
  matrix(0, 2) = 2.0 * (x * z + w * y);
  matrix(1, 2) = 2.0 * (y * z - w * x);
  matrix(2, 2) = 1.0 - 2.0 * (x * x + y * y);
  return matrix;
}

// nullopt if the matrix is not a rotation.
std::optional<CodedRotation> EncodeRotation(const Eigen::Matrix3d& r) {
  // Four times the products of the quaternion's components: each row is the quaternion times one of its components.
  Eigen::Matrix4d products;
  products.row(0) << 1.0 + r(0, 0) + r(1, 1) + r(2, 2), r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1);
  products.row(1) << r(2, 1) - r(1, 2), 1.0 + r(0, 0) - r(1, 1) - r(2, 2), r(1, 0) + r(0, 1), r(0, 2) + r(2, 0);
  products.row(2) << r(0, 2) - r(2, 0), r(1, 0) + r(0, 1), 1.0 - r(0, 0) + r(1, 1) - r(2, 2), r(2, 1) + r(1, 2);
  products.row(3) << r(1, 0) - r(0, 1), r(0, 2) + r(2, 0), r(2, 1) + r(1, 2), 1.0 - r(0, 0) - r(1, 1) + r(2, 2);
  Eigen::Index largest = 0;
  products.diagonal().maxCoeff(&largest);
  const Eigen::Vector4d quaternion = products.row(largest).transpose().normalized();
  CodedRotation coded = {.largest = static_cast<uint32_t>(largest)};
  for (Eigen::Index i = 0, next = 0; i < 4; ++i) {
    if (i != largest) coded.others[static_cast<size_t>(next++)] = quaternion[i];
  }
  const Eigen::Matrix3d predicted = MatrixOf(coded.largest, coded.others);
  // Largest difference of an element at which the matrix counts as a rotation; that of a rotation is some 1e-15. It
  // also bounds the differences in units of the last place.
  constexpr double kNear = 1e-6;
  if (!((predicted - r).cwiseAbs().maxCoeff() < kNear)) return std::nullopt;
  for (size_t i = 0; i < kElements; ++i) {
    coded.ulps[i] = static_cast<int64_t>(NumberOf(r.data()[i]) - NumberOf(predicted.data()[i]));
  }
  return coded;
}

Eigen::Matrix3d DecodeRotation(const CodedRotation& coded) {
  Eigen::Matrix3d matrix = MatrixOf(coded.largest, coded.others);
  for (size_t i = 0; i < kElements; ++i) {
    matrix.data()[i] = DoubleOf(NumberOf(matrix.data()[i]) + static_cast<uint64_t>(coded.ulps[i]));
  }
  return matrix;
}

// What a pose in columns has instead of its rotation matrix and covariance.
struct CodedPose {
  CodedRotation rotation;
  CovarianceRoot root;
};

// nullopt if the pose cannot be stored in columns.
std::optional<CodedPose> EncodePose(const StoredPose& pose) {
  const PoseEstimate& estimate = pose.estimate;
  if (!estimate.alternatives.empty() || estimate.state == TrackState::kAmbiguous ||
      estimate.object_index != pose.object_index || InSinglePrecision(estimate.twist) != estimate.twist) {
    return std::nullopt;
  }
  const std::optional<CovarianceRoot> root = FindCovarianceRoot(estimate.covariance);
  const std::optional<CodedRotation> rotation = EncodeRotation(estimate.camera_from_object.rotation);
  if (!root.has_value() || !rotation.has_value()) return std::nullopt;
  return CodedPose{*rotation, *root};
}

// Returns the numbers of all poses as in PoseColumns.
template <typename Number, size_t kPerPose>
std::string Interleave(const std::vector<std::array<Number, kPerPose>>& rows) {
  std::string bytes(rows.size() * sizeof(rows[0]), '\0');
  for (size_t i = 0; i < rows.size(); ++i) {
    YieldPoint(i);
    const auto row = std::bit_cast<std::array<char, sizeof(rows[0])>>(rows[i]);
    for (size_t byte = 0; byte < row.size(); ++byte) bytes[byte * rows.size() + i] = row[byte];
  }
  return bytes;
}

// Requires bytes.size() == num_rows * sizeof(row).
template <typename Number, size_t kPerPose>
std::vector<std::array<Number, kPerPose>> Deinterleave(absl::string_view bytes, size_t num_rows) {
  std::vector<std::array<Number, kPerPose>> rows(num_rows);
  for (size_t i = 0; i < num_rows; ++i) {
    std::array<char, sizeof(rows[0])> row{};
    for (size_t byte = 0; byte < row.size(); ++byte) row[byte] = bytes[byte * num_rows + i];
    rows[i] = std::bit_cast<std::array<Number, kPerPose>>(row);
  }
  return rows;
}

// Returns the zlib stream of `inflated`. compress2() would deflate all of it at one yield point.
std::string Deflate(const std::string& inflated) {
  constexpr size_t kPieceBytes = size_t{32} * 1024;  // takes less than about 1 ms
  z_stream stream{};
  if (deflateInit(&stream, Z_BEST_SPEED) != Z_OK) throw std::bad_alloc();  // its only reason
  const absl::Cleanup end = [&stream] { deflateEnd(&stream); };
  std::string bytes(deflateBound(&stream, inflated.size()), '\0');
  stream.next_out = reinterpret_cast<Bytef*>(bytes.data());
  stream.avail_out = static_cast<uInt>(bytes.size());
  for (size_t begin = 0; begin < inflated.size(); begin += kPieceBytes) {
    const size_t size = std::min(kPieceBytes, inflated.size() - begin);
    stream.next_in =
        reinterpret_cast<Bytef*>(const_cast<char*>(inflated.data() + begin));  // NOLINT: zlib only reads it
    stream.avail_in = static_cast<uInt>(size);
    deflate(&stream, begin + size == inflated.size() ? Z_FINISH : Z_NO_FLUSH);
    YieldPoint();
  }
  bytes.resize(stream.total_out);
  return bytes;
}

absl::Status Damaged(absl::string_view what) {
  return absl::DataLossError(absl::StrCat("the columns of a segment of poses are damaged: ", what));
}

// Whether all fields have as many poses as the first one.
bool IsComplete(const pb::PoseColumns& columns) {
  const auto count = static_cast<size_t>(columns.t_us_size());
  const auto has = [count](int size) { return static_cast<size_t>(size) == count; };
  return has(columns.object_index_size()) && has(columns.latency_us_size()) && has(columns.state_size()) &&
         has(columns.num_events_size()) && has(columns.largest_size()) && has(columns.loss_cause_size()) &&
         has(columns.lost_at_us_size()) && static_cast<size_t>(columns.rotation_ulps_size()) == count * kElements &&
         columns.doubles().size() == count * kDoubles * sizeof(double) &&
         columns.floats().size() == count * kFloats * sizeof(float);
}

bool IsStateOfColumns(int state) {
  return pb::TrackState_IsValid(state) && state != pb::TRACK_STATE_UNSPECIFIED && state != pb::TRACK_STATE_AMBIGUOUS;
}

}  // namespace

static_assert(std::endian::native == std::endian::little);

DeflatedColumns EncodeColumns(absl::Span<const StoredPose> poses, absl::FunctionRef<void(const StoredPose&)> on_other) {
  pb::PoseColumns columns;
  std::vector<std::array<double, kDoubles>> doubles;
  std::vector<std::array<float, kFloats>> floats;
  int64_t before_us = 0, lost_before_us = 0;
  for (const StoredPose& pose : poses) {
    YieldPoint();
    const std::optional<CodedPose> coded = EncodePose(pose);
    if (!coded.has_value()) {
      on_other(pose);
      continue;
    }
    const PoseEstimate& estimate = pose.estimate;
    columns.add_t_us(estimate.t_us - std::exchange(before_us, estimate.t_us));
    columns.add_object_index(pose.object_index);
    columns.add_latency_us(pose.latency_us);
    columns.add_state(EnumNumber<pb::TrackState>(estimate.state));
    columns.add_num_events(estimate.num_events);
    columns.add_loss_cause(static_cast<pb::LossCause>(estimate.loss_cause));
    columns.add_lost_at_us(estimate.lost_at_us - std::exchange(lost_before_us, estimate.lost_at_us));
    const CodedRotation& rotation = coded->rotation;
    columns.add_largest(rotation.largest);
    columns.mutable_rotation_ulps()->Add(rotation.ulps.begin(), rotation.ulps.end());
    std::copy(rotation.others.begin(), rotation.others.end(), doubles.emplace_back().begin());
    const Eigen::Vector3d& translation = estimate.camera_from_object.translation_m;
    std::copy(translation.begin(), translation.end(), doubles.back().begin() + 3);
    std::array<float, kFloats>& numbers = floats.emplace_back();
    numbers[0] = estimate.explained_ratio;
    numbers[1] = estimate.residual_rms_px;
    const Eigen::Matrix<float, 6, 1> twist = estimate.twist.cast<float>();
    std::copy(coded->root.begin(), coded->root.end(), std::copy(twist.begin(), twist.end(), numbers.begin() + 2));
  }
  if (doubles.empty()) return {};
  columns.set_doubles(Interleave(doubles));
  columns.set_floats(Interleave(floats));
  const std::string inflated = columns.SerializeAsString();
  return {.bytes = Deflate(inflated), .inflated_bytes = static_cast<uint32_t>(inflated.size())};
}

absl::StatusOr<std::vector<StoredPose>> DecodeColumns(absl::string_view bytes, uint32_t inflated_bytes,
                                                      size_t max_poses) {
  if (inflated_bytes > kMaxBytesOfPose * max_poses) return Damaged("they are longer than they can be");
  std::string inflated(inflated_bytes, '\0');
  uLongf size = inflated.size();
  const int result = uncompress(reinterpret_cast<Bytef*>(inflated.data()), &size,
                                reinterpret_cast<const Bytef*>(bytes.data()), bytes.size());
  if (result != Z_OK || size != inflated.size()) return Damaged("they cannot be inflated");
  google::protobuf::Arena arena;
  auto& columns = *google::protobuf::Arena::CreateMessage<pb::PoseColumns>(&arena);
  if (!columns.ParseFromString(inflated)) return Damaged("they cannot be parsed");
  const auto count = static_cast<size_t>(columns.t_us_size());
  if (!IsComplete(columns) || count > max_poses) return Damaged("the number of poses differs between columns");
  const auto doubles = Deinterleave<double, kDoubles>(columns.doubles(), count);
  const auto floats = Deinterleave<float, kFloats>(columns.floats(), count);
  std::vector<StoredPose> poses(count);
  uint64_t t_us = 0, lost_at_us = 0;  // unsigned, because damaged differences may overflow
  for (size_t i = 0; i < count; ++i) {
    const auto at = static_cast<int>(i);
    StoredPose& pose = poses[i];
    PoseEstimate& estimate = pose.estimate;
    pose.object_index = estimate.object_index = columns.object_index(at);
    pose.latency_us = columns.latency_us(at);
    estimate.t_us = static_cast<int64_t>(t_us += static_cast<uint64_t>(columns.t_us(at)));
    if (!IsStateOfColumns(columns.state(at))) return Damaged("a state that this version does not know");
    estimate.state = EnumValue<TrackState>(columns.state(at));
    estimate.num_events = columns.num_events(at);
    if (!pb::LossCause_IsValid(columns.loss_cause(at))) return Damaged("a cause that this version does not know");
    estimate.loss_cause = static_cast<LossCause>(columns.loss_cause(at));
    estimate.lost_at_us = static_cast<int64_t>(lost_at_us += static_cast<uint64_t>(columns.lost_at_us(at)));
    CodedRotation rotation = {.largest = columns.largest(at)};
    if (rotation.largest > 3) return Damaged("a quaternion has four components");
    std::copy_n(doubles[i].begin(), 3, rotation.others.begin());
    const std::ptrdiff_t first_element = std::ptrdiff_t{at} * static_cast<std::ptrdiff_t>(kElements);
    std::copy_n(columns.rotation_ulps().begin() + first_element, kElements, rotation.ulps.begin());
    estimate.camera_from_object.rotation = DecodeRotation(rotation);
    std::copy_n(doubles[i].begin() + 3, 3, estimate.camera_from_object.translation_m.begin());
    estimate.explained_ratio = floats[i][0];
    estimate.residual_rms_px = floats[i][1];
    std::copy_n(floats[i].begin() + 2, 6, estimate.twist.begin());
    CovarianceRoot root;
    std::copy_n(floats[i].begin() + 8, root.size(), root.begin());
    estimate.covariance = CovarianceOf(root);
  }
  return poses;
}

}  // namespace evpose::server
