// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/transform_file.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <exception>
#include <new>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

constexpr size_t kMaxTransformBytes = 64 << 10;  // such a file has some hundred bytes
// The tolerance is that of quaternions: a larger difference is a wrong number and not rounding.
constexpr double kRotationTolerance = 1e-3;
constexpr char kForms[] =
    "give \"tx ty tz qx qy qz qw\", a 4x4 matrix row by row, or YAML with translation and rotation";

absl::Status KeyError(const std::string& key, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(key, ": ", what));
}

absl::StatusOr<RigidTransform> FromRotationMatrix(const Eigen::Matrix3d& matrix, const Eigen::Vector3d& translation_m) {
  if (!matrix.allFinite() || !translation_m.allFinite()) {
    return absl::InvalidArgumentError("the matrix has a number that is not finite");
  }
  const double error = (matrix * matrix.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(error <= kRotationTolerance)) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "the 3x3 part is not a rotation: its rows differ from an orthonormal basis by %.3g, at most 1e-3 is allowed; a "
        "scale must not be in it",
        error));
  }
  if (matrix.determinant() < 0.0) {
    return absl::InvalidArgumentError("the 3x3 part is a reflection (determinant -1); use right-handed frames");
  }
  return MakeRigidTransform(translation_m, Eigen::Quaterniond(matrix).normalized());
}

absl::StatusOr<RigidTransform> FromNumbers(const std::vector<double>& v) {
  if (v.size() == 7) return MakeRigidTransform({v[0], v[1], v[2]}, Eigen::Quaterniond(v[6], v[3], v[4], v[5]));
  if (v.size() != 16 && v.size() % 8 == 0 && !v.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "has ", v.size(),
        " numbers, as a trajectory with 8 in a line; a constant transform has no time: give tx ty tz qx qy qz "
        "qw"));
  }
  if (v.size() != 16) return absl::InvalidArgumentError(absl::StrCat("has ", v.size(), " numbers; ", kForms));
  if (v[12] != 0.0 || v[13] != 0.0 || v[14] != 0.0 || v[15] != 1.0) {
    return absl::InvalidArgumentError("the last row of the 4x4 matrix is not 0 0 0 1; give it row by row");
  }
  Eigen::Matrix3d rotation;
  rotation << v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10];
  return FromRotationMatrix(rotation, {v[3], v[7], v[11]});
}

absl::StatusOr<double> Number(const YAML::Node& node, const std::string& key) {
  double value = 0.0;
  if (!node || node.IsNull()) return KeyError(key, "is missing");
  if (!node.IsScalar() || !YAML::convert<double>::decode(node, value)) return KeyError(key, "is not a number");
  if (!std::isfinite(value)) return KeyError(key, "is not finite");
  return value;
}

// The numbers of a list, or of the keys `names` of a map. A list of lists is read row by row.
absl::StatusOr<std::vector<double>> Numbers(const YAML::Node& node, const std::string& key,
                                            const std::vector<std::string>& names) {
  std::vector<double> values;
  if (node.IsMap()) {
    for (const std::string& name : names) {
      EVPOSE_ASSIGN_OR_RETURN(values.emplace_back(), Number(node[name], absl::StrCat(key, ".", name)));
    }
    return values;
  }
  if (!node.IsSequence()) return KeyError(key, "is neither a list nor a map");
  for (size_t i = 0; i < node.size(); ++i) {
    const std::string item = absl::StrFormat("%s[%d]", key, i);
    if (!node[i].IsSequence()) {
      EVPOSE_ASSIGN_OR_RETURN(values.emplace_back(), Number(node[i], item));
      continue;
    }
    for (size_t j = 0; j < node[i].size(); ++j) {
      EVPOSE_ASSIGN_OR_RETURN(values.emplace_back(), Number(node[i][j], absl::StrFormat("%s[%d]", item, j)));
    }
  }
  return values;
}

absl::StatusOr<RigidTransform> FromTranslationAndRotation(const YAML::Node& body) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> t, Numbers(body["translation"], "translation", {"x", "y", "z"}));
  if (t.size() != 3) return KeyError("translation", absl::StrCat("has ", t.size(), " numbers instead of 3"));
  if (!body["rotation"]) return KeyError("rotation", "is missing: x, y, z, w or a 3x3 matrix");
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> r, Numbers(body["rotation"], "rotation", {"x", "y", "z", "w"}));
  const Eigen::Vector3d translation_m(t[0], t[1], t[2]);
  absl::StatusOr<RigidTransform> transform;
  if (r.size() == 4) {
    transform = MakeRigidTransform(translation_m, Eigen::Quaterniond(r[3], r[0], r[1], r[2]));
  } else if (r.size() == 9) {
    transform =
        FromRotationMatrix(Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r.data()), translation_m);
  } else {
    return KeyError("rotation", absl::StrCat("has ", r.size(), " numbers; give x, y, z, w or a 3x3 matrix"));
  }
  if (!transform.ok()) return KeyError("rotation", std::string(transform.status().message()));
  return transform;
}

// The keys of easy_handeye's and many other files.
absl::StatusOr<RigidTransform> FromFlatKeys(const YAML::Node& body) {
  std::vector<double> values;
  for (const char* const key : {"x", "y", "z", "qx", "qy", "qz", "qw"}) {
    EVPOSE_ASSIGN_OR_RETURN(values.emplace_back(), Number(body[key], key));
  }
  return FromNumbers(values);
}

// The name is written into the outputs.
absl::StatusOr<std::string> TargetName(const YAML::Node& root) {
  const YAML::Node header = root["header"];
  const bool is_in_header = !root["frame_id"] && header && header.IsMap();
  const YAML::Node node = is_in_header ? header["frame_id"] : root["frame_id"];
  if (!node || node.IsNull()) return "";
  const std::string name = node.IsScalar() ? node.Scalar() : "";
  const auto is_allowed = [](unsigned char c) { return absl::ascii_isalnum(c) || c == '_' || c == '-' || c == '/'; };
  if (!name.empty() && name.size() <= 100 && std::all_of(name.begin(), name.end(), is_allowed)) return name;
  return KeyError("frame_id", "is not a name of letters, digits, _, - and /");
}

absl::StatusOr<NamedTransform> FromMap(const YAML::Node& root) {
  YAML::Node body = root;
  for (const char* const key : {"transform", "transformation"}) {
    if (root[key] && root[key].IsMap()) body.reset(root[key]);
  }
  NamedTransform named;
  EVPOSE_ASSIGN_OR_RETURN(named.target, TargetName(root));
  if (body["translation"]) {
    EVPOSE_ASSIGN_OR_RETURN(named.target_from_source, FromTranslationAndRotation(body));
    return named;
  }
  if (!body["qw"]) return KeyError("translation", absl::StrCat("is missing; ", kForms));
  EVPOSE_ASSIGN_OR_RETURN(named.target_from_source, FromFlatKeys(body));
  return named;
}

absl::StatusOr<NamedTransform> FromYaml(const std::string& text) {
  try {
    const YAML::Node root = YAML::Load(text);
    if (!root.IsMap()) return absl::InvalidArgumentError(kForms);
    return FromMap(root);
  } catch (const YAML::Exception& e) {
    return absl::InvalidArgumentError(absl::StrFormat("line %d: not YAML: %s", e.mark.line + 1, e.msg));
  } catch (const std::bad_alloc&) {
    throw;  // memory is exhausted: no fault of the file
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat("not a transform: ", e.what()));
  }
}

absl::StatusOr<NamedTransform> FromText(const std::string& text) {
  std::vector<absl::string_view> lines = absl::StrSplit(text, '\n');
  std::erase_if(lines,
                [](absl::string_view line) { return absl::StartsWith(absl::StripLeadingAsciiWhitespace(line), "#"); });
  const std::string content = absl::StrJoin(lines, "\n");
  if (absl::StrContains(content, ':')) return FromYaml(text);
  std::vector<double> values;
  for (const absl::string_view word : absl::StrSplit(content, absl::ByAnyChar(" \t\r\n,;[]"), absl::SkipEmpty())) {
    double value = 0.0;
    if (!absl::SimpleAtod(word, &value) || !std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat("\"", word.substr(0, 40), "\" is not a finite number; ", kForms));
    }
    values.push_back(value);
  }
  NamedTransform named;
  EVPOSE_ASSIGN_OR_RETURN(named.target_from_source, FromNumbers(values));
  return named;
}

}  // namespace

absl::StatusOr<NamedTransform> ParseTransform(const std::string& text, const std::string& name_for_errors) {
  absl::StatusOr<NamedTransform> named = FromText(text);
  if (named.ok()) return named;
  return absl::Status(named.status().code(), absl::StrCat(name_for_errors, ": ", named.status().message()));
}

absl::StatusOr<NamedTransform> ReadTransformFile(const std::string& path) {
  const absl::StatusOr<std::string> text = ReadFile(path, kMaxTransformBytes);
  if (text.ok()) return ParseTransform(*text, path);
  if (text.status().code() != absl::StatusCode::kInvalidArgument) return text.status();
  return absl::InvalidArgumentError(absl::StrCat(text.status().message(), ", and is no transform; ", kForms));
}

std::string TransformToYaml(const RigidTransform& target_from_source, const std::string& target,
                            const std::string& source, const std::string& comment) {
  const Eigen::Vector3d& t = target_from_source.translation_m;
  const Eigen::Quaterniond q = target_from_source.Quaternion();
  std::string text;
  for (const absl::string_view line : absl::StrSplit(comment, '\n')) absl::StrAppend(&text, "# ", line, "\n");
  absl::StrAppendFormat(&text, "frame_id: %s\nchild_frame_id: %s\n", target, source);
  absl::StrAppendFormat(&text, "translation: [%.17g, %.17g, %.17g]\n", t.x(), t.y(), t.z());
  absl::StrAppendFormat(&text, "rotation: [%.17g, %.17g, %.17g, %.17g]\n", q.x(), q.y(), q.z(), q.w());
  return text;
}

}  // namespace evpose
