// SPDX-License-Identifier: Apache-2.0

// A page without a connection.
#pragma once

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>

#include "client/view/page_client_testing.h"
#include "client/view/page_outbox.h"

namespace evpose::client {

// The messages of an outbox, each as soon as it is there.
class OutboxReader {
 public:
  std::shared_ptr<PageOutbox> outbox() { return outbox_; }

  ReceivedMessage Read() {
    std::unique_lock lock(mutex_);
    while (true) {
      num_seen_ = num_calls_;
      lock.unlock();
      std::optional<PageOutbox::Frame> frame = outbox_->Next();
      lock.lock();
      if (frame) {
        const ReceivedMessage message = ParseFrame(frame->bytes, frame->is_binary);
        lock.unlock();
        if (message.type() == "image" && acknowledges_) outbox_->Acknowledge(message.header["number"]);
        return message;
      }
      changed_.wait(lock, [this] { return num_calls_ != num_seen_; });
    }
  }
  ReceivedMessage ReadUntil(const std::string& type) {
    while (true) {
      ReceivedMessage message = Read();
      if (message.type() == type) return message;
    }
  }
  // The image of an instant.
  ReceivedMessage ReadImage(int64_t t_us) {
    while (true) {
      ReceivedMessage message = ReadUntil("image");
      if (message.header["t_us"] == t_us) return message;
    }
  }
  void set_acknowledges(bool acknowledges) { acknowledges_ = acknowledges; }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  uint64_t num_calls_ = 0;
  uint64_t num_seen_ = 0;
  std::atomic<bool> acknowledges_ = true;
  std::shared_ptr<PageOutbox> outbox_ = std::make_shared<PageOutbox>([this] {
    const std::lock_guard lock(mutex_);
    ++num_calls_;
    changed_.notify_all();
  });
};

}  // namespace evpose::client
