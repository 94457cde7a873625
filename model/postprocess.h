// model/postprocess.h - from the network's raw answer to people: scores, threshold, pose-NMS, room frame,
// confidences.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "model/engine.h"
#include "model/model.h"
#include "proto/pose.h"

namespace csipose {

/// A joint's confidence is the probability of an error under this.
inline constexpr float kConfidentError_m = 0.15f;

/// Probability that a query is a person: sigmoid of the logit, or its Platt scaling where the model has one.
float person_score(float logit, const Calibration& calibration);
/// Expected error of a joint, metres: the head's sigma times the joint's factor where the model has one.
float expected_error_m(float sigma_m, std::size_t joint, const Calibration& calibration);
/// Probability of an error under kConfidentError_m when errors fall off exponentially with mean `expected_m`, then
/// corrected by the model's curve where it has one (linear between knots, constant outside).
float joint_confidence(float expected_m, const Calibration& calibration);
/// A point of the label frame in the room.
Point3 to_room(const RoomTransform& model_to_room, const float* label_xyz_m);

struct Selection {
  std::size_t max_people = 5;
  float min_score = 0.5f;
  float nms_distance_m = 0.25f;
};

struct Selected {
  std::size_t count = 0;
  bool not_finite =
      false;  ///< some score or joint was not finite: the answer as a whole is not to be trusted
  std::array<std::size_t, kMaxPeople> query{};  ///< whose pose each of the people is
};
/// Writes the people of a window, best first: score at least min_score; of two poses nearer than
/// nms_distance_m the better one (among equal scores the earlier query); at most max_people, people.size()
/// and kMaxPeople. id and age stay 0, joints_raw equals joints, confidence and sigma_m are NaN without a
/// sigma head. No allocation.
Selected select_people(const NetworkOutput& output, const Model& model, const Selection& selection,
                       std::span<Person> people);

}  // namespace csipose
