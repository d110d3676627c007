// SPDX-License-Identifier: Apache-2.0
#include "server/models/model_limits.h"

#include <string>

#include "absl/status/status.h"
#include "gtest/gtest.h"
#include "server/runtime/errors.h"
#include "server/runtime/failing_allocations_testing.h"

namespace evpose::server {
namespace {

std::string LimitOf(const absl::Status& status) {
  return absl::StrCat(GetErrorDetails(status).reason, " ", GetErrorDetails(status).quota_subject);
}

TEST(ModelLimitsTest, BytesCountWhenTheyArrive) {
  ModelLimits limits({.max_model_bytes = 4096, .max_store_bytes = 6000});
  std::vector<std::unique_ptr<ModelLimits::Upload>> headers;
  for (int i = 0; i < 8; ++i) {
    headers.push_back(limits.BeginUpload("mallory").value());
    EXPECT_TRUE(headers.back()->Declare(4096).ok()) << "a header without bytes takes no room";
  }
  EXPECT_EQ(GetErrorDetails(headers[0]->Declare(0)).field, "header.size_bytes");
  EXPECT_EQ(GetErrorDetails(headers[0]->Declare(4097)).field, "header.size_bytes");
  EXPECT_TRUE(headers[0]->Add(4000).ok());
  EXPECT_EQ(LimitOf(headers[1]->Declare(2001)), "MODEL_STORE_FULL max_model_store_bytes");
  EXPECT_EQ(LimitOf(headers[1]->Add(2001)), "MODEL_STORE_FULL max_model_store_bytes");
  EXPECT_TRUE(headers[1]->Add(2000).ok());
  headers[0].reset();
  EXPECT_TRUE(headers[1]->Add(4000).ok()) << "an upload that has ended gives its bytes back";
  limits.AddStored("", 5000);
  headers.clear();
  EXPECT_EQ(LimitOf(limits.BeginUpload("")->get()->Declare(1001)), "MODEL_STORE_FULL max_model_store_bytes");
  limits.RemoveStored("", 5000);
  EXPECT_TRUE(limits.BeginUpload("")->get()->Declare(1001).ok());
}

TEST(ModelLimitsTest, TheBytesOfATenantAreLimited) {
  ModelLimits limits({.max_model_bytes = 4096, .max_store_bytes = 9000, .max_tenant_bytes = 5000});
  const auto upload = limits.BeginUpload("lab").value();
  ASSERT_TRUE(upload->Add(4096).ok());
  EXPECT_EQ(LimitOf(upload->Add(905)), "TENANT_QUOTA tenant_model_bytes");
  EXPECT_TRUE(upload->Add(904).ok());
  const auto others = limits.BeginUpload("field").value();
  EXPECT_TRUE(others->Add(4000).ok());
  EXPECT_EQ(LimitOf(others->Add(1)), "MODEL_STORE_FULL max_model_store_bytes");
}

TEST(ModelLimitsTest, UploadsAreCounted) {
  ModelLimits limits({.max_uploads = 3, .max_tenant_uploads = 2});
  auto first = limits.BeginUpload("lab").value();
  const auto second = limits.BeginUpload("lab").value();
  EXPECT_EQ(LimitOf(limits.BeginUpload("lab").status()), "TENANT_QUOTA tenant_uploads");
  const auto third = limits.BeginUpload("field").value();
  EXPECT_EQ(LimitOf(limits.BeginUpload("field").status()), "TOO_MANY_UPLOADS max_uploads");
  first.reset();
  EXPECT_TRUE(limits.BeginUpload("lab").ok());
}

// Whichever allocation fails, the call ends, and nothing stays counted.
TEST(ModelLimitsTest, WithoutMemoryNothingIsCounted) {
  ModelLimits limits({.max_model_bytes = 100, .max_store_bytes = 100, .max_uploads = 1});
  const std::string tenant = "a name that does not fit into the string itself";
  const auto upload = [&] { limits.BeginUpload(tenant).value()->Add(100).IgnoreError(); };
  const int num_failed = FailEachAllocation(upload, [&](int number) {
    const auto next = limits.BeginUpload(tenant);
    ASSERT_TRUE(next.ok()) << number;
    EXPECT_TRUE(next.value()->Add(100).ok()) << number;
  });
  EXPECT_GT(num_failed, 1);
}

}  // namespace
}  // namespace evpose::server
