#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "daemon/inspect_words.h"

namespace csipose {
namespace {

using Json = nlohmann::ordered_json;

Json range_json(const Range& range) {
  if (range.count == 0) return nullptr;
  return {
      {"count", range.count}, {"least", range.least}, {"mean", range.mean()}, {"greatest", range.greatest}};
}

Json errors_json(const RecordCounts& counts) {
  Json errors = Json::object();
  for (std::size_t i = 0; i < kRecordFaults; ++i)
    if (counts.faults[i] != 0) errors[name(static_cast<RecordFault>(i))] = counts.faults[i];
  return errors;
}

Json other_codes_json(const RecordCounts& counts) {
  Json codes = Json::object();
  for (std::size_t code = 0; code < counts.codes.size(); ++code)
    if (code != kCsiCode && counts.codes[code] != 0)
      codes[fmt::format("0x{:02x}", code)] = counts.codes[code];
  return codes;
}

Json gaps_json(const std::vector<ClockGap>& gaps) {
  Json list = Json::array();
  for (const ClockGap& gap : gaps) list.push_back({{"record", gap.record}, {"length_s", gap.length_s}});
  return list;
}

Json clock_json(const ClockReport& clock) {
  return {{"stands_still", clock.stands_still},
          {"median_step_s", clock.median_step_s},
          {"duration_s", clock.duration_s},
          {"wraps", clock.wraps},
          {"steps_back", gaps_json(clock.steps_back)},
          {"gaps", gaps_json(clock.gaps)}};
}

Json driver_json(const DriverCountReport& driver) {
  return {{"lost", driver.lost},
          {"gaps", driver.gaps},
          {"repeated", driver.repeated},
          {"steps_back", driver.steps_back},
          {"wraps", driver.wraps}};
}

Json frames_json(const FrameReport& frames) {
  Json json = {{"records", frames.records},
               {"too_short", frames.too_short},
               {"bad_fcs", frames.bad_fcs},
               {"without_csi", frames.without_csi},
               {"counted", frames.counted}};
  if (frames.counted == 0) return json;
  json["method"] = name(frames.method);
  json["first"] = frames.first;
  json["last"] = frames.last;
  json["missing"] = frames.missing;
  json["repeated"] = frames.repeated;
  json["backward"] = frames.backward;
  return json;
}

Json antennas_json(const ReceiverReport& receiver) {
  Json antennas = Json::array();
  for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
    antennas.push_back({{"name", std::string(1, static_cast<char>('A' + antenna))},
                        {"rssi_db", range_json(receiver.rssi_db[antenna])},
                        {"entries", receiver.entries[antenna]},
                        {"zero_entries", receiver.zero_entries[antenna]}});
  return antennas;
}

Json receiver_json(const ReceiverReport& receiver) {
  return {{"name", receiver.name},
          {"records", receiver.records},
          {"usable", receiver.usable},
          {"errors", errors_json(receiver.log.records)},
          {"other_codes", other_codes_json(receiver.log.records)},
          {"sizes", receiver.sizes},
          {"permutations", receiver.permutations},
          {"rates", receiver.rates},
          {"records_40mhz", receiver.wide},
          {"antennas", antennas_json(receiver)},
          {"rss_dbm", range_json(receiver.rss_dbm)},
          {"agc_db", range_json(receiver.agc_db)},
          {"noise_dbm", range_json(receiver.noise_dbm)},
          {"noise_unknown", receiver.noise_unknown},
          {"saturated", receiver.saturated},
          {"clock", clock_json(receiver.clock)},
          {"bfee_count", driver_json(receiver.driver)},
          {"frames", frames_json(receiver.frames)},
          {"cut", receiver.log.is_cut},
          {"bad_chunks", receiver.log.bad_chunks},
          {"anomalies", receiver.anomalies}};
}

}  // namespace

std::string to_json(const Inspection& inspection) {
  Json receivers = Json::array();
  for (const ReceiverReport& receiver : inspection.receivers) receivers.push_back(receiver_json(receiver));
  const Json json = {{"file", inspection.file},
                     {"kind", inspection.is_recording ? "mcap" : "dat"},
                     {"bytes", inspection.bytes},
                     {"records", inspection.records()},
                     {"usable", inspection.usable()},
                     {"errors", errors_json(inspection.counts())},
                     {"other_codes", other_codes_json(inspection.counts())},
                     {"receivers", receivers}};
  // File names are bytes: what is not UTF-8 is shown as such, not thrown at.
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace csipose
