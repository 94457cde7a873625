// csipose-sim stats: what receivers' logs look like from afar, real or simulated.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <fstream>
#include <memory>

#include "proto/result.h"
#include "sim/commands.h"
#include "sim/log_statistics.h"

namespace csipose::sim {
namespace {

std::string read_log(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  std::string bytes{std::istreambuf_iterator<char>(in), {}};
  if (!in) throw SetupError(ExitStatus::no_input, fmt::format("cannot read {}; is the name right?", file));
  return bytes;
}

void row(const char* what, const Spread& spread, const char* unit) {
  fmt::print("  {:34} {:8.2f} +- {:6.2f}   {:8.2f} .. {:8.2f} {}\n", what, spread.mean, spread.deviation,
             spread.low, spread.high, unit);
}
void row(const char* what, double value, const char* unit) {
  fmt::print("  {:34} {:8.3f} {}\n", what, value, unit);
}

void print(const std::string& file) {
  const LogStatistics s = log_statistics(read_log(file), file);
  fmt::print("{}: {} usable records; mean +- deviation, 5th .. 95th hundredth\n", file, s.records);
  row("amplitude of an entry", s.amplitude, "counts");
  row("power of a matrix", s.csi_power_db, "dB");
  row("delay by the phase's slope", s.delay_ns, "ns");
  row("its median step", s.median_delay_step_ns, "ns");
  row("carrier phase, concentration", s.carrier_concentration, "");
  row("phase from A to B, concentration", s.antenna_concentration, "");
  row("AGC", s.agc_db, "dB");
  row("RSSI of an antenna", s.rssi_db, "dB");
  row("received power", s.received_dbm, "dBm");
  if (!std::isnan(s.agc_rssi_correlation)) row("correlation of AGC and power", s.agc_rssi_correlation, "");
  row("step between records", s.step_ms, "ms");
  row("missing of the median's grid", 100 * s.missing_share, "%");
}

}  // namespace

void add_stats(CLI::App& app) {
  auto files = std::make_shared<std::vector<std::string>>();
  CLI::App* command =
      app.add_subcommand("stats", "statistics of csitool logs, real or simulated, to compare them");
  command->add_option("logs", *files, "csitool .dat logs")->required();
  command->callback([files] {
    for (const std::string& file : *files) print(file);
  });
}

}  // namespace csipose::sim
