// SPDX-License-Identifier: Apache-2.0

// The streams of a client: Track with ResetPose, WatchPoses, WatchHealth and WatchEvents.
#include <grpcpp/client_context.h>

#include <memory>
#include <mutex>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/client_access.h"
#include "client/lib/client_impl.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/server_choice.h"
#include "client/lib/stream/event_feed.h"
#include "client/lib/stream/reconnecting_stream.h"
#include "client/lib/stream/retry.h"
#include "core/base/status_macros.h"
#include "evpose/client.h"

namespace evpose::client {
namespace {

template <typename Response>
using ResponseReader = std::unique_ptr<grpc::ClientReaderInterface<Response>>;
template <typename Request, typename Response>
using WatchMethod = ResponseReader<Response> (Sessions::*)(grpc::ClientContext*, const Request&);

// Reads a stream of responses of one server to its end, or until `handle(response)` returns false.
template <typename Request, typename Response, typename Handle>
absl::Status WatchAt(const Endpoint& endpoint, WatchMethod<Request, Response> method, const Request& request,
                     const Handle& handle, const std::stop_token& stop) {
  grpc::ClientContext context;
  const std::shared_ptr<const Connection> connection = endpoint.connection();
  const ResponseReader<Response> reader = (*connection->sessions.*method)(&context, request);
  const std::stop_callback cancel_on_stop(stop, [&context] { context.TryCancel(); });
  Response response;
  while (reader->Read(&response)) {
    if (handle(response)) continue;
    context.TryCancel();
    break;
  }
  return FromGrpc(reader->Finish(), endpoint.name);
}

// The session has moved to another server, or continues from an earlier state.
bool HasMoved(const absl::Status& status) {
  const v1::ErrorReason reason = ReasonOf(status);
  return reason == v1::FENCED || (reason == v1::ROLLED_BACK && absl::IsUnavailable(status));
}

// Reads a stream of responses until the session has ended, also after it has moved to another server or its server is
// unreachable: the present `request` is sent again, with growing delays while no server delivers a response. A server
// that does not track the events names no other, so that all are asked. An error of `handle(response)` means that the
// response is invalid, and cancels the call.
template <typename Impl, typename Request, typename Response, typename Handle>
absl::Status Watch(Impl& impl, WatchMethod<Request, Response> method, const Request& request, const Handle& handle,
                   const std::stop_token& stop) {
  ServerChoice choice(impl.endpoints, impl.current, *impl.clock, stop);
  size_t num_others = 0;  // consecutive servers that do not track the events
  Backoff backoff((RetryOptions()));
  absl::Status invalid;
  const auto read = [&](const Response& response) {
    choice.Responded();
    backoff.Reset();
    num_others = 0;
    invalid = handle(response);
    return invalid.ok();
  };
  while (true) {
    const absl::Status status = WatchAt(choice.endpoint(), method, request, read, stop);
    if (!invalid.ok()) return absl::InternalError(absl::StrCat(choice.endpoint().name, ": ", invalid.message()));
    if (stop.stop_requested()) return status;
    if (choice.Next(status)) continue;
    if (ReasonOf(status) == v1::SESSION_NOT_TRACKED_HERE && num_others + 1 < impl.endpoints.size()) {
      ++num_others;
      choice.Skip();
    } else if (HasMoved(status)) {
      num_others = 0;
      // The session's new server may not be known yet, or the store may name this one again.
      if (!impl.clock->SleepUntil(impl.clock->Now() + backoff.Next(), stop)) {
        return absl::CancelledError(absl::StrCat(choice.endpoint().name, ": the call was cancelled"));
      }
    } else {
      return choice.Final(status);
    }
  }
}

}  // namespace

absl::StatusOr<TrackSummary> Client::Track(const Session& session, const ChunkSource& source,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  TrackOptions checked = options;
  for (const TrackedObject& object : session.config.objects) checked.object_ids.push_back(object.object_id);
  return Track(TrackPosition{.session = session.name, .resume_token = session.resume_token}, source, callbacks,
               checked);
}

absl::StatusOr<TrackSummary> Client::Track(const TrackPosition& position, const ChunkSource& source,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const FeedOptions feed_options = {
      .outbox = {.retain = options.retain}, .rate = options.rate, .clock = options.clock, .skip = position.durable};
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventFeed> feed, EventFeed::Open(source, feed_options));
  if (position.max_piece_bytes > 0) feed->Start(position.max_piece_bytes);
  return ClientAccess::Track(*this, position, *feed, callbacks, options);
}

absl::StatusOr<TrackSummary> ClientAccess::Track(Client& client, const TrackPosition& position, EventFeed& feed,
                                                 const TrackCallbacks& callbacks, const TrackOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  Client::Impl& impl = *client.impl_;
  std::vector<StreamServer> servers;
  for (Endpoint& endpoint : impl.endpoints) {
    const auto connect = [&impl, &options, &endpoint]() -> StreamServer::Stub {
      endpoint.LeaveAfterRefusal(options.stop.get_token());
      endpoint.ConnectAgain(impl.endpoints.size(), options.stop.get_token());
      const std::shared_ptr<const Connection> connection = endpoint.connection();
      return {connection, connection->sessions.get()};
    };
    servers.push_back({endpoint.name, connect, [&endpoint] { endpoint.NoteRefusal(); }});
    if (impl.options.renew_token) {
      servers.back().auth_token = [&impl] { return impl.options.renew_token().value_or(""); };
    }
  }
  ReconnectingStream stream(servers, impl.current, impl.sessions_outlive_server, position, feed, callbacks, options);
  {
    const std::lock_guard lock(impl.feeds_mutex);
    impl.feeds[position.session] = &feed;
  }
  absl::StatusOr<TrackSummary> summary = stream.Run();
  {
    const std::lock_guard lock(impl.feeds_mutex);
    const auto own = impl.feeds.find(position.session);
    if (own != impl.feeds.end() && own->second == &feed) impl.feeds.erase(own);
  }
  std::stop_source stop = options.stop;
  stop.request_stop();
  feed.Stop();
  return summary;
}

absl::Status Client::ResetPose(const std::string& session, const PoseReset& reset) {
  const std::lock_guard lock(impl_->feeds_mutex);
  const auto feed = impl_->feeds.find(session);
  if (feed == impl_->feeds.end()) {
    return absl::FailedPreconditionError(absl::StrCat(session, ": no Track() of this session runs in this client"));
  }
  const absl::Status status = feed->second->ResetPose(reset);
  return absl::Status(status.code(), absl::StrCat(session, ": ", status.message()));
}

absl::Status Client::WatchPoses(const std::string& session, const WatchPosesOptions& options,
                                const PosesCallback& on_poses, std::stop_token stop) {
  v1::WatchPosesRequest request;
  request.set_session(session);
  request.set_after_pose_seq(options.after_pose_seq);
  if (options.max_rate_hz) request.set_max_rate_hz(*options.max_rate_hz);
  const auto handle = [&](const v1::WatchPosesResponse& response) -> absl::Status {
    if (response.has_continues_after_pose_seq()) {
      if (options.on_rolled_back) options.on_rolled_back(response.continues_after_pose_seq());
      if (response.poses().empty() && response.num_skipped() == 0) return absl::OkStatus();
    }
    std::vector<Pose> poses;
    for (const v1::Pose& message : response.poses()) {
      EVPOSE_ASSIGN_OR_RETURN(Pose pose, FromProto(message));
      request.set_after_pose_seq(pose.seq);
      if (pose.state != TrackState::kUnknown) poses.push_back(std::move(pose));  // else it is not confirmed
    }
    on_poses(poses, response.num_skipped());
    return absl::OkStatus();
  };
  return Watch(*impl_, &Sessions::WatchPoses, request, handle, stop);
}

absl::Status Client::WatchHealth(const std::string& session, absl::Duration period, const HealthCallback& on_health,
                                 std::stop_token stop) {
  v1::WatchHealthRequest request;
  request.set_session(session);
  *request.mutable_period() = ToProto(period);
  const auto handle = [&](const v1::WatchHealthResponse& response) {
    on_health(FromProto(response.health()));
    return absl::OkStatus();
  };
  return Watch(*impl_, &Sessions::WatchHealth, request, handle, stop);
}

absl::Status Client::WatchEvents(const std::string& session, const WatchEventsOptions& options,
                                 const EventsCallback& on_image, std::stop_token stop) {
  if (options.cell_px != 1 && options.cell_px != 2 && options.cell_px != 4) {
    return absl::InvalidArgumentError(absl::StrCat("cell_px: is ", options.cell_px, "; it must be 1, 2 or 4"));
  }
  v1::WatchEventsRequest request;
  request.set_session(session);
  request.set_cell_px(static_cast<uint32_t>(options.cell_px));
  request.set_max_rate_hz(options.max_rate_hz);
  const auto handle = [&](const v1::WatchEventsResponse& response) -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(EventImage image, FromProto(response.image()));
    on_image(std::move(image));
    return absl::OkStatus();
  };
  return Watch(*impl_, &Sessions::WatchEvents, request, handle, stop);
}

}  // namespace evpose::client
