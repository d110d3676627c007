// SPDX-License-Identifier: Apache-2.0

// evpose-hdf5: reads and writes recordings in HDF5 for evpose, which exchanges records with it through a pipe.
#include <sys/resource.h>
#include <sys/time.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "client/containers/hdf5/event_pipe.h"
#include "client/convert_hdf5/hdf5_arguments.h"
#include "client/convert_hdf5/hdf5_reader.h"
#include "client/convert_hdf5/hdf5_writer.h"
#include "core/base/file_version.h"
#include "core/base/sanitized.h"
#include "core/base/status_macros.h"
#include "core/base/temporary_files.h"
#include "core/base/terminate_by_signal.h"
#include "core/command_line/help.h"

namespace {

using evpose::client::AppendPipeEnd;
using evpose::client::AppendPipeEvents;
using evpose::client::AppendPipeHeader;
using evpose::client::AppendPipeLosses;
using evpose::client::AppendPipeTriggers;
using evpose::client::Hdf5Reader;
using evpose::client::Hdf5Writer;
using evpose::client::PipeRecord;
using evpose::client::PipeRecordKind;

constexpr int kFailed = 1;
constexpr size_t kReadBytes = size_t{64} * 1024;  // the capacity of a pipe

absl::Status WriteAll(absl::Span<const uint8_t> bytes) {
  while (!bytes.empty()) {
    const ssize_t count = write(STDOUT_FILENO, bytes.data(), bytes.size());
    if (count < 0 && errno != EINTR) return absl::ErrnoToStatus(errno, "standard output cannot be written");
    if (count > 0) bytes.remove_prefix(static_cast<size_t>(count));
  }
  return absl::OkStatus();
}

// Limits the memory of the program: a filter of the HDF5 library may decompress a chunk to any size. An allocation that
// fails is an error of that chunk. Four columns with chunks of 64 MiB need half of the limit.
void BoundMemory() {
#ifndef EVPOSE_SANITIZED
  constexpr rlim_t kMaxBytes = rlim_t{1} << 30;
  const rlimit limit = {.rlim_cur = kMaxBytes, .rlim_max = kMaxBytes};
  setrlimit(RLIMIT_AS, &limit);
#endif
}

// Ends the program when a step takes more processor time than any step needs: the HDF5 library can follow the
// references of a damaged file without end. The time starts anew with each step. Waiting takes no processor time: it is
// bounded because the program waits only for the disk and for evpose.
void BoundStep() {
  constexpr timeval kStepTime = {.tv_sec = 5, .tv_usec = 0};
  std::signal(SIGPROF, [](int) {
    constexpr absl::string_view kError = "evpose-hdf5: is damaged: the HDF5 library does not come to an end with it\n";
    [[maybe_unused]] const ssize_t count = write(STDERR_FILENO, kError.data(), kError.size());
    _exit(kFailed);
  });
  const itimerval timer = {.it_interval = {}, .it_value = kStepTime};
  setitimer(ITIMER_PROF, &timer, nullptr);
}

absl::Status ReadFile(const std::string& path) {
  BoundMemory();
  BoundStep();
  const absl::StatusOr<evpose::FileVersion> opened = evpose::FileVersion::Of(path);
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Hdf5Reader> reader, Hdf5Reader::Open(path));
  std::vector<uint8_t> bytes;
  AppendPipeHeader(reader->header(), bytes);
  std::vector<evpose::Event> events;
  std::vector<evpose::Trigger> triggers;
  evpose::client::PipeLosses losses;
  while (reader->Next(events, triggers)) {
    BoundStep();
    // The reader of the pipe sorts them into the events that follow.
    if (!triggers.empty()) AppendPipeTriggers(triggers, bytes);
    if (!events.empty()) AppendPipeEvents(events, bytes);
    if (reader->losses() != losses) {
      losses = reader->losses();
      AppendPipeLosses(losses, bytes);
    }
    EVPOSE_RETURN_IF_ERROR(WriteAll(bytes));
    bytes.clear();
  }
  if (opened.ok()) EVPOSE_RETURN_IF_ERROR(opened->CheckUnchanged());
  AppendPipeLosses(reader->losses(), bytes);
  AppendPipeEnd(bytes);
  return WriteAll(bytes);
}

absl::Status WriteRecord(const std::string& path, const PipeRecord& record, std::unique_ptr<Hdf5Writer>& writer) {
  if ((record.kind == PipeRecordKind::kHeader) == (writer != nullptr)) {
    return absl::DataLossError("the records of standard input are out of order");
  }
  switch (record.kind) {
    case PipeRecordKind::kHeader: {
      EVPOSE_ASSIGN_OR_RETURN(writer, Hdf5Writer::Create(path, record.header));
      return absl::OkStatus();
    }
    case PipeRecordKind::kEvents:
      return writer->Write(record.events);
    case PipeRecordKind::kTriggers:
      return writer->Write(record.triggers);
    case PipeRecordKind::kLosses:
      return absl::OkStatus();
    case PipeRecordKind::kEnd:
      return writer->Close();
  }
  return absl::OkStatus();
}

// The terminal sends its interrupt and its end to this program as well as to evpose. evpose decides what follows, and
// this program ends with the pipe between them; otherwise evpose would take its end for the effect of a damaged file.
void IgnoreTerminal() {
  for (const int number : {SIGINT, SIGHUP}) std::signal(number, SIG_IGN);
}

// A request to this program alone.
void RemoveFileAtTermination() {
  const auto end = [](int signal) {
    evpose::RemoveTemporaryFiles();
    evpose::TerminateBySignal(signal);
  };
  if (std::signal(SIGTERM, end) == SIG_IGN) std::signal(SIGTERM, SIG_IGN);
}

absl::Status WriteFile(const std::string& path) {
  RemoveFileAtTermination();
  std::unique_ptr<Hdf5Writer> writer;
  std::vector<uint8_t> bytes;
  PipeRecord record;
  while (true) {
    const size_t size = bytes.size();
    bytes.resize(size + kReadBytes);
    const ssize_t count = read(STDIN_FILENO, bytes.data() + size, kReadBytes);
    if (count < 0) return absl::ErrnoToStatus(errno, "standard input cannot be read");
    if (count == 0) return absl::DataLossError("standard input ended before the recording");
    bytes.resize(size + static_cast<size_t>(count));
    absl::Span<const uint8_t> rest = bytes;
    while (true) {
      EVPOSE_ASSIGN_OR_RETURN(const bool is_complete, TakePipeRecord(rest, record));
      if (!is_complete) break;
      EVPOSE_RETURN_IF_ERROR(WriteRecord(path, record, writer));
      if (record.kind == PipeRecordKind::kEnd) return absl::OkStatus();
    }
    bytes.erase(bytes.begin(), bytes.end() - static_cast<int64_t>(rest.size()));
  }
}

absl::StatusOr<int> Run(int argc, char** argv) {
  evpose::client::Hdf5Arguments arguments;
  const std::unique_ptr<CLI::App> parser = evpose::client::MakeHdf5Parser(arguments);
  if (const std::optional<int> answer = evpose::ParseOrAnswer(*parser, argc, argv)) return *answer;
  IgnoreTerminal();
  EVPOSE_RETURN_IF_ERROR(arguments.action == "read" ? ReadFile(arguments.path) : WriteFile(arguments.path));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return evpose::RunProgram("evpose-hdf5", [argc, argv] { return Run(argc, argv); });
}
