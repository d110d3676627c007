// SPDX-License-Identifier: Apache-2.0

// The views of a model, computed once to be stored with it (README, section 7).
#pragma once

#include <memory>

#include "core/models/object_model.h"

namespace evpose {

// Returns the same views to the bit as TemplateModel and SearchModel compute for this model. Takes as long as their
// construction: up to about a second.
SearchViews MakeSearchViews(const std::shared_ptr<const ObjectModel>& model);

}  // namespace evpose
