// SPDX-License-Identifier: Apache-2.0

// The streams of a client: Track and WatchPoses.
#include <grpcpp/client_context.h>

#include <map>
#include <utility>

#include "client/lib/client_access.h"
#include "client/lib/client_impl.h"
#include "client/lib/conversion.h"
#include "client/lib/stream/event_feed.h"
#include "client/lib/stream/track_loop.h"
#include "core/base/status_macros.h"
#include "evpose/client.h"

namespace evpose::client {

absl::StatusOr<TrackSummary> Client::Track(const Session& session, const ChunkSource& source,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  TrackPosition position;
  position.session = session.name;
  position.resume_token = session.resume_token;
  return Track(position, source, callbacks, options);
}

absl::StatusOr<TrackSummary> Client::Track(const TrackPosition& position, const ChunkSource& source,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  FeedOptions feed_options;
  feed_options.rate = options.rate;
  feed_options.clock = options.clock;
  feed_options.skip = position.durable;
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventFeed> feed, EventFeed::Open(source, feed_options));
  if (position.max_piece_bytes > 0) feed->Start(position.max_piece_bytes);
  return ClientAccess::Track(*this, position, *feed, callbacks, options);
}

absl::StatusOr<TrackSummary> ClientAccess::Track(Client& client, const TrackPosition& position, EventFeed& feed,
                                                 const TrackCallbacks& callbacks, const TrackOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  Client::Impl& impl = *client.impl_;
  std::vector<TrackServer> servers;
  for (const Client::Impl::Endpoint& endpoint : impl.endpoints) {
    servers.push_back({endpoint.name, endpoint.sessions.get(), [channel = endpoint.channel.get()] {
                         grpc::experimental::ChannelResetConnectionBackoff(channel);
                       }});
  }
  TrackLoop loop(servers, impl.current, impl.sessions_outlive_server, position, feed, callbacks, options);
  absl::StatusOr<TrackSummary> summary = loop.Run();
  std::stop_source stop = options.stop;
  stop.request_stop();
  feed.Stop();
  return summary;
}

absl::Status Client::Impl::WatchPosesOnce(const std::string& session, uint64_t& after_pose_seq,
                                          const PosesCallback& on_poses, const std::stop_token& stop) {
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session);
  request.set_after_pose_seq(after_pose_seq);
  const std::unique_ptr<grpc::ClientReaderInterface<v1::WatchPosesResponse>> reader =
      endpoint().sessions->WatchPoses(&context, request);
  const std::stop_callback cancel_on_stop(stop, [&context] { context.TryCancel(); });
  v1::WatchPosesResponse response;
  absl::Status malformed;
  while (reader->Read(&response)) {
    std::vector<Pose> poses;
    for (const v1::Pose& message : response.poses()) {
      absl::StatusOr<Pose> pose = FromProto(message);
      malformed.Update(pose.status());
      if (pose.ok()) poses.push_back(*std::move(pose));
    }
    if (!malformed.ok()) break;
    on_poses(poses, response.num_skipped());
    if (!poses.empty()) after_pose_seq = poses.back().seq;
  }
  if (!malformed.ok()) context.TryCancel();
  const grpc::Status status = reader->Finish();
  if (!malformed.ok()) return absl::InternalError(absl::StrCat(endpoint().name, ": ", malformed.message()));
  return FromGrpc(status, endpoint().name);
}

absl::Status Client::WatchPoses(const std::string& session, uint64_t after_pose_seq, const PosesCallback& on_poses,
                                std::stop_token stop) {
  absl::Status status;
  do {
    status = impl_->WatchPosesOnce(session, after_pose_seq, on_poses, stop);
  } while (ReasonOf(status) == v1::FENCED && !stop.stop_requested());
  return status;
}

}  // namespace evpose::client
