#include "train/evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <utility>

#include "model/installation_finder.h"
#include "model/pose_estimator.h"
#include "proto/pose_geometry.h"
#include "proto/result.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

constexpr float kMinRawScore = 0.3f;
constexpr float kNmsDistance_m = 0.25f;

Point3 plus(const Point3& a, const Point3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Point3 times(const Point3& a, float factor) { return {a.x * factor, a.y * factor, a.z * factor}; }
Skeleton moved(Skeleton pose, const Point3& by) {
  for (Point3& joint : pose) joint = plus(joint, by);
  return pose;
}
/// About the vertical through the origin.
Skeleton turned(Skeleton pose, float angle_rad) {
  const float c = std::cos(angle_rad), s = std::sin(angle_rad);
  for (Point3& joint : pose) joint = {c * joint.x - s * joint.y, s * joint.x + c * joint.y, joint.z};
  return pose;
}
/// In which horizontal direction the pose's right lies, from x towards y.
float right_of_rad(const Skeleton& pose) {
  const Point3 across = left_to_right(pose);
  return std::atan2(across.y, across.x);
}

Skeleton in_room(const RoomTransform& model_to_room, const float* xyz_m) {
  Skeleton pose;
  for (std::size_t j = 0; j < kJoints; ++j) pose[j] = to_room(model_to_room, xyz_m + 3 * j);
  return pose;
}
std::vector<Skeleton> in_room(const RoomTransform& model_to_room, std::span<const Skeleton> people) {
  std::vector<Skeleton> result;
  for (const Skeleton& person : people) {
    Skeleton& pose = result.emplace_back();
    for (std::size_t j = 0; j < kJoints; ++j) {
      const std::array<float, 3> xyz_m = {person[j].x, person[j].y, person[j].z};
      pose[j] = to_room(model_to_room, xyz_m.data());
    }
  }
  return result;
}

/// The threshold on the raw score as a threshold on the score that select_people() compares.
float threshold(const Calibration& calibration) {
  return person_score(std::log(kMinRawScore / (1 - kMinRawScore)), calibration);
}

/// A mean of poses.
class MeanPose {
 public:
  void add(const Skeleton& pose) {
    for (std::size_t j = 0; j < kJoints; ++j) {
      sum_[3 * j] += static_cast<double>(pose[j].x);
      sum_[3 * j + 1] += static_cast<double>(pose[j].y);
      sum_[3 * j + 2] += static_cast<double>(pose[j].z);
    }
    ++count_;
  }
  Skeleton mean() const {
    Skeleton pose;
    const auto coordinate = [this](std::size_t i) {
      return static_cast<float>(sum_[i] / static_cast<double>(count_));
    };
    for (std::size_t j = 0; j < kJoints; ++j)
      pose[j] = {coordinate(3 * j), coordinate(3 * j + 1), coordinate(3 * j + 2)};
    return pose;
  }

 private:
  std::array<double, kPoseWidth> sum_{};
  std::size_t count_ = 0;
};

struct TrainingMeans {
  Skeleton absolute, about_root, facing;  ///< facing: about its root, its right towards x
  std::map<std::uint8_t, Point3> root_of_room;
};

TrainingMeans means_of(const EvaluationSet& training, const RoomTransform& model_to_room) {
  MeanPose absolute, about_root, facing;
  std::map<std::uint8_t, MeanPose> of_room;
  for (std::size_t i = 0; i < training.windows->size(); ++i)
    for (const Skeleton& pose : in_room(model_to_room, training.windows->people(i))) {
      absolute.add(pose);
      const Skeleton from_root = moved(pose, times(root_of(pose), -1));
      about_root.add(from_root);
      facing.add(turned(from_root, -right_of_rad(pose)));
      of_room[training.rooms[i]].add(pose);
    }
  TrainingMeans means{absolute.mean(), about_root.mean(), facing.mean(), {}};
  for (const auto& [room, mean] : of_room) means.root_of_room[room] = root_of(mean.mean());
  return means;
}

/// Who was there in the last training window of each clip that the two sets share.
std::map<std::string, std::vector<Skeleton>> last_seen_of(const EvaluationSet& training,
                                                          const EvaluationSet& set,
                                                          const RoomTransform& model_to_room) {
  std::set<std::string> judged;
  for (std::size_t i = 0; i < set.windows->size(); ++i) judged.insert(set.windows->clip_name(i));
  judged.erase("");  // not known
  std::map<std::string, std::vector<Skeleton>> last;
  for (std::size_t i = 0; i < training.windows->size(); ++i)
    if (const std::string clip = training.windows->clip_name(i); judged.contains(clip))
      last[clip] = in_room(model_to_room, training.windows->people(i));
  return last;
}

void add(TrivialFigures& figures, std::span<const Skeleton> predicted, std::span<const Skeleton> people) {
  figures.assigned.add(predicted, people);
  figures.detect.add(predicted, people);
}

std::vector<Skeleton> skeletons_of(std::span<const Detection> found) {
  std::vector<Skeleton> skeletons;
  for (const Detection& detection : found) skeletons.push_back(detection.person.joints);
  return skeletons;
}

Detection detection_of(const Person& person, std::size_t query, const NetworkOutput& output) {
  Detection detection{person, output.logits[query]};
  detection.sigma_m.fill(kUnknown);
  detection.error_m.fill(kUnknown);
  if (!output.sigma_m.empty())
    std::copy_n(output.sigma_m.begin() + static_cast<std::ptrdiff_t>(query * kJoints), kJoints,
                detection.sigma_m.begin());
  return detection;
}

/// Says of each detection who it is of the people that are left, and how far off; takes those away.
void match_detections(std::vector<Detection>& detections, std::span<const Skeleton> people,
                      std::vector<std::size_t>& left) {
  std::vector<Skeleton> wanted;
  for (const std::size_t person : left) wanted.push_back(people[person]);
  const std::vector<std::size_t> matches = match(Protocol::detect, skeletons_of(detections), wanted);
  const std::vector<std::size_t> before = std::exchange(left, {});
  for (std::size_t p = 0; p < wanted.size(); ++p) {
    if (matches[p] == kMissed) {
      left.push_back(before[p]);
      continue;
    }
    Detection& detection = detections[matches[p]];
    detection.match = before[p];
    const auto errors_mm = joint_errors_mm(detection.person.joints, wanted[p]);
    for (std::size_t j = 0; j < kJoints; ++j) detection.error_m[j] = static_cast<float>(errors_mm[j] / 1000);
  }
}

/// Sources one after another.
class JoinedWindows : public WindowSource {
 public:
  explicit JoinedWindows(std::vector<std::shared_ptr<const WindowSource>> parts) : parts_(std::move(parts)) {
    for (const auto& part : parts_) {
      first_.push_back(size_);
      size_ += part->size();
      name_ += (name_.empty() ? "" : " + ") + part->name();
    }
  }
  std::size_t size() const override { return size_; }
  std::string name() const override { return name_; }
  void read(std::size_t i, std::span<float> x) const override {
    parts_[part(i)]->read(i - first_[part(i)], x);
  }
  std::span<const Skeleton> people(std::size_t i) const override {
    return parts_[part(i)]->people(i - first_[part(i)]);
  }
  std::string room(std::size_t i) const override { return parts_[part(i)]->room(i - first_[part(i)]); }
  std::uint64_t clip(std::size_t i) const override {
    return std::uint64_t{part(i)} << 32 | parts_[part(i)]->clip(i - first_[part(i)]);
  }
  std::string clip_name(std::size_t i) const override {
    return parts_[part(i)]->clip_name(i - first_[part(i)]);
  }

 private:
  std::size_t part(std::size_t i) const {
    return static_cast<std::size_t>(std::upper_bound(first_.begin(), first_.end(), i) - first_.begin()) - 1;
  }
  std::vector<std::shared_ptr<const WindowSource>> parts_;
  std::vector<std::size_t> first_;
  std::size_t size_ = 0;
  std::string name_;
};

}  // namespace

EvaluationSet open_evaluation_set(const std::filesystem::path& folder) {
  EvaluationSet set{open_window_folder(folder), {}};
  bool labelled = false;
  for (std::size_t i = 0; i < set.windows->size() && !labelled; ++i)
    labelled = !set.windows->people(i).empty();
  if (!labelled)
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{} has no labelled people; evaluation needs labels.npy", folder.string()));
  set.rooms = read_rooms(folder, set.windows->size());
  set.rooms.resize(set.windows->size());  // without room.npy: one room for all
  return set;
}

EvaluationSet open_evaluation_sets(const std::vector<std::string>& folders) {
  std::vector<std::shared_ptr<const WindowSource>> parts;
  std::vector<std::uint8_t> rooms;
  for (const std::string& folder : folders) {
    EvaluationSet set = open_evaluation_set(folder);
    const int first = rooms.empty() ? 0 : 1 + *std::max_element(rooms.begin(), rooms.end());
    for (const std::uint8_t room : set.rooms) rooms.push_back(static_cast<std::uint8_t>(first + room));
    parts.push_back(std::move(set.windows));
  }
  if (parts.size() == 1) return {parts.front(), std::move(rooms)};
  return {std::make_shared<JoinedWindows>(std::move(parts)), std::move(rooms)};
}

void ask_model(Engine& engine, const Model& model, const EvaluationSet& set, LinkSet links,
               const std::function<void(const Answer&)>& tell) {
  const Selection selection{kMaxPeople, 0, kNmsDistance_m};
  const float least = threshold(model.calibration());
  std::vector<float> x(kChannels * kTokens);
  std::array<Person, kMaxPeople> selected;
  InstallationFinder installation(model.normalisation().backgrounds);
  const auto window_time = std::chrono::duration_cast<Nanoseconds>(
      std::chrono::duration<double>(static_cast<double>(kSamples) / model.demand().rate_hz));
  SteadyTime now{};
  for (std::size_t i = 0; i < set.windows->size(); ++i) {
    set.windows->read(i, x);
    if (i == 0 || set.windows->clip(i) != set.windows->clip(i - 1)) installation.reset();
    const NearestBackground here = installation.add(x, links, now += window_time);
    const NetworkOutput output = engine.run(x, links, here.background);
    Answer answer{i, here, in_room(model.model_to_room(), set.windows->people(i)), {}, {}, {}};
    for (std::size_t q = 0; q < output.logits.size(); ++q)
      answer.hypotheses.push_back(in_room(model.model_to_room(), output.poses.data() + q * kPoseWidth));
    const Selected chosen = select_people(output, model, selection, selected);
    if (chosen.not_finite)
      throw SetupError(ExitStatus::bad_data,
                       fmt::format("{}: window {} gives numbers that are not finite", model.file_name(), i));
    for (std::size_t p = 0; p < chosen.count; ++p)
      (selected[p].score >= least ? answer.found : answer.faint)
          .push_back(detection_of(selected[p], chosen.query[p], output));
    std::vector<std::size_t> left(answer.people.size());
    std::iota(left.begin(), left.end(), std::size_t{0});
    match_detections(answer.found, answer.people, left);
    match_detections(answer.faint, answer.people, left);
    tell(answer);
  }
}

void Installations::add(const NearestBackground& found, const Model& model, const std::string& name) {
  if (found.background == nullptr) return;
  ++windows;
  unknown += found.unlikeness > kMostUnlike;
  unlikeness_sum += found.unlikeness;
  greatest_unlikeness = std::max(greatest_unlikeness, found.unlikeness);
  const bool known = std::ranges::find(model.normalisation().backgrounds, name, &Background::name) !=
                     model.normalisation().backgrounds.end();
  named += known;
  mistaken += known && found.background->name != name;
}

Evaluation evaluate_model(Engine& engine, const Model& model, const EvaluationSet& set, LinkSet links,
                          const std::function<void(const Answer&)>& watch) {
  Evaluation figures;
  ask_model(engine, model, set, links, [&](const Answer& answer) {
    figures.piw3d.add(answer.hypotheses, answer.people);
    figures.detect.add(skeletons_of(answer.found), answer.people);
    figures.installations.add(answer.installation, model, set.windows->room(answer.window));
    for (const Detection& detection : answer.found) {
      figures.score.add(static_cast<double>(detection.person.score), detection.match != kMissed);
      if (detection.match == kMissed || std::isnan(detection.person.confidence.front())) continue;
      for (std::size_t j = 0; j < kJoints; ++j)
        figures.joints.add(static_cast<double>(detection.person.confidence[j]),
                           detection.error_m[j] < kConfidentError_m);
    }
    if (watch) watch(answer);
  });
  return figures;
}

std::vector<TrivialFigures> evaluate_trivial(const EvaluationSet& training, const EvaluationSet& set,
                                             const RoomTransform& model_to_room) {
  const TrainingMeans means = means_of(training, model_to_room);
  std::vector<TrivialFigures> trivial = {
      {"mean_pose"}, {"mean_at_room"}, {"mean_at_root"}, {"mean_facing"}, {"last_pose"}};
  const auto last_seen = last_seen_of(training, set, model_to_room);
  if (!last_seen.empty()) trivial.push_back({"last_seen"});
  std::vector<Skeleton> last;
  for (std::size_t i = 0; i < set.windows->size(); ++i) {
    const std::vector<Skeleton> people = in_room(model_to_room, set.windows->people(i));
    const auto room = means.root_of_room.find(set.rooms[i]);
    const Skeleton at_room =
        room == means.root_of_room.end() ? means.absolute : moved(means.about_root, room->second);
    std::vector<Skeleton> at_roots, facing;
    for (const Skeleton& person : people) {
      at_roots.push_back(moved(means.about_root, root_of(person)));
      facing.push_back(moved(turned(means.facing, right_of_rad(person)), root_of(person)));
    }
    if (i == 0 || set.windows->clip(i) != set.windows->clip(i - 1)) last.clear();
    add(trivial[0], std::vector<Skeleton>(people.size(), means.absolute), people);
    add(trivial[1], std::vector<Skeleton>(people.size(), at_room), people);
    add(trivial[2], at_roots, people);
    add(trivial[3], facing, people);
    add(trivial[4], last, people);
    if (!last_seen.empty()) {
      const auto seen = last_seen.find(set.windows->clip_name(i));
      add(trivial.back(), seen == last_seen.end() ? std::vector<Skeleton>() : seen->second, people);
    }
    last = people;
  }
  return trivial;
}

}  // namespace csipose::train
