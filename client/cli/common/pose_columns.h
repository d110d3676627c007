// SPDX-License-Identifier: Apache-2.0

// The names of the columns that a CSV file of poses has by number, for its writer and its reader.
#pragma once

#include <array>
#include <cstddef>

namespace evpose::client {

inline constexpr std::array<const char*, 7> kPoseColumns = {"tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"};
inline constexpr std::array<const char*, 6> kTwistColumns = {"vx_m_per_s",   "vy_m_per_s",   "vz_m_per_s",
                                                             "wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"};
// The columns of the covariance are cov_A_B, for the upper triangle row by row.
inline constexpr std::array<const char*, 6> kCovarianceAxes = {"tx", "ty", "tz", "rx", "ry", "rz"};
// The columns of alternative N are altN_NAME, with the names of kPoseColumns and this one.
inline constexpr char kLikelihoodColumn[] = "log_likelihood_ratio";
// The object's latest loss before the pose: its time, and its cause (LossCauseName()). The columns are empty, and the
// fields of JSON lines null, before the first loss.
inline constexpr char kLossTimeColumn[] = "lost_at_us";
inline constexpr char kLossCauseColumn[] = "loss_cause";
// The largest number of alternatives in the API. The columns of absent ones are empty.
inline constexpr size_t kAlternativesInCsv = 4;
// Name of the CSV column and of the JSON field with the name of the poses' transform. A CSV file has it only if the
// transform is not camera_from_object.
inline constexpr char kTransformKey[] = "transform";

}  // namespace evpose::client
