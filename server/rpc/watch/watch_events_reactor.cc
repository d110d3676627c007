// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <optional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/events/event_bitmap.h"
#include "server/rpc/common/conversion.h"
#include "server/rpc/watch/watch_reactor.h"
#include "server/rpc/watch/watch_reactors.h"
#include "server/runtime/errors.h"
#include "server/sessions/memory/session_memory.h"
#include "server/sessions/watching/event_images.h"

namespace evpose::server {
namespace {

// Defaults that the API states. An image of a sensor of 1280 x 720 pixels then has 57,600 bytes before compression, and
// motion at 30 images per second looks continuous.
constexpr uint32_t kDefaultCellPx = 2;
constexpr double kDefaultRateHz = 30.0;
// With the outlines, an image is smaller than the 4 MiB that gRPC's clients receive.
constexpr size_t kMaxCellsBytes = size_t{3} << 20;

// Sends each image that is due. Images are taken from the session when the previous one has been written, so that a
// slow reader needs the memory of a few images and no queue.
class WatchEventsReactor : public WatchReactor<v1::WatchEventsResponse> {
 public:
  using WatchReactor::WatchReactor;

  absl::Status Begin(const Caller& caller, const v1::WatchEventsRequest& request) {
    if (!services().shows_events) {
      return WithReason(
          absl::FailedPreconditionError("this server does not show events: it was started with --event-images=false"),
          v1::EVENT_IMAGES_OFF);
    }
    if (request.cell_px() != 0) cell_px_ = request.cell_px();
    if (cell_px_ != 1 && cell_px_ != 2 && cell_px_ != 4) {
      return InvalidField("cell_px", absl::StrCat("is ", cell_px_, "; it must be 1, 2 or 4"));
    }
    if (request.has_max_rate_hz()) max_rate_hz_ = request.max_rate_hz();
    if (!(max_rate_hz_ > 0.0 && max_rate_hz_ <= EventImages::kMaxRateHz)) {
      return InvalidField("max_rate_hz", absl::StrCat("is ", max_rate_hz_, "; it must be positive and at most ",
                                                      EventImages::kMaxRateHz));
    }
    tenant_ = caller.tenant;
    name_ = request.session();
    return FindSession(caller, name_);
  }

 private:
  // Images are compressed on their own thread, and not on gRPC's.
  void Continue() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const absl::Status posted = services().pool.images().TryPost(
        tenant_, [self = shared_from_this()](const absl::Status&) { self->OnSessionChanged(); });
    if (posted.ok()) return;
    Fail(posted);
    Pump();
  }

  absl::Status OnFound() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const std::shared_ptr<EventImages> images = session().event_images();
    if (images == nullptr) {
      if (session().Watch().has_ended) return absl::OkStatus();
      return WithReason(
          absl::FailedPreconditionError(absl::StrCat(
              name_,
              ": its events are not tracked at this server, which has no images of them; call the server that "
              "its stream is attached to")),
          v1::SESSION_NOT_TRACKED_HERE, {{"session", name_}});
    }
    const SessionConfig& config = session().config();
    const int cell_px = static_cast<int>(cell_px_);
    const size_t bytes = EventBitmap::NumBytes({config.camera.width_px, config.camera.height_px}, cell_px);
    if (bytes > kMaxCellsBytes) {
      return InvalidField("cell_px",
                          absl::StrCat("is ", cell_px, ", and the image would have ", bytes, " bytes; at most ",
                                       kMaxCellsBytes, " are sent: ask for larger cells"));
    }
    EVPOSE_ASSIGN_OR_RETURN(
        const MemoryCharge charge,
        services().sessions.options().memory->Charge(tenant_, {.other_bytes = EventWatcherMemory(config, cell_px)}));
    charge_ = charge.other;
    reader_ = images->Open(cell_px, max_rate_hz_, weak_from_this());
    return absl::OkStatus();
  }

  bool PickResponse(const WatchView& view, v1::WatchEventsResponse& response, bool& is_last) override
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (reader_ != nullptr) Fail(reader_->status());
    const auto taken = reader_ == nullptr ? std::nullopt : reader_->Take();
    // All images of a session are due before the session has ended.
    is_last = view.has_ended && !taken.has_value();
    if (taken) *response.mutable_image() = ToProto(*taken->image, taken->num_skipped, session().config());
    return taken.has_value();
  }

  void OnFinish() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    reader_.reset();
    charge_.reset();
  }

  uint32_t cell_px_ = kDefaultCellPx;
  double max_rate_hz_ = kDefaultRateHz;
  std::string tenant_;
  std::string name_;
  std::shared_ptr<const void> charge_ ABSL_GUARDED_BY(mutex_);           // of memory
  std::unique_ptr<EventImages::Reader> reader_ ABSL_GUARDED_BY(mutex_);  // null: no more events follow
};

}  // namespace

grpc::ServerWriteReactor<v1::WatchEventsResponse>* StartWatchEvents(const ServiceContext& services,
                                                                    grpc::CallbackServerContext* context,
                                                                    const v1::WatchEventsRequest& request) {
  return StartWatch<WatchEventsReactor>(services, context, request);
}

}  // namespace evpose::server
