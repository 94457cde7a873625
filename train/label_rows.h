// train/label_rows.h - people as rows of numbers: [P][14][3] metres, not a number where nobody is.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "proto/pose.h"

namespace csipose::train {

/// The people of a row; nullopt where one has only some of their joints.
std::optional<std::vector<Skeleton>> people_of_row(std::span<const float> row);
/// Appends a row of `room_for` people, of whom the first are `people`.
void append_row(std::span<const Skeleton> people, std::size_t room_for, std::vector<float>& rows);

}  // namespace csipose::train
