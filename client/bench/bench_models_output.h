// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench models` as text and JSON.
#pragma once

#include <ostream>
#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "core/experiments/tracking/model_bench.h"

namespace evpose::client {

// Explains the columns of the table, for the help text.
extern const char kModelsTableHelp[];

void PrintModelsHeader(std::ostream& out);
void PrintModelsRow(const ModelBenchRow& row, std::ostream& out);
// The number of models that are kept in all runs, and the worst of each figure with its model.
void PrintModelsSummary(const std::vector<ModelBenchRow>& rows, std::ostream& out);
Json ModelsJson(const std::vector<ModelBenchRow>& rows, const ModelBenchOptions& options);

}  // namespace evpose::client
