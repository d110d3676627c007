// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/search_views.h"

#include "core/contours/surface_tables.h"
#include "core/initialization/check_lines.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_model.h"

namespace evpose {

SearchViews MakeSearchViews(const std::shared_ptr<const ObjectModel>& model) {
  const auto surface = std::make_shared<const SurfaceTables>(*model);
  SearchViews views;
  if (HasCurvedEdges(*model)) views.templates = TemplateModel(model, surface).samples();
  if (IsSearchable(*model)) views.lines = SearchModel(*model, surface->faces).views();
  return views;
}

}  // namespace evpose
