// SPDX-License-Identifier: Apache-2.0

// The visible edges of a model at a pose: the parts of its straight lines, by ray casting, and the elements of its
// curves and contours. Both are computed again only when the view has changed (core/association/README.md, sections 3
// and 5).
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "core/association/association.h"
#include "core/association/other_objects.h"
#include "core/contours/edge_elements.h"
#include "core/contours/segment_image.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

// Finds the visible edges of a model; shared by all hypotheses of all trackers with the same options. Immutable after
// construction, thread-compatible. Keeps a reference: `model` must outlive it. `surface` are the tables of its surface;
// null: computed here.
class ModelEdges {
 public:
  ModelEdges(const ObjectModel& model, const VisibilityOptions& visibility, const EdgeElementOptions& elements,
             std::shared_ptr<const SurfaceTables> surface = nullptr);
  ModelEdges(const ModelEdges&) = delete;
  ModelEdges& operator=(const ModelEdges&) = delete;

  const ObjectModel& model() const { return model_; }
  const std::shared_ptr<const SurfaceTables>& surface() const { return surface_; }
  const VisibilityTester& visibility() const { return visibility_; }
  const EdgeElementExtractor& elements() const { return elements_; }

  // Largest number of straight lines that are tested at every pose, which bounds the time of a window. Of a model with
  // more lines, the best visible ones are chosen for each view. All lines of simple models are tested.
  static constexpr size_t kMaxLines = 128;
  // The straight lines that take part, indices in increasing order: all, or the kMaxPool longest ones. The limit bounds
  // the time of the choice, which considers each of them.
  static constexpr size_t kMaxPool = 4096;
  const std::vector<int>& lines() const { return lines_; }
  bool has_many_lines() const { return model_.lines.size() > kMaxLines; }

  // Upper bound of TrackedLine::curve. A hypothesis stores statistics for each number.
  int num_curves() const { return num_curves_; }
  // Returns TrackedLine::curve of an EdgeElement::curve. The curves of a model with more than kMaxCurves share numbers,
  // which bounds the memory of a hypothesis; of two with the same number seldom both are visible.
  static constexpr int kMaxCurves = 1024;
  int CurveOf(uint32_t curve) const { return static_cast<int>(curve % static_cast<uint32_t>(kMaxCurves)); }

  // Upper bounds of the image widths of the faces beside a curve, TrackedLine::narrowest_face_px. `to_eye` is the
  // vector from the element to the camera centre, object frame. Infinite for contours and beside curved faces.
  double NarrowestFacePx(uint32_t curve, const Eigen::Vector3d& to_eye, double focal_px) const;
  // A plane with flat faces of a model that has curved edges or surfaces.
  struct FacePlane {
    Eigen::Vector3d normal;  // outward, unit
    Eigen::Vector3d point;   // the middle of its widest face
    double width_m = 0.0;    // width of this face
  };
  // The widest face first, at most kMaxFacePlanes.
  const std::vector<FacePlane>& face_planes() const { return face_planes_; }
  // Bounds the time of FacingPlanes(), which tests every plane at every pose. When a narrower face turns, the elements
  // of its wrong side stay until the next extraction (README, section 5).
  static constexpr size_t kMaxFacePlanes = 256;
  // Whether the faces of the plane are so narrow in the image that the elements of their near and far sides differ by
  // less than half a pixel until the next extraction.
  static bool IsNarrow(const FacePlane& plane, double distance_m, double focal_px);
  // Sets for each of face_planes() whether the outer side faces the camera centre `eye` (object frame); false for a
  // narrow one.
  void FacingPlanes(const Eigen::Vector3d& eye, double focal_px, std::vector<bool>& facing) const;
  // The bounding sphere of the object, object frame.
  const BoundingSphere& sphere() const { return sphere_; }
  const Eigen::Vector3d& centre() const { return sphere_.centre; }

 private:
  // The normals of the flat faces beside a curve, zero for others, and the diameter of the curve.
  struct FlatFaces {
    std::array<Eigen::Vector3d, 2> normals;
    double diameter_m = 0.0;
  };
  static FlatFaces FlatFacesOf(const EdgeCurve& curve);
  std::vector<FacePlane> FindFacePlanes() const;

  const ObjectModel& model_;
  const std::shared_ptr<const SurfaceTables> surface_;
  const VisibilityTester visibility_;
  const EdgeElementExtractor elements_;
  std::vector<int> lines_;
  int num_curves_ = 0;
  std::vector<FlatFaces> flat_faces_;  // the flat faces at each of ObjectModel::curves
  std::vector<FacePlane> face_planes_;
  BoundingSphere sphere_;
};

// Keeps the model; for caches of shared objects.
std::shared_ptr<const ModelEdges> MakeModelEdges(std::shared_ptr<const ObjectModel> model,
                                                 const VisibilityOptions& visibility,
                                                 const EdgeElementOptions& elements);

// The visible edges of one hypothesis.
class VisibleEdges {
 public:
  // `edges` must outlive the object.
  VisibleEdges(const CameraModel& camera, const ModelEdges& edges);

  // Returns the visible parts of the straight lines, then the elements by TrackedLine::curve, object frame, metres.
  // Valid until the next call.
  absl::Span<const TrackedLine> At(const RigidTransform& camera_from_object);

  // Whether the view at the last pose has more edges than the limits of lines and elements allow: those left out have
  // no events of their own.
  bool has_more() const { return has_more_lines_ || has_more_elements_; }

  // The state is the poses at which lines and elements were last computed, and the level of detail.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  // Sets TrackedLine::narrowest_face_px for the camera centre `eye` (object frame). The bound assumes faces as wide as
  // the object's diameter.
  void MeasureFaces(const Eigen::Vector3d& eye);
  // Computes the visible parts of the straight lines at the pose.
  void ComputeAt(const RigidTransform& camera_from_object);
  // The prior contrast of a straight line: as for curves (core/contours/README.md, section 4), but 1 for sharp creases.
  float ContrastOf(const ModelLine& line, const SeenEdge& edge) const;
  // Sets the prior contrasts of the straight lines. A line beside a longer one gets that of a step, because the longer
  // one has its events, too.
  void SetPriorContrasts(const RigidTransform& camera_from_object);
  bool ViewChanged(const RigidTransform& camera_from_object) const;
  // Returns false if a part of the object may lie outside the image.
  bool IsWholeInImage(const RigidTransform& camera_from_object) const;
  // Extracts the elements at the pose, and chooses the straight lines of a model that has many.
  void ExtractAt(const RigidTransform& camera_from_object, int level);
  // Whether the elements must be extracted again at this pose and level: the view has changed, or a flat face has
  // turned (README, section 5).
  bool ElementsChanged(const RigidTransform& camera_from_object, int level);
  void ChooseLines(const RigidTransform& camera_from_object);
  // Sets TrackedLine::previous and next of the elements.
  void FindNeighbours(const RigidTransform& camera_from_object);
  // Replaces the elements in lines_ by those for the camera centre `eye`: contours slide along the surface.
  void PlaceElements(const Eigen::Vector3d& eye);
  // Sets for each face of each chosen line whether it faces the camera. This decides about the visibility of lines and
  // must be exact to a tenth of a degree. A line of a face that has turned away pulls the pose back to where the face
  // was visible, and the events of a missing line are attributed to its neighbour (core/association/README.md, section
  // 3).
  void FacingFaces(const Eigen::Vector3d& eye, std::vector<bool>& facing) const;

  const CameraModel camera_;
  const ModelEdges& edges_;
  std::optional<RigidTransform> computed_at_;
  bool was_whole_ = false;                      // IsWholeInImage() at computed_at_
  std::optional<RigidTransform> extracted_at_;  // only for models with elements or many lines
  int level_ = -1;                              // level of detail; negative before the first extraction
  std::vector<int> chosen_;                     // straight lines that are tested
  std::vector<bool> facing_;
  std::vector<bool> facing_now_;
  std::vector<bool> facing_planes_;  // at the last extraction
  std::vector<bool> facing_planes_now_;
  std::vector<VisibleSegment> segments_;
  std::vector<SegmentImage> images_;  // of segments_
  bool has_more_lines_ = false;
  bool has_more_elements_ = false;
  std::vector<EdgeElement> elements_;  // as extracted and joined to arcs, by TrackedLine::curve
  std::vector<TrackedLine> joined_;    // lines of elements_; previous and next are indices into joined_
  std::vector<TrackedLine> lines_;     // the visible parts of segments_, then the elements
};

}  // namespace evpose
