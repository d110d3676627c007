// SPDX-License-Identifier: Apache-2.0

// evpose models inspect: repairs, edges, symmetry and observability of a model file.
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "client/cli/commands/commands.h"
#include "client/cli/commands/inspect_findability.h"
#include "client/cli/commands/inspect_symmetry.h"
#include "client/cli/commands/model_picture.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/console/wait_message.h"
#include "client/model_intake/model_intake.h"
#include "core/association/visible_edges.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/evaluation/model_views.h"
#include "core/evaluation/near_symmetries.h"
#include "core/models/object_model.h"
#include "core/numerics/statistics.h"
#include "core/simulation/simulator.h"

namespace evpose::client {
namespace {

struct InspectArguments {
  std::string file;
  std::string camera;
  std::string picture;
  ModelReadingArguments reading;
  bool is_json = false;
};

// Largest standard deviation of a motion that counts as determined, in pixels at the outline after 1000 events:
// HealthOptions::max_uncertainty_px, above which a pose is wider than the gate.
constexpr double kUnobservablePx = 12.0;
// The motions of ModelView::deviation_px, axes of the camera.
constexpr std::array<const char*, 6> kMotionNames = {"translation_x", "translation_y", "translation_z",
                                                     "rotation_x",    "rotation_y",    "rotation_z"};
constexpr std::array<const char*, 6> kMotionTexts = {
    "x", "y", "z (depth)", "rotation about x", "rotation about y", "rotation about z"};

struct Inspection {
  ObjectModel model;
  Eigen::Vector3d size_m;
  CameraModel camera;
  std::vector<ModelView> views;
  std::vector<ViewFindability> findability;
  std::vector<NearSymmetry> near_symmetries;
  absl::Duration preparation;
  absl::Duration time_per_view;
};

// Share of contours in the visible length, over all views.
double ContourShare(const std::vector<ModelView>& views) {
  double length_px = 0.0, contour_px = 0.0;
  for (const ModelView& view : views) {
    length_px += view.length_px;
    contour_px += view.contour_px;
  }
  return length_px > 0.0 ? contour_px / length_px : 0.0;
}

absl::StatusOr<Inspection> Inspect(const InspectArguments& arguments) {
  Inspection inspection;
  CameraModel& camera = inspection.camera;
  camera = SimulationOptions::SimulatedEvk4Camera();
  if (!arguments.camera.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(camera, LoadCameraModel(arguments.camera));
  }
  const absl::Time start = absl::Now();
  EVPOSE_ASSIGN_OR_RETURN(inspection.model, arguments.reading.LoadSilently(arguments.file));
  const absl::Time prepared = absl::Now();
  inspection.preparation = prepared - start;
  EVPOSE_ASSIGN_OR_RETURN(inspection.views, ViewModel(inspection.model, camera));
  inspection.time_per_view = (absl::Now() - prepared) / inspection.views.size();
  EVPOSE_ASSIGN_OR_RETURN(inspection.findability, PredictFindability(inspection.model, camera));
  EVPOSE_ASSIGN_OR_RETURN(inspection.near_symmetries,
                          FindNearSymmetries(inspection.model, ContourShare(inspection.views)));
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& vertex : inspection.model.vertices) box.extend(vertex);
  for (const ModelLine& line : inspection.model.lines) box.extend(line.p1).extend(line.p2);
  inspection.size_m = box.sizes();
  return inspection;
}

// The numbers of lines and curves of one kind.
struct EdgeCounts {
  const char* name;
  size_t lines = 0;
  size_t curves = 0;
};

std::array<EdgeCounts, 3> CountEdges(const ObjectModel& model) {
  std::array<EdgeCounts, 3> counts = {{{"crease"}, {"boundary"}, {"painted"}}};
  for (const ModelLine& line : model.lines) ++counts[static_cast<size_t>(line.kind)].lines;
  for (const EdgeCurve& curve : model.curves) ++counts[static_cast<size_t>(curve.kind)].curves;
  return counts;
}

std::array<std::pair<const char*, size_t>, 5> CountRegions(const ObjectModel& model) {
  std::array<std::pair<const char*, size_t>, 5> counts = {
      {{"plane", 0}, {"cylinder", 0}, {"cone", 0}, {"sphere", 0}, {"free", 0}}};
  for (const SurfaceRegion& region : model.surface.regions) ++counts[static_cast<size_t>(region.shape)].second;
  return counts;
}

// Pixels at the outline.
struct Deviation {
  double median_px = 0.0;
  double worst_px = 0.0;
};

// Statistics of the views.
struct ViewSummary {
  double mean_elements = 0.0;
  size_t max_elements = 0;
  double contour_share = 0.0;          // share of contours in the visible length
  Deviation weakest;                   // standard deviation of the least certain motion
  std::array<Deviation, 6> by_motion;  // ModelView::deviation_px
  size_t num_unobservable = 0;
  std::vector<Eigen::Vector3d> limited;  // directions, from the object, of views that have more edges than are used
};

// `get` returns the value of a view.
template <typename Get>
Deviation DeviationOver(const std::vector<ModelView>& views, const Get& get) {
  std::vector<double> values;
  for (const ModelView& view : views) values.push_back(get(view));
  const double largest = *std::max_element(values.begin(), values.end());
  return {UpperMedian(values), largest};
}

ViewSummary Summarise(const std::vector<ModelView>& views) {
  ViewSummary summary;
  summary.contour_share = ContourShare(views);
  for (const ModelView& view : views) {
    summary.mean_elements += static_cast<double>(view.elements.size()) / static_cast<double>(views.size());
    summary.max_elements = std::max(summary.max_elements, view.elements.size());
    summary.num_unobservable += view.weakest_px > kUnobservablePx ? 1 : 0;
    if (view.has_more) summary.limited.push_back(-view.camera_from_object.rotation.row(2).transpose());
  }
  summary.weakest = DeviationOver(views, [](const ModelView& view) { return view.weakest_px; });
  for (int motion = 0; motion < 6; ++motion) {
    summary.by_motion[motion] =
        DeviationOver(views, [motion](const ModelView& view) { return view.deviation_px(motion); });
  }
  return summary;
}

std::vector<std::string> Warnings(const Inspection& inspection, const ViewSummary& summary) {
  std::vector<std::string> warnings;
  const size_t num_views = inspection.views.size();
  if (summary.max_elements == 0) {
    warnings.push_back(absl::StrCat("no view has an edge that can be tracked; the object is ",
                                    FormatLength(inspection.model.diameter_m),
                                    " across: if the file has another unit, give --scale, the metres per unit"));
  } else if (summary.num_unobservable > 0) {
    warnings.push_back(
        absl::StrFormat("in %d of %d views the visible edges do not determine the pose (standard deviation above %g px "
                        "at the outline); "
                        "there, the pose follows from the predicted motion and becomes inaccurate within a short time",
                        summary.num_unobservable, num_views, kUnobservablePx));
  }
  if (!summary.limited.empty()) {
    const Eigen::Vector3d& first = summary.limited.front();
    warnings.push_back(absl::StrFormat(
        "in %d of %d views, as from (%.2f, %.2f, %.2f), more edges are visible than the %d straight lines and %d "
        "elements that are used: the strongest are chosen, and parts of the object have none; --crease-angle leaves "
        "blunt edges out",
        summary.limited.size(), num_views, first.x(), first.y(), first.z(), ModelEdges::kMaxLines,
        EdgeElementOptions().max_elements));
  }
  AddNearSymmetryWarning(inspection.near_symmetries, warnings);
  return warnings;
}

Json InspectionJson(const Inspection& inspection) {
  const ObjectModel& model = inspection.model;
  const ViewSummary summary = Summarise(inspection.views);
  Json edges, regions;
  for (const EdgeCounts& counts : CountEdges(model)) {
    edges[counts.name] = {{"lines", counts.lines}, {"curves", counts.curves}};
  }
  for (const auto& [name, count] : CountRegions(model)) regions[name] = count;
  // JSON has no infinity.
  const auto finite = [](double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); };
  const auto deviation = [&](const Deviation& of) {
    return Json{{"median_px", finite(of.median_px)}, {"worst_px", finite(of.worst_px)}};
  };
  Json limited = Json::array();
  for (const Eigen::Vector3d& direction : summary.limited) {
    limited.push_back({direction.x(), direction.y(), direction.z()});
  }
  Json deviations;
  for (int motion = 0; motion < 6; ++motion) deviations[kMotionNames[motion]] = deviation(summary.by_motion[motion]);
  return {{"size_m", {inspection.size_m.x(), inspection.size_m.y(), inspection.size_m.z()}},
          {"diameter_m", model.diameter_m},
          {"vertices", model.vertices.size()},
          {"triangles", model.triangles.size()},
          {"regions", regions},
          {"edges", edges},
          {"facet_edges", model.facet_edges.size()},
          {"symmetry", SymmetryJson(model)},
          {"near_symmetries", NearSymmetriesJson(inspection.near_symmetries)},
          {"views",
           {{"count", inspection.views.size()},
            {"elements_mean", summary.mean_elements},
            {"elements_max", summary.max_elements},
            {"contour_share", summary.contour_share},
            {"deviation", deviations},
            {"weakest", deviation(summary.weakest)},
            {"unobservable", summary.num_unobservable},
            {"limited", limited}}},
          {"findability", FindabilityJson(inspection.findability, model, inspection.camera)},
          {"preparation_s", absl::ToDoubleSeconds(inspection.preparation)},
          {"extraction_ms", absl::ToDoubleMilliseconds(inspection.time_per_view)},
          {"notices", model.notices},
          {"warnings", Warnings(inspection, summary)}};
}

void PrintObservability(const ViewSummary& summary, std::ostream& out) {
  out << absl::StrFormat(
      "observable   standard deviation at the outline after %.0f events, px, median of the views / worst: least "
      "certain motion %.2f / %.2f\n",
      ModelViewOptions().events, summary.weakest.median_px, summary.weakest.worst_px);
  for (int motion = 0; motion < 6; ++motion) {
    const Deviation& deviation = summary.by_motion[motion];
    out << absl::StrFormat("             %-16s %.2f / %.2f\n", kMotionTexts[motion], deviation.median_px,
                           deviation.worst_px);
  }
}

// What the views show; without an edge in any of them, only that.
void PrintViews(const Inspection& inspection, const ViewSummary& summary, std::ostream& out) {
  const ModelViewOptions options;
  out << absl::StrFormat(
      "elements     %.0f on average, %d at most, of %d views with a size of %.0f px; %.0f %% of their length "
      "are contours\n",
      summary.mean_elements, summary.max_elements, inspection.views.size(), options.object_px,
      100.0 * summary.contour_share);
  if (summary.max_elements > 0) {
    PrintObservability(summary, out);
    PrintFindability(inspection.findability, inspection.model, inspection.camera, out);
  }
  out << absl::StrFormat(
      "cost         %.2f ms to find the elements of a view on this machine; the cost of a window is "
      "proportional to their number\n",
      absl::ToDoubleMilliseconds(inspection.time_per_view));
}

void PrintInspection(const std::string& path, const Inspection& inspection, std::ostream& out) {
  const ObjectModel& model = inspection.model;
  const Eigen::Vector3d& size_m = inspection.size_m;
  const LengthUnit unit = UnitOfLength(model.diameter_m);
  out << absl::StrFormat("%s: %.4g x %.4g x %.4g %s, diameter %s\n", path, size_m.x() / unit.metres,
                         size_m.y() / unit.metres, size_m.z() / unit.metres, unit.name, FormatLength(model.diameter_m));
  out << absl::StrFormat("mesh         %s, %s, prepared in %.2f s\n", Counted(model.triangles.size(), "triangle"),
                         Counted(model.vertices.size(), "vertex", "vertices"),
                         absl::ToDoubleSeconds(inspection.preparation));
  const auto add_region = [](std::string* text, const std::pair<const char*, size_t>& region) {
    absl::StrAppendFormat(text, "%d %s", region.second, region.first);
  };
  if (!model.surface.empty()) {
    out << absl::StrFormat("regions      %d: %s\n", model.surface.regions.size(),
                           absl::StrJoin(CountRegions(model), ", ", add_region));
  }
  for (const EdgeCounts& counts : CountEdges(model)) {
    if (counts.lines + counts.curves == 0) continue;
    out << absl::StrFormat("%-12s %s, %s\n", counts.name, Counted(counts.lines, "straight line"),
                           Counted(counts.curves, "curve"));
  }
  if (!model.facet_edges.empty()) {
    out << absl::StrFormat("facets       %s, which is a contour where one of its facets faces the camera\n",
                           Counted(model.facet_edges.size(), "edge between facets", "edges between facets"));
  }
  PrintSymmetries(model, inspection.near_symmetries, out);
  const ViewSummary summary = Summarise(inspection.views);
  PrintViews(inspection, summary, out);
  for (const std::string& notice : model.notices) out << "notice: " << notice << "\n";
  for (const std::string& warning : Warnings(inspection, summary)) out << "warning: " << warning << "\n";
}

absl::Status RunInspect(const InspectArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> picture, OpenOutput(arguments.picture));
  std::optional<WaitMessage> message = WaitMessage::ForWork(context, "inspecting " + arguments.file);
  EVPOSE_ASSIGN_OR_RETURN(const Inspection inspection, Inspect(arguments));
  if (picture) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string png, DrawModel(inspection.model, arguments.file));
    EVPOSE_RETURN_IF_ERROR(FinishOutput(picture, png));
  }
  message.reset();
  return PrintResult(context, arguments.is_json, InspectionJson(inspection),
                     [&](std::ostream& out) { PrintInspection(arguments.file, inspection, out); });
}

}  // namespace

CommandRunner AddInspectCommand(CLI::App& models, CliContext& context) {
  CLI::App* const app = models.add_subcommand(
      "inspect",
      "Print size, repairs, edges, symmetry and observability of a model file, and from where its "
      "object can be found; needs no server");
  auto arguments = std::make_shared<InspectArguments>();
  app->option_defaults()->group(kInputGroup);
  AddFile(*app, "file", arguments->file, absl::StrCat("Model file: ", kModelFormats))->required();
  arguments->reading.AddTo(*app);
  AddFile(*app, "--camera", arguments->camera,
          absl::StrCat(kCameraFiles, ". Default: that of evpose simulate, an EVK4"));
  app->option_defaults()->group(kOutputGroup);
  AddPicture(*app, "--picture", arguments->picture, "Picture (.png) of six views with the edges that the tracker uses");
  AddJson(*app, arguments->is_json);
  app->footer(
      "findable is a prediction from the edges that a view shows. The image must be at least 40 px wide and have three "
      "edges of 20 px, and one event for each pixel of edge and of motion must determine the pose to 10 deg. From "
      "other views the search is expected to find no pose. confusable are half turns about the principal axes, and "
      "how many of the edges that a view shows then differ. --json has both for each view. near are rotations after "
      "which less than 20 % of the edges and outlines are farther than 1 % of the diameter from "
      "where they were, hidden ones included.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose models inspect cube/model.obj --picture cube.png");
  return [arguments, &context] { return RunInspect(*arguments, context); };
}

}  // namespace evpose::client
