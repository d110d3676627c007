// SPDX-License-Identifier: Apache-2.0

// Early return on errors: functions of this project return absl::Status or absl::StatusOr and throw no exceptions.
//
//   EVPOSE_RETURN_IF_ERROR(file.Append(bytes));
//   EVPOSE_ASSIGN_OR_RETURN(const CameraModel camera, LoadCameraModel(path));
#pragma once

#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

#define EVPOSE_CONCAT_INNER(a, b) a##b
#define EVPOSE_CONCAT(a, b) EVPOSE_CONCAT_INNER(a, b)

#define EVPOSE_RETURN_IF_ERROR(expression)                                                    \
  do {                                                                                        \
    if (absl::Status evpose_status = (expression); !evpose_status.ok()) return evpose_status; \
  } while (false)

#define EVPOSE_ASSIGN_OR_RETURN(declaration, expression) \
  EVPOSE_ASSIGN_OR_RETURN_IMPL(EVPOSE_CONCAT(evpose_statusor_, __LINE__), declaration, expression)

#define EVPOSE_ASSIGN_OR_RETURN_IMPL(result, declaration, expression) \
  auto result = (expression);                                         \
  if (!result.ok()) return std::move(result).status();                \
  declaration = *std::move(result)
