// SPDX-License-Identifier: Apache-2.0
#include "server/models/stored_views.h"

#include <utility>

namespace evpose::server {
namespace {

// A template model has at most 642 views, a search model 384.
constexpr int kMaxViews = 1024;

// The sum of at most kMaxViews sizes; -1 if there are more.
int64_t SumOf(const google::protobuf::RepeatedField<uint32_t>& sizes) {
  if (sizes.size() > kMaxViews) return -1;
  int64_t sum = 0;
  for (const uint32_t size : sizes) sum += size;
  return sum;
}

bool HasWholeViews(const storage::v1::SearchViews& stored) {
  const int64_t num_samples = SumOf(stored.template_sizes()), num_lines = SumOf(stored.line_view_sizes());
  return stored.template_contrasts_size() == num_samples && stored.template_samples_size() == 6 * num_samples &&
         stored.view_lines_size() == num_lines && stored.view_parts_size() == 3 * num_lines;
}

}  // namespace

storage::v1::SearchViews ToStored(const SearchViews& views) {
  storage::v1::SearchViews stored;
  for (const auto& samples : views.templates) {
    stored.add_template_sizes(static_cast<uint32_t>(samples.size()));
    for (const EdgeSample& sample : samples) {
      stored.mutable_template_samples()->Add(sample.point.begin(), sample.point.end());
      stored.mutable_template_samples()->Add(sample.along.begin(), sample.along.end());
      stored.add_template_contrasts(sample.prior_contrast);
    }
  }
  for (const auto& lines : views.lines) {
    stored.add_line_view_sizes(static_cast<uint32_t>(lines.size()));
    for (const ViewLine& line : lines) {
      stored.add_view_lines(static_cast<uint32_t>(line.line));
      for (const double number : {line.begin, line.end, line.certain_ratio}) stored.add_view_parts(number);
    }
  }
  return stored;
}

absl::StatusOr<std::shared_ptr<const SearchViews>> ViewsOf(const storage::v1::SearchViews& stored) {
  if (!HasWholeViews(stored)) return absl::DataLossError("the views of the prepared model cannot be parsed");
  auto views = std::make_shared<SearchViews>();
  const double* number = stored.template_samples().data();
  const float* contrast = stored.template_contrasts().data();
  for (const uint32_t size : stored.template_sizes()) {
    auto& samples = views->templates.emplace_back(size);
    for (EdgeSample& sample : samples) {
      sample = {{number[0], number[1], number[2]}, {number[3], number[4], number[5]}, *contrast++};
      number += 6;
    }
  }
  const uint32_t* index = stored.view_lines().data();
  number = stored.view_parts().data();
  for (const uint32_t size : stored.line_view_sizes()) {
    auto& lines = views->lines.emplace_back(size);
    for (ViewLine& line : lines) {
      line = {static_cast<int>(*index++), number[0], number[1], number[2]};
      number += 3;
    }
  }
  return std::shared_ptr<const SearchViews>(std::move(views));
}

}  // namespace evpose::server
