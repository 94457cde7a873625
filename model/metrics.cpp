#include "model/metrics.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "model/assignment.h"
#include "proto/pose_geometry.h"

namespace csipose {
namespace {

constexpr double kTooFar_m = 0.5;      // detect
constexpr double kGreedyLimit_m = 50;  // piw3d
constexpr double kMissedPenalty_mm = 500;

template <class Operation>
void combine(PoseErrors& a, const PoseErrors& b, Operation operation) {
  operation(a.mpjpe, b.mpjpe);
  for (std::size_t k = 0; k < 3; ++k) operation(a.axis[k], b.axis[k]);
  operation(a.mrpe, b.mrpe), operation(a.root_mpjpe, b.root_mpjpe), operation(a.pa_mpjpe, b.pa_mpjpe);
  operation(a.facing_deg, b.facing_deg), operation(a.breadth_mm, b.breadth_mm);
  operation(a.pck20, b.pck20), operation(a.pck50, b.pck50);
  operation(a.pck20_elbows, b.pck20_elbows), operation(a.pck50_elbows, b.pck50_elbows);
  operation(a.pck20mm, b.pck20mm), operation(a.pck50mm, b.pck50mm);
}
void add(PoseErrors& sum, const PoseErrors& one, double weight) {
  combine(sum, one, [weight](double& a, double b) { a += weight * b; });
}
PoseErrors divided(PoseErrors sum, std::size_t count) {  // by 0: not a number, as it should be
  combine(sum, sum, [count](double& a, double) { a /= static_cast<double>(count); });
  return sum;
}
double ratio(std::size_t part, std::size_t whole) {
  return static_cast<double>(part) / static_cast<double>(whole);
}

std::vector<std::size_t> match_greedily(std::span<const Skeleton> predicted,
                                        std::span<const Skeleton> people) {
  std::vector<std::size_t> matches(people.size(), kMissed);
  if (predicted.empty()) return matches;
  std::vector<char> used(predicted.size(), 0);
  for (std::size_t pass = 0; pass < std::min(predicted.size(), people.size()); ++pass) {
    double nearest_m = kGreedyLimit_m;
    std::size_t person = kMissed, prediction = kMissed;
    for (std::size_t i = 0; i < predicted.size(); ++i)
      for (std::size_t j = 0; j < people.size(); ++j) {
        if (used[i] || matches[j] != kMissed) continue;
        const double d_m = mean_joint_distance_m(predicted[i], people[j]);
        if (d_m < nearest_m) nearest_m = d_m, person = j, prediction = i;
      }
    if (person == kMissed) break;
    matches[person] = prediction;
    used[prediction] = 1;
  }
  std::replace(matches.begin(), matches.end(), kMissed, predicted.size() - 1);
  return matches;
}

/// Pairs further apart than `limit_m` do not count.
std::vector<std::size_t> match_optimally(std::span<const Skeleton> predicted,
                                         std::span<const Skeleton> people, double limit_m) {
  std::vector<std::size_t> matches(people.size(), kMissed);
  if (predicted.empty() || people.empty()) return matches;
  std::vector<double> cost_m;
  for (const Skeleton& person : people)
    for (const Skeleton& prediction : predicted) cost_m.push_back(mean_joint_distance_m(prediction, person));
  Assignment assignment(people.size(), predicted.size());
  const auto columns = assignment.solve(cost_m, people.size(), predicted.size());
  for (std::size_t j = 0; j < people.size(); ++j)
    if (columns[j] != kUnassigned && cost_m[j * predicted.size() + columns[j]] <= limit_m)
      matches[j] = columns[j];
  return matches;
}

}  // namespace

std::string_view name_of(Protocol protocol) {
  switch (protocol) {
    case Protocol::piw3d:
      return "piw3d";
    case Protocol::detect:
      return "detect";
    case Protocol::assigned:
      break;
  }
  return "assigned";
}

std::vector<std::size_t> match(Protocol protocol, std::span<const Skeleton> predicted,
                               std::span<const Skeleton> people) {
  if (protocol == Protocol::piw3d) return match_greedily(predicted, people);
  return match_optimally(predicted, people, protocol == Protocol::detect ? kTooFar_m : HUGE_VAL);
}

double GroupMetrics::precision() const { return ratio(matched, predicted); }
double GroupMetrics::recall() const { return ratio(matched, people); }
double GroupMetrics::f1() const { return ratio(2 * matched, predicted + people); }
double GroupMetrics::count_accuracy() const { return ratio(right_count, frames); }

void Metrics::add(std::span<const Skeleton> predicted, std::span<const Skeleton> people) {
  const std::vector<std::size_t> matches = match(protocol_, predicted, people);
  const auto matched = static_cast<std::size_t>(
      std::count_if(matches.begin(), matches.end(), [](std::size_t m) { return m != kMissed; }));
  const std::array<Sums*, 2> groups = {&all_, &by_count_[people.size()]};
  for (Sums* sums : groups) {
    GroupMetrics& counts = sums->counts;
    ++counts.frames;
    sums->frames_matched += matched > 0;
    counts.frames_unmatched += matched == 0 && !people.empty();
    counts.people += people.size();
    counts.matched += matched;
    counts.predicted += predicted.size();
    counts.right_count += predicted.size() == people.size();
  }
  for (std::size_t j = 0; j < people.size(); ++j) {
    PostureMetrics& alike = by_posture_[static_cast<std::size_t>(posture_of(people[j]))];
    ++alike.people;
    if (matches[j] == kMissed) continue;
    const Skeleton& prediction = predicted[matches[j]];
    const PoseErrors errors = pose_errors(prediction, people[j]);
    const std::array<double, kJoints> joints = joint_errors_mm(prediction, people[j]);
    ++alike.matched;
    csipose::add(alike.person_mean, errors, 1);
    for (Sums* sums : groups) {
      csipose::add(sums->by_person, errors, 1);
      csipose::add(sums->by_frame, errors, 1 / static_cast<double>(matched));
      for (std::size_t k = 0; k < kJoints; ++k) sums->joints[k] += joints[k];
    }
  }
}

GroupMetrics Metrics::Sums::means() const {
  GroupMetrics means = counts;
  means.frame_mean = divided(by_frame, frames_matched);
  means.person_mean = divided(by_person, counts.matched);
  for (std::size_t k = 0; k < kJoints; ++k)
    means.per_joint[k] = joints[k] / static_cast<double>(counts.matched);
  const auto missed = static_cast<double>(counts.people - counts.matched);
  means.penalised_500 = (by_person.mpjpe + kMissedPenalty_mm * missed) / static_cast<double>(counts.people);
  return means;
}

PostureMetrics Metrics::by_posture(Posture posture) const {
  PostureMetrics group = by_posture_[static_cast<std::size_t>(posture)];
  group.person_mean = divided(group.person_mean, group.matched);
  return group;
}

std::map<std::size_t, GroupMetrics> Metrics::by_count() const {
  std::map<std::size_t, GroupMetrics> groups;
  for (const auto& [count, sums] : by_count_) groups[count] = sums.means();
  return groups;
}

namespace {
nlohmann::ordered_json errors_json(const PoseErrors& e) {
  return {{"mpjpe", e.mpjpe},
          {"err_x", e.axis[0]},
          {"err_y", e.axis[1]},
          {"err_z", e.axis[2]},
          {"h", e.axis[0]},
          {"v", e.axis[1]},
          {"d", e.axis[2]},
          {"mrpe", e.mrpe},
          {"root_mpjpe", e.root_mpjpe},
          {"pa_mpjpe", e.pa_mpjpe},
          {"facing_deg", e.facing_deg},
          {"breadth_mm", e.breadth_mm},
          {"pck20", e.pck20},
          {"pck50", e.pck50},
          {"pck20_dtpose", e.pck20_elbows},
          {"pck50_dtpose", e.pck50_elbows},
          {"pck20mm", e.pck20mm},
          {"pck50mm", e.pck50mm}};
}

nlohmann::ordered_json group_json(const GroupMetrics& group, Protocol protocol) {
  nlohmann::ordered_json json = errors_json(group.frame_mean);
  json["elbows"] = (group.per_joint[kLeftElbow] + group.per_joint[kRightElbow]) / 2;
  json["hands"] = (group.per_joint[kLeftHand] + group.per_joint[kRightHand]) / 2;
  json["mpjpe_penalised_500"] = group.penalised_500;
  json["frames"] = group.frames;
  json["frames_unmatched"] = group.frames_unmatched;
  json["people"] = group.people;
  if (protocol == Protocol::detect) {
    json["precision"] = group.precision();
    json["recall"] = group.recall();
    json["f1"] = group.f1();
    json["count_accuracy"] = group.count_accuracy();
  }
  json["person_mean"] = errors_json(group.person_mean);
  return json;
}
}  // namespace

std::string metrics_json(const Metrics& metrics) {
  const GroupMetrics all = metrics.all();
  nlohmann::ordered_json json;
  json["protocol"] = name_of(metrics.protocol());
  json["n_frames"] = all.frames;
  json["all"] = group_json(all, metrics.protocol());
  for (const auto& [count, group] : metrics.by_count())
    json["by_count"][std::to_string(count)] = group_json(group, metrics.protocol());
  for (std::size_t i = 0; i < kPostures; ++i) {
    const auto posture = static_cast<Posture>(i);
    const PostureMetrics group = metrics.by_posture(posture);
    nlohmann::ordered_json& figures = json["by_posture"][std::string(name_of(posture))];
    figures = {{"people", group.people},
               {"mpjpe", group.person_mean.mpjpe},
               {"mrpe", group.person_mean.mrpe},
               {"root_mpjpe", group.person_mean.root_mpjpe},
               {"pa_mpjpe", group.person_mean.pa_mpjpe},
               {"facing_deg", group.person_mean.facing_deg}};
    if (metrics.protocol() == Protocol::detect) figures["recall"] = ratio(group.matched, group.people);
  }
  json["per_joint"] = all.per_joint;
  return json.dump();
}

}  // namespace csipose
