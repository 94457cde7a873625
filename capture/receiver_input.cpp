#include "capture/receiver_input.h"

#include <cmath>
#include <limits>

#include "proto/intel5300.h"

namespace csipose {

namespace {
constexpr std::size_t kMaxRecordBytes = 65536;
constexpr std::int64_t kBinNs = 100'000'000;
constexpr int kMaxReordered = 64;  // a bfee_count further back than this: the driver was loaded anew

/// Power at one antenna before the card's gain. Source: csitool-supplementary matlab/get_total_rss.m.
float rssi_dbm(std::uint8_t rssi, std::uint8_t agc_db) {
  return rssi == 0 ? std::numeric_limits<float>::quiet_NaN() : static_cast<float>(rssi - 44 - agc_db);
}

/// Puts antennas back into the order of chains, as the record was sent.
void redo_permutation(CsiRecord& record) {
  const CsiRecord original = record;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t chain = 0; chain < kAntennas; ++chain)
      for (std::size_t i = 0; i < 2 * kMaxStreams; ++i)
        record.csi[CsiRecord::index(k, chain, 0) + i] =
            original.csi[CsiRecord::index(k, original.perm[chain], 0) + i];
}
}  // namespace

void RateMeter::count(SteadyTime time) {
  const std::int64_t bin = ns(time) / kBinNs;
  const auto i = static_cast<std::size_t>(bin) % kBins;
  if (bin_[i] != bin) bin_[i] = bin, events_[i] = 0;
  ++events_[i];
}

double RateMeter::rate_hz(SteadyTime now) const {
  const std::int64_t bin = ns(now) / kBinNs;
  std::int64_t sum = 0;
  for (std::size_t i = 0; i < kBins; ++i)
    if (bin_[i] < bin && bin_[i] >= bin - kBinsPerSecond) sum += events_[i];
  return static_cast<double>(sum);
}

ReceiverInput::ReceiverInput(std::uint8_t receiver, const FrontEndConfig& config, ReceiverStats& stats)
    : receiver_(receiver),
      features_{config.phase, config.amplitude, config.stream, config.undo_40mhz_rotation},
      undo_permutation_(config.undo_permutation),
      stats_(stats),
      recovery_(config.counter),
      stream_({}, RecordStream::Policy::strict) {
  held_.reserve(kMaxRecordBytes);
}

void ReceiverInput::begin(ByteView records, SteadyTime arrival) {
  ++stats_.packets;
  arrival_ = arrival;
  stream_ = RecordStream(records, RecordStream::Policy::strict);
}

bool ReceiverInput::next(ReceivedFrame& frame) {
  while (const std::optional<RawRecord> record = stream_.next()) {
    if (record->code == kFrameCode) {
      hold_frame(record->body);
    } else if (record->code != kCsiCode) {
      drop_held_frame();
    } else if (read_csi(record->body, frame)) {
      return true;
    }
  }
  if (stream_.fault()) drop_held_frame();
  count_faults();
  return false;
}

void ReceiverInput::hold_frame(ByteView frame) {
  drop_held_frame();
  held_.assign(frame.begin(), frame.end());
  holding_ = true;
}

void ReceiverInput::drop_held_frame() {
  if (holding_) ++stats_.unpaired_frames;
  holding_ = false;
}

bool ReceiverInput::read_csi(ByteView body, ReceivedFrame& frame) {
  const std::optional<RecordFault> refusal = decode_bfee(body, record_);
  count_decoded(stream_.counts(), refusal, record_);
  if (refusal) {
    drop_held_frame();
    return false;
  }
  ++stats_.records;
  frame.counter = counter_of_held_frame();
  const int step = follow_bfee_count(record_.bfee_count);
  const std::uint32_t epoch = clock_.epoch();
  const NicClock::Reading nic = clock_.read(record_.timestamp_low, step > 0, arrival_);
  stats_.clock_epochs += clock_.epoch() - epoch;
  if (!record_.usable()) return false;

  ++stats_.usable;
  meter_.count(arrival_);
  if (!undo_permutation_) redo_permutation(record_);
  frame.repeated = step == 0;
  frame.time = {receiver_, nic, clock_.on_air(nic, arrival_), arrival_};
  frame.sample.on_air = frame.time.on_air;
  frame.sample.is_40mhz = record_.is_40mhz();
  frame.sample.finite = extract_features(record_, features_, frame.sample.features);
  for (std::size_t a = 0; a < kAntennas; ++a)
    frame.sample.rssi_dbm[a] = rssi_dbm(record_.rssi[a], record_.agc_db);
  return true;
}

std::optional<TxCounter> ReceiverInput::counter_of_held_frame() {
  if (!holding_) return std::nullopt;
  holding_ = false;
  const Result<Mpdu, MpduFault> mpdu = parse_mpdu(held_);
  if (mpdu) return recovery_.recover(*mpdu);
  if (mpdu.error() == MpduFault::bad_fcs) ++stats_.bad_fcs;
  return std::nullopt;
}

/// Counts what was lost or doubled between driver and here. Returns the step since the newest: 0 = came
/// before, below 0 = overtaken on the way.
int ReceiverInput::follow_bfee_count(std::uint16_t bfee_count) {
  const auto step = static_cast<std::int16_t>(bfee_count - bfee_count_);
  const bool afresh = !counted_ || step < -kMaxReordered;
  if (step < 0 && !afresh && stats_.lost_driver > 0) --stats_.lost_driver;  // it was only late
  if (step == 0 && !afresh) ++stats_.duplicates;
  if (step <= 0 && !afresh) return step;
  if (!afresh) stats_.lost_driver += static_cast<std::uint64_t>(step - 1);
  counted_ = true;
  bfee_count_ = bfee_count;
  return 1;
}

void ReceiverInput::count_faults() {
  static_assert(kRecordFaults <= std::tuple_size_v<decltype(ReceiverStats::faults)>);
  for (std::size_t i = 0; i < kRecordFaults; ++i) stats_.faults[i] += stream_.counts().faults[i];
}

}  // namespace csipose
