#include "model/assignment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numeric>
#include <random>

#include "tests/shared_data.h"

namespace csipose {
namespace {

double total(std::span<const double> cost, std::size_t cols, std::span<const std::size_t> column_of_row) {
  double sum = 0;
  for (std::size_t r = 0; r < column_of_row.size(); ++r)
    if (column_of_row[r] != kUnassigned) sum += cost[r * cols + column_of_row[r]];
  return sum;
}

void expect_one_to_one(std::span<const std::size_t> column_of_row, std::size_t cols) {
  std::vector<std::size_t> used;
  for (const std::size_t c : column_of_row)
    if (c != kUnassigned) used.push_back(c);
  EXPECT_EQ(used.size(), std::min(column_of_row.size(), cols));
  std::sort(used.begin(), used.end());
  EXPECT_EQ(std::adjacent_find(used.begin(), used.end()), used.end());
  EXPECT_TRUE(used.empty() || used.back() < cols);
}

/// The least total over all ways, tried one by one; rows <= cols.
double by_trying_all(std::span<const double> cost, std::size_t rows, std::size_t cols) {
  std::vector<std::size_t> order(cols);
  std::iota(order.begin(), order.end(), std::size_t{0});
  double best = HUGE_VAL;
  do best = std::min(best, total(cost, cols, std::span(order).first(rows)));
  while (std::next_permutation(order.begin(), order.end()));
  return best;
}

TEST(Assignment, GoldenCases) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto cases = nlohmann::json::parse(std::ifstream(testing::shared_data("model/hungarian/cases.json")));
  Assignment assignment(100, 100);
  ASSERT_GT(cases.size(), 5u);
  for (const auto& it : cases) {
    const auto cost = it["cost"].get<std::vector<double>>();
    const std::size_t rows = it["shape"][0], cols = it["shape"][1];
    const auto found = assignment.solve(cost, rows, cols);
    expect_one_to_one(found, cols);
    EXPECT_NEAR(total(cost, cols, found), it["total"].get<double>(), 1e-9) << rows << "x" << cols;
    if (!it["unique"].get<bool>()) continue;
    for (std::size_t i = 0; i < it["rows"].size(); ++i)
      EXPECT_EQ(found[it["rows"][i].get<std::size_t>()], it["cols"][i].get<std::size_t>());
  }
}

TEST(Assignment, AsGoodAsTryingAll) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-3, 3);
  Assignment assignment(7, 7);
  for (int round = 0; round < 200; ++round) {
    const std::size_t rows = 1 + random() % 6, cols = rows + random() % (7 - rows);
    std::vector<double> cost(rows * cols), transposed(rows * cols);
    for (double& c : cost)
      c = round % 2 ? uniform(random) : std::floor(uniform(random));  // the latter full of ties
    for (std::size_t r = 0; r < rows; ++r)
      for (std::size_t c = 0; c < cols; ++c) transposed[c * rows + r] = cost[r * cols + c];
    const double best = by_trying_all(cost, rows, cols);
    EXPECT_NEAR(total(cost, cols, assignment.solve(cost, rows, cols)), best, 1e-12);
    const auto tall = assignment.solve(transposed, cols, rows);
    expect_one_to_one(tall, rows);
    EXPECT_NEAR(total(transposed, rows, tall), best, 1e-12);
  }
}

TEST(Assignment, NothingToAssign) {
  Assignment assignment(3, 3);
  EXPECT_TRUE(assignment.solve({}, 0, 3).empty());
  const auto rows_only = assignment.solve({}, 3, 0);
  EXPECT_EQ(std::count(rows_only.begin(), rows_only.end(), kUnassigned), 3);
}

}  // namespace
}  // namespace csipose
