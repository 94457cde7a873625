#include "model/assignment.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace csipose {

Assignment::Assignment(std::size_t max_rows, std::size_t max_cols) {
  const std::size_t small = std::min(max_rows, max_cols) + 1, large = std::max(max_rows, max_cols) + 1;
  small_price_.reserve(small);
  large_price_.reserve(large);
  slack_.reserve(large);
  owner_.reserve(large);
  came_from_.reserve(large);
  reached_.reserve(large);
  column_of_row_.reserve(large);
}

std::span<const std::size_t> Assignment::solve(std::span<const double> cost, std::size_t rows,
                                               std::size_t cols) {
  assert(cost.size() == rows * cols && std::max(rows, cols) < large_price_.capacity() &&
         std::min(rows, cols) < small_price_.capacity());
  assert(std::all_of(cost.begin(), cost.end(), [](double value) { return std::isfinite(value); }));
  cost_ = cost;
  transposed_ = rows > cols;
  small_ = std::min(rows, cols);
  large_ = std::max(rows, cols);
  small_price_.assign(small_ + 1, 0);
  large_price_.assign(large_ + 1, 0);
  owner_.assign(large_ + 1, 0);
  came_from_.assign(large_ + 1, 0);
  for (std::size_t i = 1; i <= small_; ++i) assign(i);
  column_of_row_.assign(rows, kUnassigned);
  for (std::size_t j = 1; j <= large_; ++j)
    if (owner_[j] != 0)
      (transposed_ ? column_of_row_[j - 1] : column_of_row_[owner_[j] - 1]) =
          (transposed_ ? owner_[j] : j) - 1;
  return column_of_row_;
}

double Assignment::cost(std::size_t small, std::size_t large) const {
  return transposed_ ? cost_[(large - 1) * small_ + (small - 1)] : cost_[(small - 1) * large_ + (large - 1)];
}

/// Finds the cheapest chain of exchanges that gives `small` a partner, and makes them.
void Assignment::assign(std::size_t small) {
  slack_.assign(large_ + 1, std::numeric_limits<double>::infinity());
  reached_.assign(large_ + 1, 0);
  owner_[0] = small;
  std::size_t column = 0;
  while (owner_[column] != 0) column = extend(column);
  for (; column != 0; column = came_from_[column]) owner_[column] = owner_[came_from_[column]];
}

/// One step of Dijkstra over reduced costs: from the owner of `column` to the nearest column not reached yet.
std::size_t Assignment::extend(std::size_t column) {
  reached_[column] = 1;
  const std::size_t small = owner_[column];
  std::size_t nearest = 0;
  for (std::size_t j = 1; j <= large_; ++j) {
    if (reached_[j]) continue;
    const double reduced = cost(small, j) - small_price_[small] - large_price_[j];
    if (reduced < slack_[j]) slack_[j] = reduced, came_from_[j] = column;
    if (nearest == 0 || slack_[j] < slack_[nearest]) nearest = j;
  }
  const double step = slack_[nearest];
  for (std::size_t j = 0; j <= large_; ++j) {
    if (reached_[j])
      small_price_[owner_[j]] += step, large_price_[j] -= step;
    else
      slack_[j] -= step;
  }
  return nearest;
}

}  // namespace csipose
