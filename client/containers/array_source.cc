// SPDX-License-Identifier: Apache-2.0
#include "client/containers/array_source.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/containers/column_layout.h"
#include "client/containers/event_source.h"
#include "client/containers/npy_array.h"
#include "client/containers/zip_entries.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kPieceEvents = 16384;  // converted at a time: 256 KiB, which stays in the cache
constexpr double kMaxTimeUs = 9e18;     // below the range of int64_t

// A column of numbers: a field of the items of an array.
struct ArrayColumn {
  size_t array = 0;
  NpyField field;
};

struct NamedArray {
  std::string name;
  NpyArray array;
};

// The arrays of a file, at their beginning.
using ArrayOpener = std::function<absl::StatusOr<std::vector<NamedArray>>()>;

// Whether the array is a list of rows of four numbers.
bool HasRows(const NpyHeader& header) {
  return header.fields.size() == 1 && header.fields[0].name.empty() && header.shape.size() == 2 &&
         header.shape[1] == 4 && !header.is_fortran_order && header.fields[0].kind != '?';
}
int64_t NumbersOfEvent(const NpyHeader& header) { return HasRows(header) ? 4 : 1; }
bool IsList(const NpyHeader& header) { return header.shape.size() == 1; }

std::vector<std::string> NamesOf(const std::vector<ArrayColumn>& columns) {
  std::vector<std::string> names;
  for (const ArrayColumn& column : columns) names.push_back(column.field.name);
  return names;
}

int64_t ScaledTime(const NpyNumber& number, int exponent) {
  double factor = 1.0;
  for (int i = 0; i < std::abs(exponent); ++i) factor *= 10.0;
  if (number.is_integer && exponent == 0) return number.integer;
  if (number.is_integer && exponent < 0) {
    const auto divisor = static_cast<int64_t>(factor);
    const int64_t rest = number.integer % divisor;
    return number.integer / divisor + (2 * rest >= divisor ? 1 : 0) - (2 * rest <= -divisor ? 1 : 0);
  }
  const double t_us = exponent < 0 ? number.floating / factor : number.floating * factor;
  // An impossible time is left out by the reader of the source.
  return std::abs(t_us) < kMaxTimeUs ? std::llround(t_us) : std::numeric_limits<int64_t>::min();
}

int64_t Address(const NpyNumber& number) {
  if (number.is_integer) return number.integer;
  const bool is_address = number.floating >= 0.0 && number.floating < 65536.0;
  return is_address && number.floating == std::floor(number.floating) ? static_cast<int64_t>(number.floating) : -1;
}

class ArraySource final : public EventSource {
 public:
  // `columns` are those that the layout counts.
  ArraySource(std::vector<NamedArray> arrays, std::vector<ArrayColumn> columns) : columns_(std::move(columns)) {
    for (NamedArray& each : arrays) arrays_.push_back(std::move(each.array));
    pieces_.resize(arrays_.size());
  }

  // Finds the layout with the first events.
  absl::Status Start(const std::string& name, bool has_names) {
    EVPOSE_RETURN_IF_ERROR(ReadPiece());
    std::optional<ColumnLayout> layout;
    std::vector<TableRow> rows(num_events_);
    for (size_t i = 0; i < num_events_; ++i) {
      for (size_t c = 0; c < std::min<size_t>(columns_.size(), 4); ++c) rows[i][c] = Number(c, i).floating;
    }
    if (!has_names) {
      layout = LayoutOfRows(rows);
    } else {
      layout = LayoutOfNames(NamesOf(columns_), {});
      std::vector<double> times;
      for (size_t i = 0; layout && i < num_events_; ++i) {
        if (CanBeEvent(*layout, i)) times.push_back(Number(static_cast<size_t>(layout->t), i).floating);
      }
      if (layout) layout = LayoutOfNames(NamesOf(columns_), times);
    }
    if (!layout) {
      return absl::InvalidArgumentError(absl::StrCat(name, ": its columns are not t, x, y and p of events"));
    }
    layout_ = *layout;
    facts_.format = absl::StrCat("NumPy (", layout_.Describe());
    if (layout_.time_exponent != 0) absl::StrAppend(&facts_.format, ", t in ", TimeUnit(layout_.time_exponent));
    facts_.format += ')';
    is_piece_new_ = true;
    return absl::OkStatus();
  }

  const SourceFacts& facts() const override { return facts_; }

  absl::StatusOr<bool> Next(std::vector<SourceEvent>& events) override {
    events.clear();
    if (!std::exchange(is_piece_new_, false)) EVPOSE_RETURN_IF_ERROR(ReadPiece());
    for (size_t i = 0; i < num_events_; ++i) {
      const NpyNumber p = Number(static_cast<size_t>(layout_.p), i);
      if (!IsPolarity(p.floating)) {
        ++num_unreadable_;
        continue;
      }
      events.push_back({ScaledTime(Number(static_cast<size_t>(layout_.t), i), layout_.time_exponent),
                        Address(Number(static_cast<size_t>(layout_.x), i)),
                        Address(Number(static_cast<size_t>(layout_.y), i)), p.floating > 0.0});
    }
    return num_events_ > 0;
  }

  std::vector<SkippedParts> skipped() const override {
    std::vector<SkippedParts> parts;
    if (num_unreadable_ > 0)
      parts.push_back({"rows whose polarity is not -1, 0 or 1", num_unreadable_, SkippedParts::Loss::kEvents});
    if (num_events_ > 0) return parts;  // the others are known at the end
    int64_t num_announced = 0;
    for (const NpyArray& array : arrays_) {
      num_announced = std::max(num_announced, array.header().num_items() / NumbersOfEvent(array.header()));
    }
    if (num_announced > num_read_)
      parts.push_back({"events missing at the end, or without t, x, y or p",
                       static_cast<uint64_t>(num_announced - num_read_), SkippedParts::Loss::kEvents});
    return parts;
  }

 private:
  absl::Status ReadPiece() {
    num_events_ = kPieceEvents;
    for (size_t i = 0; i < arrays_.size(); ++i) {
      const auto numbers = static_cast<size_t>(NumbersOfEvent(arrays_[i].header()));
      EVPOSE_ASSIGN_OR_RETURN(const size_t count, arrays_[i].Next(kPieceEvents * numbers, pieces_[i]));
      num_events_ = std::min(num_events_, count / numbers);
    }
    num_read_ += static_cast<int64_t>(num_events_);
    return absl::OkStatus();
  }

  // An event without a row and column of the sensor, or without a polarity, is left out.
  bool CanBeEvent(const ColumnLayout& layout, size_t event) const {
    return Address(Number(static_cast<size_t>(layout.x), event)) >= 0 &&
           Address(Number(static_cast<size_t>(layout.y), event)) >= 0 &&
           IsPolarity(Number(static_cast<size_t>(layout.p), event).floating);
  }

  NpyNumber Number(size_t column, size_t event) const {
    const ArrayColumn& from = columns_[column];
    const NpyHeader& header = arrays_[from.array].header();
    const size_t event_bytes = header.item_bytes * static_cast<size_t>(NumbersOfEvent(header));
    return ReadNumber(from.field, pieces_[from.array].data() + event * event_bytes);
  }

  std::vector<NpyArray> arrays_;
  const std::vector<ArrayColumn> columns_;
  ColumnLayout layout_;
  SourceFacts facts_;
  std::vector<std::vector<uint8_t>> pieces_;  // of each array
  size_t num_events_ = 0;                     // in the pieces
  int64_t num_read_ = 0;                      // events, up to the pieces
  uint64_t num_unreadable_ = 0;
  bool is_piece_new_ = false;
};

// The readable fields of a structured array.
std::vector<ArrayColumn> FieldColumns(const NpyHeader& header) {
  std::vector<ArrayColumn> columns;
  for (const NpyField& field : header.fields) {
    if (field.kind != '?') columns.push_back({0, field});
  }
  return columns;
}

bool HasEventFields(const NpyHeader& header) {
  return IsList(header) && LayoutOfNames(NamesOf(FieldColumns(header)), {}).has_value();
}

absl::StatusOr<std::unique_ptr<EventSource>> MakeArraySource(const std::string& name, std::vector<NamedArray> arrays) {
  // One array with whole events: records, or rows of four numbers.
  for (const bool takes_records : {true, false}) {
    const auto is_whole = [takes_records](const NamedArray& each) {
      return takes_records ? HasEventFields(each.array.header()) : HasRows(each.array.header());
    };
    const auto found = std::find_if(arrays.begin(), arrays.end(), is_whole);
    if (found == arrays.end()) continue;
    std::vector<ArrayColumn> columns = FieldColumns(found->array.header());
    if (!takes_records) {
      const NpyField number = columns.front().field;
      columns.clear();
      for (size_t i = 0; i < 4; ++i) {
        columns.push_back({0, number});
        columns.back().field.offset = i * number.size;
      }
    }
    std::vector<NamedArray> whole;
    whole.push_back(std::move(*found));
    auto source = std::make_unique<ArraySource>(std::move(whole), std::move(columns));
    EVPOSE_RETURN_IF_ERROR(source->Start(name, takes_records));
    return source;
  }
  // An array of each quantity, by their names.
  std::vector<NamedArray> lists;
  std::vector<ArrayColumn> columns;
  for (NamedArray& each : arrays) {
    const NpyHeader& header = each.array.header();
    if (!IsList(header) || header.fields.size() != 1 || header.fields[0].kind == '?') continue;
    ArrayColumn column = {lists.size(), header.fields[0]};
    column.field.name = each.name;
    columns.push_back(std::move(column));
    lists.push_back(std::move(each));
  }
  if (!LayoutOfNames(NamesOf(columns), {})) {
    return absl::InvalidArgumentError(absl::StrCat(
        name,
        ": has no array with the fields t, x, y and p, no array of rows of four numbers, and not the four arrays "
        "t, x, y and p"));
  }
  std::erase_if(columns, [](const ArrayColumn& column) { return !IsEventColumn(column.field.name); });
  std::vector<NamedArray> used;
  for (ArrayColumn& column : columns) {
    used.push_back(std::move(lists[column.array]));
    column.array = used.size() - 1;
  }
  auto source = std::make_unique<ArraySource>(std::move(used), std::move(columns));
  EVPOSE_RETURN_IF_ERROR(source->Start(name, true));
  return source;
}

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenArrays(const ContainerFile& file, const ArrayOpener& open) {
  const auto open_source = [&]() -> absl::StatusOr<std::unique_ptr<EventSource>> {
    EVPOSE_ASSIGN_OR_RETURN(std::vector<NamedArray> arrays, open());
    return MakeArraySource(file.name, std::move(arrays));
  };
  return MakeSourceReader(file.name, open_source, file.geometry, /*can_reopen=*/true);
}

bool MatchesNpy(std::string_view prefix) { return prefix.starts_with(kNpyMagic); }
bool MatchesNpz(std::string_view prefix) { return prefix.starts_with(kZipMagic); }

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenNpy(ContainerFile file) {
  const RecordingReaderOptions options = file.bytes->options();
  return OpenArrays(file, [&]() -> absl::StatusOr<std::vector<NamedArray>> {
    EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<ByteSource> bytes, ByteSource::Open(file.path, options));
    EVPOSE_ASSIGN_OR_RETURN(
        NpyArray array, NpyArray::Open(file.name, [bytes](absl::Span<uint8_t> buffer) { return bytes->Read(buffer); }));
    std::vector<NamedArray> arrays;
    arrays.push_back({"events", std::move(array)});
    return arrays;
  });
}

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenNpz(ContainerFile file) {
  return OpenArrays(file, [&]() -> absl::StatusOr<std::vector<NamedArray>> {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListZipEntries(file.path, ".npy"));
    std::vector<NamedArray> arrays;
    for (const std::string& name : names) {
      EVPOSE_ASSIGN_OR_RETURN(ReadBytes read, OpenZipEntry(file.path, name));
      EVPOSE_ASSIGN_OR_RETURN(NpyArray array, NpyArray::Open(absl::StrCat(file.name, ": ", name), std::move(read)));
      arrays.push_back({name.substr(0, name.size() - 4), std::move(array)});
    }
    return arrays;
  });
}

}  // namespace

const ContainerFormat kNpyFormat = {.name = "NumPy (.npy)", .matches = MatchesNpy, .open = OpenNpy};
const ContainerFormat kNpzFormat = {.name = "NumPy (.npz)", .matches = MatchesNpz, .open = OpenNpz};

}  // namespace evpose::client
