// SPDX-License-Identifier: Apache-2.0

// Helpers of the tests of WatchEvents.
#pragma once

#include <zlib.h>

#include <memory>
#include <string>

#include "core/base/poll_testing.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {

using EventReader = std::unique_ptr<grpc::ClientReader<v1::WatchEventsResponse>>;

// The cells of an image, unpacked.
inline std::string CellsOf(const v1::EventImage& image) {
  const size_t num_bytes = (static_cast<size_t>(image.width()) * image.height() + 3) / 4;
  if (image.encoding() == v1::EventImage::ENCODING_PACKED) {
    EXPECT_EQ(image.cells().size(), num_bytes);
    return image.cells();
  }
  EXPECT_EQ(image.encoding(), v1::EventImage::ENCODING_ZLIB);
  EXPECT_LT(image.cells().size(), num_bytes);
  std::string cells(num_bytes, '\0');
  uLongf size = num_bytes;
  EXPECT_EQ(uncompress(reinterpret_cast<Bytef*>(cells.data()), &size,
                       reinterpret_cast<const Bytef*>(image.cells().data()), image.cells().size()),
            Z_OK);
  EXPECT_EQ(size, num_bytes);
  return cells;
}

// The sum of what the images of a stream show.
struct Shown {
  std::string cells;
  uint64_t num_events = 0;
  uint64_t num_skipped = 0;
  int num_images = 0;
  v1::EventImage last;

  void Add(const v1::EventImage& image) {
    if (num_images++ > 0) {
      EXPECT_EQ(image.from_t_us(), last.to_t_us());
    }
    EXPECT_GE(image.to_t_us(), image.from_t_us());
    EXPECT_GE(image.num_skipped(), num_skipped);
    const std::string unpacked = CellsOf(image);
    cells.resize(unpacked.size(), '\0');
    for (size_t i = 0; i < unpacked.size(); ++i) cells[i] = static_cast<char>(cells[i] | unpacked[i]);
    num_events += image.num_events();
    num_skipped = image.num_skipped();
    last = image;
  }
};

class WatchEventsTest : public RpcTest {
 protected:
  // Starts to watch, and returns as soon as images are made.
  EventReader Watch(grpc::ClientContext& context, const v1::WatchEventsRequest& request) {
    const uint32_t before = server_->state().sessions.image_watchers;
    auto reader = sessions_->WatchEvents(&context, request);
    EXPECT_TRUE(Poll([&] { return server_->state().sessions.image_watchers != before; }));
    return reader;
  }
  static v1::WatchEventsRequest Request(const CreatedSession& session, uint32_t cell_px = 0) {
    v1::WatchEventsRequest request;
    request.set_session(session.name());
    request.set_cell_px(cell_px);
    return request;
  }
  std::string WatchError(const v1::WatchEventsRequest& request) {
    grpc::ClientContext context;
    return Describe(sessions_->WatchEvents(&context, request)->Finish());
  }
};

}  // namespace evpose::server
