// SPDX-License-Identifier: Apache-2.0

// The final report of replay and stream.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "client/cli/common/pose_format.h"
#include "core/recordings/recording_header.h"
#include "core/recordings/recording_reader.h"
#include "evpose/types.h"

namespace evpose::client {

struct ReplayReport {
  std::string recording;
  std::string out;                            // empty: poses were not written
  std::string transform = kCameraFromObject;  // name of the transform of the poses in `out`
  std::vector<PoseFile> files;                // `out` may be the pattern of their names
  std::string session;                        // empty: the session was deleted
  std::string trace_id;                       // of the session, for the logs of the servers
  RecordingHeader header;
  TrackSummary summary;
  absl::Duration wall_time;
  size_t truncated_bytes = 0;                       // incomplete word at the end of the recording
  std::optional<absl::Duration> host_minus_sensor;  // difference of the clocks, with --clock-log
  std::vector<SkippedParts> skipped;                // RecordingReader::skipped()
  bool is_interrupted = false;
  int outages = 0;  // number of interruptions of the connection
  absl::Duration away_for;
  absl::Duration longest_lag;  // of the events behind `pace`, as far as it was reported; zero: none
  std::string pace;
  struct Model {
    std::string object_id;
    std::vector<std::string> notices;
    uint32_t num_symmetries = 1;
    double diameter_m = 0.0;
    std::optional<ContinuousSymmetry> continuous_symmetry;
  };
  std::vector<Model> models;  // the models of the objects, in their order

  void Add(const Notice& notice);
  void Add(const Pose& pose);

  // The last line has the numbers of events, poses and losses, the event rate in Mev/s, and latencies.
  void Print(std::ostream& out_stream) const;
  Json ToJson() const;
  // Whether poses were found, but no file has one, because all are AMBIGUOUS.
  bool HasOnlyFilesWithoutPose() const;
  // Returns the IDs of the objects for which no pose was found. Returns none if this process has not received all poses
  // of the session: an earlier process may have received poses of these objects.
  std::vector<std::string> ObjectsWithoutPose() const;
  // Whether there is a file that an earlier run has written, and this run has not.
  bool KeepsOlderFiles() const;

 private:
  // The parts of Print(): input and connection; models and objects; pose files.
  void PrintInput(std::ostream& stream) const;
  void PrintObjects(std::ostream& stream) const;
  void PrintFiles(std::ostream& stream) const;
  // Returns a line about an object that has no confirmed pose at the end; empty if it has one.
  std::string WhyNoPose(const ObjectHealth& object) const;
  // Returns a line with the times and the causes of the losses of an object; empty if another line has them.
  std::string DescribeLosses(const ObjectHealth& object) const;
  // The losses of an object, by time, as far as this process knows them.
  std::vector<Loss> LossesOf(const ObjectHealth& object) const;
  // Returns the prefix of a line about one of several objects; empty for a single object.
  std::string NameOf(const std::string& object_id) const;
  uint32_t Losses() const;  // sum over all objects
  Json ObjectsJson() const;
  double MegaEventsPerSecond() const;

  // What this process has received of an object.
  struct Received {
    uint64_t poses = 0;
    uint64_t tracking_poses = 0;
    uint64_t degraded_poses = 0;
    uint64_t ambiguous_poses = 0;
    std::vector<Loss> losses;  // the first kMaxLosses of them
  };
  static constexpr size_t kMaxLosses = 1000;  // bounds the memory of a stream that lasts for months
  // The sum of a number over all objects.
  uint64_t Total(uint64_t Received::*number) const;
  // Whether this process has received all poses; one that was continued knows its own poses only.
  bool KnowsAllPoses() const { return Total(&Received::poses) == summary.poses; }

  std::map<std::string, Received> received_;  // by object
  uint64_t triggers_ = 0;                     // received by this process, including those that a notice only counts
  uint64_t decode_faults_ = 0;
  std::string first_decode_fault_;
  std::vector<TrackingRestarted> restarts_;  // one for each server that could not read the state of the tracker
};

}  // namespace evpose::client
