#include "daemon/metrics.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>

#include "proto/result.h"
#include "tests/daemon/pose_frames.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

std::string page() { return prometheus_text(testing::busy_status(), {}); }

bool has_line(const std::string& text, const std::string& line) {
  return ("\n" + text).find("\n" + line + "\n") != std::string::npos;
}

TEST(Metrics, SaysWhatTheStatusSays) {
  const std::string text = page();
  EXPECT_TRUE(has_line(text, "csiposed_frames_published_total 1234"));
  EXPECT_TRUE(has_line(text, "csiposed_state{state=\"degraded\"} 1"));
  EXPECT_TRUE(has_line(text, "csiposed_state{state=\"tracking\"} 0"));
  EXPECT_TRUE(has_line(text, "csiposed_windows_total{result=\"gap\"} 34"));
  EXPECT_TRUE(has_line(text, "csiposed_rx_rejected_total{rx=\"rx2\",reason=\"forged\"} 12"));
  EXPECT_TRUE(has_line(text, "csiposed_rx_rate_hertz{rx=\"rx2\"} 299.5"));
  EXPECT_TRUE(has_line(text, "csiposed_rx_rssi_dbm{rx=\"rx1\",antenna=\"A\"} NaN"));
  EXPECT_TRUE(has_line(text, "csiposed_stage_duration_seconds_bucket{stage=\"infer\",le=\"0.001\"} 1"));
  EXPECT_TRUE(has_line(text, "csiposed_stage_duration_seconds_bucket{stage=\"infer\",le=\"0.015\"} 2"));
  EXPECT_TRUE(has_line(text, "csiposed_stage_duration_seconds_bucket{stage=\"infer\",le=\"+Inf\"} 3"));
  EXPECT_TRUE(has_line(text, "csiposed_stage_duration_seconds_sum{stage=\"infer\"} 0.0339"));
  EXPECT_TRUE(has_line(text, "csiposed_stage_duration_seconds_count{stage=\"infer\"} 3"));
}

// The exposition format as its grammar has it: each sample belongs to the metric described last, each metric
// once.
TEST(Metrics, IsWellFormed) {
  const std::regex sample(R"re(([a-z_]+)(\{([a-z0-9_]+="([^"\\]|\\.)*",?)+\})? (NaN|[-+.e0-9]+))re");
  std::istringstream text(page());
  std::set<std::string> described;
  std::string metric;
  for (std::string line; std::getline(text, line);) {
    if (line.rfind("# HELP ", 0) == 0) {
      metric = line.substr(7, line.find(' ', 7) - 7);
      EXPECT_TRUE(described.insert(metric).second) << metric;
    } else if (line.rfind("# TYPE ", 0) != 0) {
      std::smatch match;
      EXPECT_TRUE(std::regex_match(line, match, sample)) << line;
      EXPECT_EQ(match[1].str().rfind(metric, 0), 0U) << line;
    }
  }
  EXPECT_GT(described.size(), 25U);
}

TEST(Metrics, EscapesLabels) {
  Status status = testing::busy_status();
  status.version = "a\"b\\c\nd";
  EXPECT_NE(prometheus_text(status, {}).find(R"(version="a\"b\\c d")"), std::string::npos);
}

TEST(Metrics, ProcessUsesSomething) {
  const ProcessUse use = process_use();
  EXPECT_GT(use.resident_bytes, 100'000U);
  EXPECT_GE(use.virtual_bytes, use.resident_bytes);
  EXPECT_GE(use.open_fds, 3U);
  EXPECT_GT(use.start_time_seconds, 1.6e9);
}

TEST(Metrics, FileIsReplacedWhole) {
  testing::ScratchFolder folder;
  const std::string path = folder / "csiposed.prom";
  write_metrics_file(path, "old\n");
  write_metrics_file(path, "new\n");
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  EXPECT_EQ(line, "new");
  EXPECT_FALSE(std::filesystem::exists(path + ".new"));
  EXPECT_THROW(write_metrics_file(folder / "none/csiposed.prom", "x"), SetupError);
}

}  // namespace
}  // namespace csipose
