// SPDX-License-Identifier: Apache-2.0
#include "client/view/pending_source.h"

#include <optional>
#include <utility>

namespace evpose::client {

// The view of a page that was opened before Provide().
class PendingSource::View : public PageView {
 public:
  View(PendingSource& pending, std::shared_ptr<PageOutbox> outbox) : pending_(pending), outbox_(std::move(outbox)) {}
  ~View() override {
    const std::lock_guard lock(pending_.mutex_);
    std::erase(pending_.waiting_, this);
  }

  absl::Status Handle(const PageRequest& request) override {
    const std::lock_guard lock(pending_.mutex_);
    if (view_ != nullptr) return view_->Handle(request);
    // Other requests change the present instant, and there is none before the recording is shown.
    if (const auto* settings = std::get_if<ImageSettings>(&request)) settings_ = *settings;
    return absl::OkStatus();
  }

  // Called with the lock of the pending source.
  void Begin(ViewSource& source) {
    view_ = source.Open(outbox_);
    // All sources accept settings at any time.
    if (settings_) view_->Handle(*settings_).IgnoreError();
  }

 private:
  PendingSource& pending_;
  const std::shared_ptr<PageOutbox> outbox_;
  std::optional<ImageSettings> settings_;
  std::unique_ptr<PageView> view_;
};

std::unique_ptr<PageView> PendingSource::Open(std::shared_ptr<PageOutbox> outbox) {
  const std::lock_guard lock(mutex_);
  if (source_ != nullptr) return source_->Open(std::move(outbox));
  outbox->Set(PageOutbox::Latest::kHello, ToText(hello_));
  outbox->AddNote(NoticeText(NoticeLevel::kInfo, notice_));
  auto view = std::make_unique<View>(*this, std::move(outbox));
  waiting_.push_back(view.get());
  return view;
}

void PendingSource::Provide(ViewSource& source) {
  const std::lock_guard lock(mutex_);
  source_ = &source;
  for (View* const view : waiting_) view->Begin(source);
  waiting_.clear();
}

}  // namespace evpose::client
