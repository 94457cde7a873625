#include "daemon/inspect.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>

#include "capture/scale.h"
#include "daemon/inspect_words.h"
#include "proto/intel5300.h"

namespace csipose {
namespace {

constexpr double kGapFactor = 2.5;  // a step longer than so many usual ones is a gap
constexpr std::size_t kStillRecords = 8;
constexpr std::int8_t kUnknownNoise = -127;

/// The NIC's clock: steps between records, told apart into ordinary ones, wraps, gaps and steps back.
class ClockInspector {
 public:
  void add(std::uint32_t timestamp_us) { timestamps_us_.push_back(timestamp_us); }

  ClockReport report() const {
    ClockReport report;
    std::vector<std::int64_t> steps_us;
    std::size_t still = 1;
    for (std::size_t i = 1; i < timestamps_us_.size(); ++i) {
      // The nearest difference modulo 2^32: a wrap is a step forward.
      steps_us.push_back(static_cast<std::int32_t>(timestamps_us_[i] - timestamps_us_[i - 1]));
      report.wraps += steps_us.back() > 0 && timestamps_us_[i] < timestamps_us_[i - 1];
      still = steps_us.back() == 0 ? still + 1 : 1;
      report.stands_still |= still >= kStillRecords;
    }
    if (steps_us.empty()) return report;
    report.median_step_s = 1e-6 * static_cast<double>(median(steps_us));
    sort_out(steps_us, report);
    return report;
  }

 private:
  static std::int64_t median(std::vector<std::int64_t> values) {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  }
  static void sort_out(const std::vector<std::int64_t>& steps_us, ClockReport& report) {
    for (std::size_t i = 0; i < steps_us.size(); ++i) {
      const double step_s = 1e-6 * static_cast<double>(steps_us[i]);
      if (step_s < 0) {
        report.steps_back.push_back({i + 1, -step_s});
        continue;
      }
      report.duration_s += step_s;
      if (report.median_step_s > 0 && step_s > kGapFactor * report.median_step_s)
        report.gaps.push_back({i + 1, step_s});
    }
  }

  std::vector<std::uint32_t> timestamps_us_;
};

/// The driver's 16-bit counter.
class DriverCountInspector {
 public:
  void add(std::uint16_t count) {
    if (last_) judge(static_cast<std::uint16_t>(count - *last_), count < *last_);
    last_ = count;
  }
  const DriverCountReport& report() const { return report_; }

 private:
  void judge(std::uint16_t step, bool is_lower) {
    constexpr std::uint16_t kHalf = 1 << 15;
    if (step == 0) {
      ++report_.repeated;
    } else if (step >= kHalf) {
      ++report_.steps_back;
    } else {
      report_.wraps += is_lower;
      report_.gaps += step > 1;
      report_.lost += step - 1u;
    }
  }
  std::optional<std::uint16_t> last_;
  DriverCountReport report_;
};

/// Received frames: whether they are whole, have CSI, and what their counters say.
class FrameInspector {
 public:
  void add(ByteView frame) {
    ++report_.records;
    report_.without_csi += waiting_;
    waiting_ = true;
    frame_.assign(frame.begin(), frame.end());
    const Result<Mpdu, MpduFault> mpdu = parse_mpdu(frame_);
    report_.too_short += !mpdu && mpdu.error() == MpduFault::too_short;
    report_.bad_fcs += !mpdu && mpdu.error() == MpduFault::bad_fcs;
  }
  /// The CSI of the last frame has come.
  void add_csi() {
    if (!waiting_) return;
    waiting_ = false;
    const Result<Mpdu, MpduFault> mpdu = parse_mpdu(frame_);
    if (!mpdu) return;
    if (const auto counter = counters_.recover(*mpdu)) count(*counter);
  }
  FrameReport report() const {
    FrameReport report = report_;
    report.method = counters_.method();
    report.without_csi += waiting_;
    return report;
  }

 private:
  void count(const TxCounter& counter) {
    if (report_.counted++ == 0)
      report_.first = counter.value;
    else
      judge(counter);
    report_.last = counter.value;
  }
  void judge(const TxCounter& counter) {
    std::uint64_t step = counter.value - report_.last;
    if (counter.modulus != 0) step = (counter.value + counter.modulus - report_.last) % counter.modulus;
    const std::uint64_t half = counter.modulus != 0 ? counter.modulus / 2 : std::uint64_t{1} << 63;
    if (step == 0)
      ++report_.repeated;
    else if (step > half)
      ++report_.backward;
    else
      report_.missing += step - 1;
  }

  FrameReport report_;
  CounterRecovery counters_{CounterMethod::automatic};
  std::vector<std::uint8_t> frame_;  // a copy: its CSI may come in a later packet of a recording
  bool waiting_ = false;
};

std::string permutation_word(const CsiRecord& record) {
  if (!record.perm_valid) return "?";
  std::string word;
  for (std::size_t j = 0; j < record.nrx; ++j) word += static_cast<char>('A' + record.perm[j]);
  return word;
}

std::string rate_word(std::uint16_t rate) {
  const RateFields fields = rate_fields(rate);
  if (!fields.ht) return fmt::format("legacy rate 0x{:04x}", rate);
  return fmt::format("MCS {}, {} MHz{}", fields.mcs, fields.is_40mhz ? 40 : 20,
                     fields.short_guard ? ", short guard" : "");
}

/// All of one receiver.
class ReceiverInspector {
 public:
  explicit ReceiverInspector(std::string name) { report_.name = std::move(name); }

  void add(const RawRecord& raw) {
    if (raw.code == kFrameCode) frames_.add(raw.body);
    if (raw.code != kCsiCode) return;
    CsiRecord record;
    const std::optional<RecordFault> refusal = decode_bfee(raw.body, record);
    count_decoded(content_, refusal, record);
    frames_.add_csi();
    if (!refusal) add(record);
  }

  ReceiverReport finish(const LogCounts& log) {
    report_.log = log;
    for (std::size_t i = 0; i < content_.faults.size(); ++i)
      report_.log.records.faults[i] += content_.faults[i];
    report_.clock = clock_.report();
    report_.driver = driver_.report();
    report_.frames = frames_.report();
    report_.anomalies = anomalies(report_);
    return report_;
  }

 private:
  void add(const CsiRecord& record) {
    ++report_.records;
    report_.usable += record.usable();
    ++report_.sizes[fmt::format("{}x{}", record.nrx, record.ntx)];
    ++report_.permutations[permutation_word(record)];
    ++report_.rates[rate_word(record.rate)];
    report_.wide += record.is_40mhz();
    clock_.add(record.timestamp_low);
    driver_.add(record.bfee_count);
    add_power(record);
    add_entries(record);
  }
  void add_power(const CsiRecord& record) {
    for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
      if (record.rssi[antenna] != 0) report_.rssi_db[antenna].add(record.rssi[antenna]);
    if (const auto rss = total_rss_dbm(record)) report_.rss_dbm.add(*rss);
    report_.agc_db.add(record.agc_db);
    if (record.noise_dbm == kUnknownNoise)
      ++report_.noise_unknown;
    else
      report_.noise_dbm.add(record.noise_dbm);
  }
  void add_entries(const CsiRecord& record) {
    bool saturated = false;
    for (std::size_t j = 0; j < record.nrx; ++j) {
      const std::size_t antenna = record.perm_valid ? record.perm[j] : j;
      report_.entries[antenna] += kSubcarriers * record.ntx;
      for (std::size_t k = 0; k < kSubcarriers; ++k)
        for (std::size_t s = 0; s < record.ntx; ++s) {
          const std::int8_t* entry = &record.csi[CsiRecord::index(k, antenna, s)];
          report_.zero_entries[antenna] += entry[0] == 0 && entry[1] == 0;
          saturated |= std::max(std::abs(entry[0]), std::abs(entry[1])) >= 127;
        }
    }
    report_.saturated += saturated;
  }

  ReceiverReport report_;
  RecordCounts content_;
  ClockInspector clock_;
  DriverCountInspector driver_;
  FrameInspector frames_;
};

}  // namespace

void Range::add(double value) {
  least = std::min(least, value);
  greatest = std::max(greatest, value);
  sum += value;
  ++count;
}

std::uint64_t Inspection::records() const {
  std::uint64_t sum = 0;
  for (const ReceiverReport& receiver : receivers) sum += receiver.records;
  return sum;
}

std::uint64_t Inspection::usable() const {
  std::uint64_t sum = 0;
  for (const ReceiverReport& receiver : receivers) sum += receiver.usable;
  return sum;
}

RecordCounts Inspection::counts() const {
  RecordCounts sum;
  for (const ReceiverReport& receiver : receivers) sum += receiver.log.records;
  return sum;
}

Inspection inspect(const std::string& path, RecordStream::Policy policy) {
  const std::unique_ptr<LogFile> file = open_log(path);
  Inspection inspection{
      .file = path, .is_recording = file->is_recording(), .bytes = file->bytes(), .receivers = {}};
  const std::vector<std::string> names = file->receivers();
  for (std::size_t i = 0; i < names.size(); ++i) {
    ReceiverInspector inspector(names[i]);
    const LogCounts log =
        file->for_each(i, policy, [&](const LogRecord& record) { inspector.add(record.raw); });
    inspection.receivers.push_back(inspector.finish(log));
  }
  return inspection;
}

}  // namespace csipose
