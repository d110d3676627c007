// SPDX-License-Identifier: Apache-2.0

// Mean and order statistics of samples.
//
// A quantile is one of the values except with InterpolatedQuantile(). The definitions differ by at most one position
// in the sorted sample, but the bits of a pose or a printed table depend on it, so that each user keeps its own:
//
//   SelectNth             index n                                            reorders, O(n) on average
//   UpperMedian           index size / 2: the larger middle value of an even number            the same
//   UpperMedianOr         the same, or a given value for an empty list       copies the list
//   UpperQuantile         index floor(q size): UpperMedian() for q = 1/2                       the same
//   NearestQuantile       index q (size - 1), rounded                        of sorted values, O(1)
//   InterpolatedQuantile  linear between the two values beside q (size - 1)                    the same
//
// No list may be empty, except for UpperMedianOr(), and q lies in [0, 1]. Values must be ordered by <; NaN is not.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace evpose {

inline double Mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

// The value at index `n` of the sorted list. `values` is reordered: smaller values before index n, larger ones after
// it.
template <typename T>
T SelectNth(std::vector<T>& values, size_t n) {
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(n);
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

// The estimators' median: one selection, not the mean of two, because the scales and rates that it gives need no more.
template <typename T>
T UpperMedian(std::vector<T>& values) {
  return SelectNth(values, values.size() / 2);
}

// The same, or `value_if_empty` for an empty list.
template <typename T>
T UpperMedianOr(std::vector<T> values, T value_if_empty) {
  return values.empty() ? value_if_empty : UpperMedian(values);
}

// The same for another fraction q of the values.
template <typename T>
T UpperQuantile(std::vector<T>& values, double q) {
  return SelectNth(values, std::min(values.size() - 1, static_cast<size_t>(q * static_cast<double>(values.size()))));
}

// Returns a value that was measured; for several percentiles of one sorted list.
inline double NearestQuantile(const std::vector<double>& sorted, double q) {
  return sorted[static_cast<size_t>(std::lround(q * static_cast<double>(sorted.size() - 1)))];
}

// Returns the quantile by the definition of NumPy's default, for published errors, with which others compare their
// numbers.
inline double InterpolatedQuantile(const std::vector<double>& sorted, double q) {
  const double position = q * static_cast<double>(sorted.size() - 1);
  const size_t below = static_cast<size_t>(position);
  const size_t above = below + 1 < sorted.size() ? below + 1 : below;
  return sorted[below] + (position - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

}  // namespace evpose
