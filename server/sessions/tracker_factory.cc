// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/tracker_factory.h"

#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/association/camera_tables.h"
#include "core/association/visible_edges.h"
#include "core/baselines/estimators/estimator_factory.h"
#include "core/contours/surface_tables.h"
#include "core/initialization/check_lines.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_model.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "server/runtime/errors.h"
#include "server/runtime/weak_cache.h"

namespace evpose::server {
namespace {

struct Shared {
  WeakCache<CameraModel, CameraTables> camera_tables;
  // The cached values own their models, so that no address is reused.
  WeakCache<const ObjectModel*, ModelEdges> edges;
  WeakCache<const ObjectModel*, SearchModel> search_models;
  WeakCache<const ObjectModel*, TemplateModel> template_models;
};

absl::StatusOr<std::unique_ptr<Tracker>> MakeTracker(const SessionConfig& config,
                                                     const std::vector<std::shared_ptr<const ObjectModel>>& models,
                                                     Shared& shared) {
  TrackerOptions options;
  options.estimator_factory = EstimatorFactoryOf(config.estimator);
  options.sensor = config.sensor;
  options.windows = WindowOptions::WithPoseRate(config.pose_rate_hz);
  std::vector<ObjectToTrack> objects;
  for (size_t i = 0; i < models.size(); ++i) {
    const ObjectConfig& object = config.objects[i];
    objects.push_back({models[i], object.initial_camera_from_object, object.reference_rotation});
    const absl::Status status = objects.back().Validate();
    if (!status.ok()) {
      const std::string field = absl::StrCat("config.objects[", i, "]");
      const absl::Status pose = objects.back().ValidateInitialPose();
      if (!pose.ok()) return InvalidField(field + ".initial_camera_from_object", pose.message());
      return InvalidField(field, status.message());
    }
    // All sessions use the same options for edges.
    auto edges = shared.edges.Get(models[i].get(), [&]() -> absl::StatusOr<std::shared_ptr<const ModelEdges>> {
      return MakeModelEdges(models[i], options.visibility, options.elements);
    });
    if (!edges.ok()) return edges.status();
    objects.back().edges = *std::move(edges);
    const SurfaceTables& surface = *objects.back().edges->surface();
    if (HasCurvedEdges(*models[i])) {
      auto views = shared.template_models.Get(
          models[i].get(), [&] { return MakeTemplateModel(models[i], objects.back().edges->surface()); });
      if (!views.ok()) return views.status();
      objects.back().template_model = *std::move(views);
      if (!IsSearchable(*models[i])) continue;  // its lines determine no pose
    }
    auto search_model =
        shared.search_models.Get(models[i].get(), [&] { return MakeSearchModel(models[i], surface.faces); });
    if (!search_model.ok())
      return InvalidField(absl::StrCat("config.objects[", i, "].model"), search_model.status().message());
    objects.back().search_model = *std::move(search_model);
  }
  auto tables = shared.camera_tables.Get(config.camera, [&] { return MakeCameraTables(config.camera); });
  if (!tables.ok()) return InvalidField("config", tables.status().message());
  auto tracker = Tracker::Create(std::move(objects), config.camera, options, *std::move(tables));
  if (!tracker.ok()) return InvalidField("config", tracker.status().message());
  return tracker;
}

}  // namespace

TrackerFactory MakeTrackerFactory() {
  return [shared = std::make_shared<Shared>()](const SessionConfig& config,
                                               const std::vector<std::shared_ptr<const ObjectModel>>& models) {
    return MakeTracker(config, models, *shared);
  };
}

}  // namespace evpose::server
