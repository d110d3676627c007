// SPDX-License-Identifier: Apache-2.0
#include "client/containers/open_recording.h"

#include <algorithm>
#include <filesystem>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/containers/aedat_source.h"
#include "client/containers/array_source.h"
#include "client/containers/bag.h"
#include "client/containers/container_format.h"
#include "client/containers/hdf5_source.h"
#include "client/containers/text_source.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// The formats, in the order in which they are tried. A format with a signature comes before one that is recognised by
// its grammar.
constexpr const ContainerFormat* kFormats[] = {&kMcapFormat, &kSqliteBagFormat, &kHdf5Format, &kAedatFormat,
                                               &kNpyFormat,  &kNpzFormat,       &kTextFormat};

constexpr size_t kRawPrefixBytes = 16;  // every RAW or DAT file is longer

bool IsRaw(std::string_view prefix) { return prefix.substr(0, 2) == "% " || prefix.substr(0, 2) == "%\n"; }

// A format that is recognised so that the error can name the remedy.
struct RefusedFormat {
  std::string_view signature;
  size_t offset;
  const char* advice;
};

constexpr char kFilm[] = "is a film of frames; evpose needs the events of an event camera, of which a film has none";

constexpr RefusedFormat kRefused[] = {
    {"#ROSBAG V", 0, "is a bag of ROS 1; convert it to one of ROS 2: rosbags-convert --src FILE.bag --dst FILE"},
    {"MATLAB 5.0", 0, "is a MATLAB file, whose variables have no fixed names; save its events as CSV: x,y,p,t"},
    {std::string_view("\x28\xb5\x2f\xfd", 4), 0, "is compressed as a whole; decompress it first: unzstd FILE"},
    {std::string_view("\x1f\x8b", 2), 0, "is compressed as a whole; decompress it first: gunzip FILE"},
    {"BZh", 0, "is compressed as a whole; decompress it first: bunzip2 FILE"},
    {std::string_view("\xfd"
                      "7zXZ",
                      5),
     0, "is compressed as a whole; decompress it first: unxz FILE"},
    {std::string_view("\x04\x22\x4d\x18", 4), 0, "is compressed as a whole; decompress it first: unlz4 FILE"},
    {"AVI ", 8, kFilm},
    {"ftyp", 4, kFilm},
    {std::string_view("\x1a\x45\xdf\xa3", 4), 0, kFilm}};

// The path of "FILE#topic", and the topic. A file whose name has the character '#' is found by its whole name.
std::pair<std::string, std::string> SplitTopic(const std::string& path) {
  std::error_code error;
  if (std::filesystem::exists(path, error)) return {path, ""};
  for (size_t sign = path.find('#'); sign != std::string::npos; sign = path.find('#', sign + 1)) {
    if (std::filesystem::exists(path.substr(0, sign), error)) return {path.substr(0, sign), path.substr(sign + 1)};
  }
  return {path, ""};
}

absl::Status NoTopics(const std::string& name, const std::string& format, const std::string& topic) {
  return absl::InvalidArgumentError(
      absl::StrCat(name, ": is a file of ", format, ", which has no topics: leave out #", topic));
}

absl::Status CheckUse(const ContainerFormat& format, const ContainerFile& file, bool is_following) {
  const std::string name(format.name);
  if (is_following) {
    return absl::InvalidArgumentError(absl::StrCat(file.name, ": is a file of ", name,
                                                   ", which cannot be followed as it grows: only RAW and DAT can; use "
                                                   "evpose replay without --follow when it is complete"));
  }
  if (file.path.empty() && !format.reads_streams) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.name, ": ", name, " cannot be read from a stream: give the name of the file"));
  }
  if (!file.topic.empty() && !format.has_topics) {
    return NoTopics(file.name, name, file.topic);
  }
  return absl::OkStatus();
}

// rosbag2 writes a folder with metadata.yaml and a file, or several if the bag was split.
absl::StatusOr<std::string> FileOfFolder(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_directory(path, error)) return path;
  std::vector<std::string> files;
  // A range-based loop would throw an exception if the directory cannot be read further.
  const std::filesystem::directory_iterator end;
  for (std::filesystem::directory_iterator entry(path, error); !error && entry != end; entry.increment(error)) {
    const std::string extension = entry->path().extension().string();
    if (extension == ".db3" || extension == ".mcap") files.push_back(entry->path().string());
  }
  if (error) return absl::UnavailableError(absl::StrCat(path, ": cannot be listed: ", error.message()));
  if (files.size() == 1) return files.front();
  if (files.empty()) return path;  // the error for a directory
  std::sort(files.begin(), files.end());
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": is a bag of several files; give one of them: ", absl::StrJoin(files, ", ")));
}

// The error for a file that no reader recognises.
absl::Status NotRecognised(const std::string& name, std::string_view prefix) {
  for (const RefusedFormat& refused : kRefused) {
    if (prefix.size() >= refused.offset && prefix.substr(refused.offset).starts_with(refused.signature)) {
      return absl::UnimplementedError(absl::StrCat(name, ": ", refused.advice));
    }
  }
  std::string names = "RAW, DAT";
  for (const ContainerFormat* format : kFormats) absl::StrAppend(&names, ", ", std::string(format->name));
  return absl::InvalidArgumentError(absl::StrCat(name, ": is not a recording of a known format: ", names));
}

}  // namespace

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenRecording(const std::string& path,
                                                               const OpenRecordingOptions& options) {
  auto [file_path, topic] = SplitTopic(path);
  EVPOSE_ASSIGN_OR_RETURN(file_path, FileOfFolder(file_path));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ByteSource> bytes,
                          ByteSource::Open(file_path, {.is_following = options.is_following, .stop = options.stop}));
  EVPOSE_ASSIGN_OR_RETURN(std::string_view prefix, bytes->Peek(kRawPrefixBytes));
  if (prefix.empty() || IsRaw(prefix)) {
    if (topic.empty()) return RecordingReader::FromBytes(std::move(bytes));
    return NoTopics(bytes->name(), "RAW or DAT", topic);
  }
  if (!options.is_following) {
    EVPOSE_ASSIGN_OR_RETURN(prefix, bytes->Peek(bytes->can_be_reopened() ? kSniffedBytes : kStreamBytes));
  }
  for (const ContainerFormat* format : kFormats) {
    if (!format->matches(prefix)) continue;
    ContainerFile file = {.name = bytes->name(),
                          .path = bytes->can_be_reopened() ? file_path : "",
                          .topic = topic,
                          .bytes = std::move(bytes),
                          .geometry = options.geometry};
    EVPOSE_RETURN_IF_ERROR(CheckUse(*format, file, options.is_following));
    return format->open(std::move(file));
  }
  return NotRecognised(bytes->name(), prefix);
}

}  // namespace evpose::client
