// model/assignment.h - which row goes with which column so that the sum of costs is least.
#pragma once

#include <cstddef>
#include <limits>
#include <span>
#include <vector>

namespace csipose {

inline constexpr std::size_t kUnassigned = std::numeric_limits<std::size_t>::max();

/// Solver with its own memory: solve() allocates nothing.
class Assignment {
 public:
  Assignment(std::size_t max_rows, std::size_t max_cols);

  /// cost   [rows][cols], row-major, finite (assert); negative is fine
  /// gives  [rows] the column of each row, kUnassigned for those that more rows than columns leave over;
  /// every
  ///        column at most once, min(rows, cols) pairs, least sum. Lives until the next call. Among several
  ///        optima always the same one.
  /// cost   O(min^2 max)
  /// source successive shortest paths with potentials: Kuhn 1955, Jonker and Volgenant 1987
  std::span<const std::size_t> solve(std::span<const double> cost, std::size_t rows, std::size_t cols);

 private:
  double cost(std::size_t small, std::size_t large) const;
  void assign(std::size_t small);
  std::size_t extend(std::size_t column);

  std::span<const double> cost_;
  std::size_t small_ = 0, large_ = 0;  // the shorter side is assigned one by one
  bool transposed_ = false;
  // Index 0 of the four below stands for "none"; real rows and columns count from 1.
  std::vector<double> small_price_, large_price_, slack_;
  std::vector<std::size_t> owner_, came_from_;
  std::vector<char> reached_;
  std::vector<std::size_t> column_of_row_;
};

}  // namespace csipose
