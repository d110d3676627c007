// SPDX-License-Identifier: Apache-2.0

// Reads MCAP files in tests, with the reader of recordings and by the definitions of the messages.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/containers/byte_view.h"
#include "client/containers/mcap_records.h"
#include "core/recordings/byte_source.h"

namespace evpose::client {

struct TestMessage {
  std::string topic;
  std::string type;
  std::string definition;
  uint32_t sequence = 0;
  uint64_t log_time_ns = 0;
  std::string bytes;

  bool operator==(const TestMessage&) const = default;
};

// All messages of a file in its order; `skipped` receives what the reader could not read.
inline std::vector<TestMessage> ReadMessages(const std::string& path, std::vector<SkippedParts>* skipped = nullptr) {
  auto bytes = ByteSource::Open(path, {});
  EXPECT_TRUE(bytes.ok()) << bytes.status();
  EXPECT_TRUE((*bytes)->Seek(static_cast<int64_t>(kMcapMagic.size())).ok());
  McapRecords records(*std::move(bytes));
  std::map<uint16_t, std::pair<std::string, std::string>> schemas;
  std::map<uint16_t, TestMessage> channels;
  std::vector<TestMessage> messages;
  while (true) {
    const auto record = records.Next();
    EXPECT_TRUE(record.ok());
    if (!record.ok() || !*record) break;
    ByteView view((*record)->content);
    const auto id = view.Take<uint16_t>();
    if ((*record)->op == McapRecord::kSchema) {
      const std::string name(view.TakeString());
      EXPECT_EQ(view.TakeString(), "ros2msg");
      schemas[id] = {name, std::string(view.TakeString())};
    } else if ((*record)->op == McapRecord::kChannel) {
      const auto& [type, definition] = schemas.at(view.Take<uint16_t>());
      channels[id] = {.topic = std::string(view.TakeString()), .type = type, .definition = definition};
      EXPECT_EQ(view.TakeString(), "cdr");
    } else if ((*record)->op == McapRecord::kMessage) {
      TestMessage message = channels.at(id);
      message.sequence = view.Take<uint32_t>();
      message.log_time_ns = view.Take<uint64_t>();
      EXPECT_EQ(view.Take<uint64_t>(), message.log_time_ns);
      message.bytes = view.rest();
      messages.push_back(std::move(message));
    }
  }
  if (skipped != nullptr) *skipped = records.skipped();
  return messages;
}

// Decodes a message by its definition alone: the values by their paths, such as "pose.pose.position.x" or
// "status[1].name"; the number of elements of a sequence under its path with "#".
class MessageReader {
 public:
  MessageReader(const std::string& type, const std::string& definition, std::string_view bytes) : bytes_(bytes) {
    const std::vector<std::string> parts = absl::StrSplit(definition, std::string(80, '=') + "\nMSG: ");
    definitions_[""] = parts[0];
    for (size_t i = 1; i < parts.size(); ++i) {
      const std::pair<std::string, std::string> named = absl::StrSplit(parts[i], absl::MaxSplits('\n', 1));
      definitions_[named.first] = named.second;
    }
    EXPECT_EQ(bytes.substr(0, 4), std::string_view("\0\1\0\0", 4)) << type;
    position_ = 4;
    ReadStruct("", "");
    EXPECT_EQ(position_, bytes_.size()) << type << ": the message has another length than its definition";
  }

  double Number(const std::string& path) const { return numbers_.at(path); }
  const std::string& Text(const std::string& path) const { return texts_.at(path); }

 private:
  void ReadStruct(const std::string& type, const std::string& path) {
    ASSERT_TRUE(definitions_.contains(type)) << type << " has no definition";
    for (const std::string& line : std::vector<std::string>(absl::StrSplit(definitions_[type], '\n'))) {
      if (line.empty() || absl::StrContains(line, "=")) continue;  // a constant
      const std::vector<std::string> words = absl::StrSplit(line, ' ');
      ReadField(words.at(0), path.empty() ? words.at(1) : path + "." + words.at(1));
    }
  }

  void ReadField(const std::string& type, const std::string& path) {
    const size_t bracket = type.find('[');
    if (bracket == std::string::npos) return ReadValue(type, path);
    const std::string element = type.substr(0, bracket);
    const bool is_sequence = type[bracket + 1] == ']';
    const size_t count = is_sequence ? Take<uint32_t>() : std::stoul(type.substr(bracket + 1));
    numbers_[path + "#"] = static_cast<double>(count);
    if (element == "uint8") {
      texts_[path] = bytes_.substr(position_, count);
      position_ += count;
      return;
    }
    for (size_t i = 0; i < count && position_ < bytes_.size(); ++i) ReadValue(element, absl::StrCat(path, "[", i, "]"));
  }

  void ReadValue(const std::string& type, const std::string& path) {
    if (type == "float64") {
      numbers_[path] = std::bit_cast<double>(Take<uint64_t>());
    } else if (type == "float32") {
      numbers_[path] = static_cast<double>(std::bit_cast<float>(Take<uint32_t>()));
    } else if (type == "int32") {
      numbers_[path] = Take<int32_t>();
    } else if (type == "uint32") {
      numbers_[path] = Take<uint32_t>();
    } else if (type == "uint8" || type == "byte" || type == "bool") {
      numbers_[path] = Take<uint8_t>();
    } else if (type == "string") {
      const auto size = Take<uint32_t>();
      ASSERT_TRUE(size > 0 && position_ + size <= bytes_.size()) << path;
      EXPECT_EQ(bytes_[position_ + size - 1], '\0') << path;
      texts_[path] = bytes_.substr(position_, size - 1);
      position_ += size;
    } else {
      ReadStruct(type, path);
    }
  }

  template <typename Number>
  Number Take() {
    position_ += (sizeof(Number) - (position_ - 4) % sizeof(Number)) % sizeof(Number);
    ByteView view(bytes_.substr(std::min(position_, bytes_.size())));
    const auto value = view.Take<Number>();
    EXPECT_TRUE(view.ok());
    position_ += sizeof(Number);
    return value;
  }

  const std::string_view bytes_;
  size_t position_ = 0;
  std::map<std::string, std::string> definitions_;
  std::map<std::string, double> numbers_;
  std::map<std::string, std::string> texts_;
};

}  // namespace evpose::client
