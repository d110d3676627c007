// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/search_views.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "core/contours/contour_shapes_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_model.h"
#include "gtest/gtest.h"

namespace evpose {
namespace {

using Change = void (*)(SearchViews&);

// A model with curves, contours and enough straight lines for both searches.
ObjectModel PlateAndCube() {
  ObjectModel model = PlateWithHoles(0.04, 0.02, 0.005, 16, {-0.09, 0.03, 0.09});
  model.diameter_m = 0.27;
  const auto cube = testing::MakeCube(0.1);
  model.lines.insert(model.lines.end(), cube->lines.begin(), cube->lines.end());
  return model;
}

std::shared_ptr<const ObjectModel> WithViews(ObjectModel model, const Change& change = nullptr) {
  SearchViews views = MakeSearchViews(std::make_shared<const ObjectModel>(model));
  if (change != nullptr) change(views);
  model.views = std::make_shared<const SearchViews>(std::move(views));
  return std::make_shared<const ObjectModel>(std::move(model));
}

std::shared_ptr<const ObjectModel> WithoutViews(ObjectModel model) {
  model.views = nullptr;
  return std::make_shared<const ObjectModel>(std::move(model));
}

// The model with a symmetry about an axis, which it does not have: it has few views, so that the test is short.
std::shared_ptr<const ObjectModel> WithFewViews(const Change& change = nullptr) {
  ObjectModel model = PlateAndCube();
  model.continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitX(),
                               true};
  return WithViews(std::move(model), change);
}

void ExpectEqual(const TemplateModel& a, const TemplateModel& b) {
  EXPECT_EQ(a.num_coarse(), b.num_coarse());
  ASSERT_EQ(a.views().size(), b.views().size());
  for (size_t i = 0; i < a.views().size(); ++i) {
    const ViewTemplate &view = a.views()[i], &other = b.views()[i];
    EXPECT_EQ(view.rotation, other.rotation);
    EXPECT_TRUE(view.samples == other.samples);
    EXPECT_EQ(view.parent, other.parent);
    EXPECT_EQ(view.parent_turn, other.parent_turn);
    ASSERT_EQ(view.points.size(), other.points.size());
    for (size_t k = 0; k < view.points.size(); ++k) {
      EXPECT_EQ(view.points[k].at, other.points[k].at);
      EXPECT_EQ(view.points[k].direction, other.points[k].direction);
    }
    ASSERT_EQ(view.extents.size(), other.extents.size());
    for (size_t k = 0; k < view.extents.size(); ++k) {
      EXPECT_EQ(view.extents[k].low, other.extents[k].low);
      EXPECT_EQ(view.extents[k].high, other.extents[k].high);
    }
  }
}

TEST(SearchViewsTest, StoredViewsGiveTheSameBits) {
  const auto stored = WithViews(PlateAndCube());
  const auto plain = WithoutViews(*stored);
  ASSERT_FALSE(stored->views->templates.empty());
  ASSERT_FALSE(stored->views->lines.empty());
  const TemplateModel from_views(stored), computed(plain);
  ExpectEqual(from_views, computed);
  EXPECT_EQ(&from_views.samples(), &stored->views->templates) << "not computed again";
  const SearchModel search_from_views(*stored), search_computed(*plain);
  EXPECT_EQ(search_from_views.views(), search_computed.views());
  EXPECT_EQ(search_from_views.mean_view_size(), search_computed.mean_view_size());
  EXPECT_EQ(&search_from_views.views(), &stored->views->lines) << "not computed again";
}

TEST(SearchViewsTest, ASearchThatCannotFindTheModelHasNone) {
  EXPECT_TRUE(MakeSearchViews(testing::MakeCube(0.1)).templates.empty());
  EXPECT_TRUE(MakeSearchViews(std::make_shared<const ObjectModel>(TorusModel(0.06, 0.025, 24, 12))).lines.empty());
}

TEST(SearchViewsTest, TemplatesOfAnotherModelAreComputedAgain) {
  const TemplateModel computed(WithoutViews(*WithFewViews()));
  const auto first = [](SearchViews& views) -> EdgeSample& {
    return std::find_if(views.templates.begin(), views.templates.end(), [](const auto& view) { return !view.empty(); })
        ->front();
  };
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  static const auto sample_of = first;
  for (const Change& change : std::initializer_list<Change>{
           [](SearchViews& views) { views.templates.pop_back(); },
           [](SearchViews& views) { views.templates.clear(); },
           [](SearchViews& views) { views.templates[0].resize(TemplateModel::kPoints + 2, sample_of(views)); },
           [](SearchViews& views) { sample_of(views).point.x() = kNan; },
           [](SearchViews& views) { sample_of(views).point.z() = 0.3; },
           [](SearchViews& views) { sample_of(views).along.y() = -1e300; },
           [](SearchViews& views) { sample_of(views).prior_contrast = 0.0f; },
           [](SearchViews& views) { sample_of(views).prior_contrast = static_cast<float>(kNan); },
       }) {
    ExpectEqual(TemplateModel(WithFewViews(change)), computed);
  }
}

TEST(SearchViewsTest, LineViewsOfAnotherModelAreComputedAgain) {
  const SearchModel computed(*WithoutViews(*WithFewViews()));
  for (const Change& change : std::initializer_list<Change>{
           [](SearchViews& views) { views.lines.pop_back(); },
           [](SearchViews& views) {
             views.lines[0].resize(300, {0, 0.0, 1.0, 1.0});
           },
           [](SearchViews& views) {
             views.lines[0] = {{-1, 0.0, 1.0, 1.0}};
           },
           [](SearchViews& views) {
             views.lines[0] = {{1000, 0.0, 1.0, 1.0}};
           },
           [](SearchViews& views) {
             views.lines[0] = {{0, 0.5, 0.5, 0.0}};
           },
           [](SearchViews& views) {
             views.lines[0] = {{0, 0.0, 1.5, 1.0}};
           },
           [](SearchViews& views) {
             views.lines[0] = {{0, std::numeric_limits<double>::quiet_NaN(), 1.0, 1.0}};
           },
           [](SearchViews& views) {
             views.lines[0] = {{0, 0.0, 1.0, 7.0}};
           },
       }) {
    EXPECT_EQ(SearchModel(*WithFewViews(change)).views(), computed.views());
  }
}

}  // namespace
}  // namespace evpose
