// SPDX-License-Identifier: Apache-2.0

// The messages that wait to be sent to one page. Their number is bounded: a newer image, and a newer value of the same
// kind, replaces the one that waits; beyond their limits every second pose and the oldest state changes are removed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "client/view/page_messages.h"

namespace evpose::client {

// Thread-safe; no call waits for the page.
class PageOutbox {
 public:
  struct Frame {
    std::string bytes;
    bool is_binary = false;
  };
  // Images that may be unacknowledged, so that the next one is under way while one is drawn.
  static constexpr uint64_t kMaxUnacknowledged = 2;
  // Poses of an object that may wait; beyond it every second one is removed.
  static constexpr size_t kMaxPoses = 2048;
  // State changes and notices that may wait; beyond it the oldest is removed.
  static constexpr size_t kMaxNotes = 256;

  // Calls `on_ready`, on the thread that stores a message, when a frame may be ready to be sent.
  explicit PageOutbox(std::function<void()> on_ready) : on_ready_(std::move(on_ready)) {}
  PageOutbox(const PageOutbox&) = delete;

  // A message of one of these kinds replaces the one of the same kind that has not been sent yet. They are sent in the
  // order of the enumerators.
  enum class Latest { kHello, kSessions, kScene, kRange, kPosition, kEnd };
  void Set(Latest kind, std::string text);
  void SetHealth(SessionHealth health);
  // Begins another scene: messages of the former scene that wait are removed.
  void StartScene(const PageScene& scene);
  // Messages of the scene, sent after it and in this order: geometries and the poses of a recording. All pages share
  // them; the source that makes them bounds their size.
  using Prepared = std::vector<Frame>;
  void Add(std::shared_ptr<const Prepared> frames);
  void AddPoses(const std::vector<Pose>& poses);
  // A state change or a notice.
  void AddNote(std::string text);
  void SetImage(PageImage image);

  // Returns whether an image that is set now can be sent: no other one waits, and fewer than kMaxUnacknowledged are
  // unacknowledged. A source that makes images on demand then makes the next one.
  bool WantsImage() const;

  // Called by the connection. Returns the next frame; nullopt if nothing can be sent now.
  std::optional<Frame> Next();
  // The page has drawn the image with this number and all earlier ones.
  void Acknowledge(uint64_t number);
  // The page has left: later messages are discarded.
  void Close();

 private:
  // Stores something and calls on_ready_ without the lock.
  template <typename Store>
  void Update(const Store& store);
  std::optional<Frame> NextLatest(Latest first, Latest last) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  std::optional<Frame> NextImage() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  std::optional<Frame> NextPoses() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  LinkCounts Counts() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::function<void()> on_ready_;
  mutable std::mutex mutex_;
  bool is_closed_ ABSL_GUARDED_BY(mutex_) = false;
  std::map<Latest, std::string> latest_ ABSL_GUARDED_BY(mutex_);
  std::optional<SessionHealth> health_ ABSL_GUARDED_BY(mutex_);
  std::deque<std::string> notes_ ABSL_GUARDED_BY(mutex_);
  struct Cursor {
    std::shared_ptr<const Prepared> frames;
    size_t next = 0;
  };
  std::deque<Cursor> prepared_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, std::vector<Pose>> poses_ ABSL_GUARDED_BY(mutex_);  // by object
  std::optional<PageImage> image_ ABSL_GUARDED_BY(mutex_);
  uint64_t sent_ ABSL_GUARDED_BY(mutex_) = 0;  // number of the last image; the first is 1
  uint64_t acknowledged_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t skipped_ ABSL_GUARDED_BY(mutex_) = 0;         // images that were replaced here
  uint64_t source_skipped_ ABSL_GUARDED_BY(mutex_) = 0;  // images of the present scene that the server replaced
};

}  // namespace evpose::client
