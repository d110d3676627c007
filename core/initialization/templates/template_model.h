// SPDX-License-Identifier: Apache-2.0

// How an object looks from all sides: points of its visible edges for each view of a sphere
// (core/initialization/templates/README.md, section 1).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/association/visible_edges.h"
#include "core/initialization/templates/edge_samples.h"
#include "core/initialization/templates/view_sphere.h"
#include "core/models/object_model.h"

namespace evpose {

// Turns about the line of sight in steps of 7.5 degrees. Directions of edges, which are modulo a half turn, have steps
// of half of that.
inline constexpr int kTemplateTurns = 48;

struct TemplatePoint {
  // Position relative to the centre of the object, in its radii: the offset (x, y) at the depth z is
  // D (x, y) / z, where D is the distance of the view in radii.
  Eigen::Vector2f at = Eigen::Vector2f::Zero();
  // Direction of the edge in steps of pi / kTemplateTurns from the u axis to the v axis, below kTemplateTurns.
  uint8_t direction = 0;
};

// A turn about the line of sight.
struct TemplateTurn {
  float sin = 0.0f;
  float cos = 1.0f;

  // `turn` in steps of 2 pi / kTemplateTurns, below kTemplateTurns.
  static const TemplateTurn& At(int turn);
  Eigen::Vector2f operator*(const Eigen::Vector2f& at) const {
    return {cos * at.x() - sin * at.y(), sin * at.x() + cos * at.y()};
  }
};

// The box about the points of a template at a turn.
struct TemplateExtent {
  Eigen::Vector2f low = Eigen::Vector2f::Zero();
  Eigen::Vector2f high = Eigen::Vector2f::Zero();
};

struct ViewTemplate {
  Eigen::Matrix3d rotation;  // camera_from_object; the camera looks at the centre of the object
  std::vector<TemplatePoint> points;
  absl::Span<const EdgeSample> samples;  // the same points on the object
  std::vector<TemplateExtent> extents;   // by turn, below TemplateModel::num_turns()
  // The coarse view that this one is near to, an index into views(), and the turn in steps of 2 pi / kTemplateTurns
  // about the line of sight after which both look alike.
  int parent = 0;
  int parent_turn = 0;
};

// Immutable after construction.
class TemplateModel {
 public:
  // Keeps the model. Looks at it from up to 642 sides; from 162 if it has so many triangles that it would take longer
  // than about a second. If ObjectModel::views has the samples of these views, they are not computed.
  // `surface` are the tables of the model's surface; null: computed here.
  explicit TemplateModel(std::shared_ptr<const ObjectModel> model,
                         std::shared_ptr<const SurfaceTables> surface = nullptr);
  TemplateModel(const TemplateModel&) = delete;
  TemplateModel& operator=(const TemplateModel&) = delete;

  const ObjectModel& model() const { return *model_; }
  const ModelEdges& edges() const { return edges_; }
  const Eigen::Vector3d& centre() const { return edges_.centre(); }
  double radius_m() const { return radius_m_; }
  // Views without visible edges are left out. The coarse ones are first.
  const std::vector<ViewTemplate>& views() const { return views_; }
  int num_coarse() const { return num_coarse_; }
  // The samples of the view from each direction of MakeViewSphere(), also of those without visible edges: what is
  // stored with a model (ObjectModel::views).
  const SearchViews::Templates& samples() const { return *samples_; }
  // kTemplateTurns, or 1 if all turns look alike.
  int num_turns() const { return num_turns_; }

  // The axis about which rotations change the surface least, if they change it little: the object is nearly round, as a
  // shaft with a keyway. Not set for an axis of a continuous symmetry.
  const std::optional<ContinuousSymmetry>& near_axis() const { return near_axis_; }
  // Number of turns about it, in steps of 2 pi / kTemplateTurns, after which the symmetries of the object repeat the
  // first ones.
  int num_spins() const { return num_spins_; }
  // The view nearest to a pose, an index into views(); `camera_from_object` is replaced by the equivalent pose from
  // which the object looks like this view up to a turn.
  int NearestView(RigidTransform& camera_from_object) const;

  // Points of a template. The time of a scan, and the size of the stored views, are proportional to their number; with
  // fewer, small features have no point.
  static constexpr int kPoints = 120;
  // Distance of the camera from the centre, in radii: an object that fills a third to a half of a usual image.
  static constexpr double kDistanceOfRadius = 6.0;

 private:
  SearchViews::Templates SampleViews(const ViewSphere& sphere) const;
  // Whether samples that are stored with the model can be those of its views.
  bool AreOfThisModel(const SearchViews::Templates& samples, const ViewSphere& sphere) const;
  // The pose at which the object is looked at from a direction.
  RigidTransform PoseOfView(const Eigen::Vector3d& direction) const;
  void AddView(const Eigen::Vector3d& direction, absl::Span<const EdgeSample> samples, bool is_coarse);
  void FindParent(ViewTemplate& view) const;
  void FindNearAxis();

  const std::shared_ptr<const ObjectModel> model_;
  const ModelEdges edges_;
  double radius_m_ = 0.0;
  std::shared_ptr<const SearchViews::Templates> samples_;
  std::vector<ViewTemplate> views_;
  int num_coarse_ = 0;
  int num_turns_ = kTemplateTurns;
  std::optional<ContinuousSymmetry> near_axis_;
  int num_spins_ = 0;
};

// The form that caches of shared objects need; always OK.
absl::StatusOr<std::shared_ptr<const TemplateModel>> MakeTemplateModel(std::shared_ptr<const ObjectModel> model,
                                                                       std::shared_ptr<const SurfaceTables> surface);

// Edges at the level of detail of a search: coarse, because a search looks at many poses.
VisibilityOptions TemplateVisibilityOptions();
EdgeElementOptions TemplateElementOptions();

}  // namespace evpose
