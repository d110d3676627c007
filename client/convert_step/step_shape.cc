// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/step_shape.h"

#include <BRepBuilderAPI_Sewing.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <IGESControl_Reader.hxx>
#include <Interface_Check.hxx>
#include <Interface_CheckIterator.hxx>
#include <STEPControl_Reader.hxx>
#include <Standard_Failure.hxx>
#include <TColStd_SequenceOfAsciiString.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_ListOfShape.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Compound.hxx>
#include <TopoDS_Face.hxx>
#include <XSControl_TransferReader.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <filesystem>
#include <memory>

#include "absl/status/status.h"
#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// The number of elements with an error, and the text of the first one.
struct Failures {
  int count = 0;
  std::string first;
};

Failures FailuresOf(Interface_CheckIterator checks) {
  Failures failures;
  for (checks.Start(); checks.More(); checks.Next()) {
    const opencascade::handle<Interface_Check> check = checks.Value();
    if (check->NbFails() == 0) continue;
    if (failures.count++ == 0) failures.first = std::string(absl::StripAsciiWhitespace(check->CFail(1)));
  }
  return failures;
}

// `what` happened to the elements.
void NoteFailures(const Failures& failures, const char* what, std::vector<std::string>& notices) {
  if (failures.count == 0) return;
  notices.push_back(
      absl::StrCat(Counted(static_cast<uint64_t>(failures.count), "element"), " of the file ", what,
                   ", and faces may be missing: check the object with \"evpose models inspect --picture\", "
                   "and export it again; the first error is \"",
                   failures.first, "\""));
}

// Shapes of a kind outside faces.
int CountOutsideFaces(const TopoDS_Shape& shape) {
  int count = 0;
  for (TopExp_Explorer edges(shape, TopAbs_EDGE, TopAbs_FACE); edges.More(); edges.Next()) ++count;
  for (TopExp_Explorer points(shape, TopAbs_VERTEX, TopAbs_EDGE); points.More(); points.Next()) ++count;
  return count;
}

// IGES files have a unit by their standard.
void NoteUnit(STEPControl_Reader& reader, std::vector<std::string>& notices) {
  TColStd_SequenceOfAsciiString lengths, angles, solid_angles;
  reader.FileUnits(lengths, angles, solid_angles);
  if (!lengths.IsEmpty() && !lengths.First().IsEmpty()) return;
  notices.push_back("the file states no unit of length: millimetres are assumed; if the size is wrong, pass --scale");
}

template <typename Reader>
absl::StatusOr<TopoDS_Shape> ReadWith(Reader& reader, const std::string& path, std::vector<std::string>& notices) {
  if (reader.ReadFile(path.c_str()) != IFSelect_RetDone) {
    return absl::InvalidArgumentError("cannot be read: it is no STEP or IGES file, or it is damaged");
  }
  NoteFailures(FailuresOf(reader.WS()->ModelCheckList()), "cannot be read", notices);
  const int num_roots = reader.NbRootsForTransfer();
  const int num_missing = num_roots - reader.TransferRoots();
  if (num_missing > 0) {
    notices.push_back(absl::StrFormat("%d of %s cannot be converted and are missing: export the object again",
                                      num_missing, Counted(static_cast<uint64_t>(num_roots), "object")));
  }
  NoteFailures(FailuresOf(reader.WS()->TransferReader()->LastCheckList()), "cannot be converted", notices);
  TopoDS_Shape shape = reader.OneShape();
  if (shape.IsNull()) {
    return absl::InvalidArgumentError(
        "has no shape: export the object as solids or surfaces; tessellated geometry is not read");
  }
  if (const int count = CountOutsideFaces(shape); count > 0) {
    notices.push_back(absl::StrCat(Counted(static_cast<uint64_t>(count), "curve or point", "curves and points"),
                                   " outside faces left out"));
  }
  return shape;
}

// Whether a face ends at one of the edges of a shape without a neighbour there.
bool HasFreeEdge(const TopoDS_Shape& shape, const TopTools_IndexedDataMapOfShapeListOfShape& faces_of) {
  for (TopExp_Explorer edges(shape, TopAbs_EDGE); edges.More(); edges.Next()) {
    const TopoDS_Edge& edge = TopoDS::Edge(edges.Current());
    const TopTools_ListOfShape& faces = faces_of.FindFromKey(edge);
    if (faces.Extent() == 1 && !BRep_Tool::Degenerated(edge) && !IsSeam(edge, faces)) return true;
  }
  return false;
}

}  // namespace

absl::StatusOr<TopoDS_Shape> ReadShape(const std::string& path, std::vector<std::string>& notices) {
  EVPOSE_RETURN_IF_ERROR(CheckIsFile(path));
  const std::string extension = absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  if (extension == ".igs" || extension == ".iges") {
    IGESControl_Reader reader;
    return ReadWith(reader, path, notices);
  }
  STEPControl_Reader reader;
  absl::StatusOr<TopoDS_Shape> shape = ReadWith(reader, path, notices);
  if (shape.ok()) NoteUnit(reader, notices);
  return shape;
}

TopTools_IndexedDataMapOfShapeListOfShape FacesOfEdges(const TopoDS_Shape& shape) {
  TopTools_IndexedDataMapOfShapeListOfShape faces_of;
  TopExp::MapShapesAndUniqueAncestors(shape, TopAbs_EDGE, TopAbs_FACE, faces_of);
  return faces_of;
}

bool IsSeam(const TopoDS_Edge& edge, const TopTools_ListOfShape& faces) {
  return std::any_of(faces.begin(), faces.end(),
                     [&](const TopoDS_Shape& face) { return BRep_Tool::IsClosed(edge, TopoDS::Face(face)); });
}

TopoDS_Shape JoinFaces(const TopoDS_Shape& shape, double tolerance, std::vector<std::string>& notices) {
  const TopTools_IndexedDataMapOfShapeListOfShape faces_of = FacesOfEdges(shape);
  const BRep_Builder builder;
  TopoDS_Compound joined;
  builder.MakeCompound(joined);
  BRepBuilderAPI_Sewing sewing(tolerance);
  int num_faces = 0;
  for (TopExp_Explorer shells(shape, TopAbs_SHELL); shells.More(); shells.Next()) {
    if (!HasFreeEdge(shells.Current(), faces_of)) {
      builder.Add(joined, shells.Current());
      continue;
    }
    sewing.Add(shells.Current());
    for (TopExp_Explorer faces(shells.Current(), TopAbs_FACE); faces.More(); faces.Next()) ++num_faces;
  }
  for (TopExp_Explorer faces(shape, TopAbs_FACE, TopAbs_SHELL); faces.More(); faces.Next(), ++num_faces) {
    sewing.Add(faces.Current());
  }
  if (num_faces == 0) return shape;
  try {
    sewing.Perform();
  } catch (const Standard_Failure& failure) {
    notices.push_back(absl::StrCat("the faces of open surfaces cannot be joined, and their borders count as edges: ",
                                   failure.GetMessageString()));
    return shape;
  }
  if (sewing.SewedShape().IsNull()) return shape;
  builder.Add(joined, sewing.SewedShape());
  if (const int count = sewing.NbContigousEdges(); count > 0) {
    notices.push_back(absl::StrFormat("faces that the file does not join: joined at %s, within %.2g mm",
                                      Counted(static_cast<uint64_t>(count), "edge"), tolerance));
  }
  if (const int count = sewing.NbDeletedFaces(); count > 0) {
    notices.push_back(
        absl::StrFormat("%s narrower than %.2g mm left out", Counted(static_cast<uint64_t>(count), "face"), tolerance));
  }
  return joined;
}

}  // namespace evpose::client
