#include "train/label_rows.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace csipose::train {

std::optional<std::vector<Skeleton>> people_of_row(std::span<const float> row) {
  assert(row.size() % kPoseWidth == 0);
  std::vector<Skeleton> people;
  for (; !row.empty(); row = row.subspan(kPoseWidth)) {
    const auto xyz_m = row.first(kPoseWidth);
    const auto known =
        static_cast<std::size_t>(std::ranges::count_if(xyz_m, [](float m) { return std::isfinite(m); }));
    if (known == 0) continue;
    if (known < kPoseWidth) return std::nullopt;
    Skeleton& person = people.emplace_back();
    for (std::size_t j = 0; j < kJoints; ++j) person[j] = {xyz_m[3 * j], xyz_m[3 * j + 1], xyz_m[3 * j + 2]};
  }
  return people;
}

void append_row(std::span<const Skeleton> people, std::size_t room_for, std::vector<float>& rows) {
  assert(people.size() <= room_for);
  for (const Skeleton& person : people)
    for (const Point3& joint : person) rows.insert(rows.end(), {joint.x, joint.y, joint.z});
  rows.insert(rows.end(), (room_for - people.size()) * kPoseWidth, kUnknown);
}

}  // namespace csipose::train
