#include "capture/agent/dat_player.h"

#include <algorithm>
#include <cassert>
#include <cstring>
#include <optional>

#include "proto/frame_record.h"
#include "proto/result.h"

namespace csipose {
namespace {

constexpr std::size_t kTimestampAt = 0, kBfeeCountAt = 4;  // in a 0xBB body
constexpr std::size_t kCounterAt = kDataHeaderBytes + 8;   // in a CSIP frame

std::optional<std::uint64_t> csip_counter(const RawRecord& frame) {
  if (frame.code == 0 || frame.body.size() < kDataHeaderBytes + kCsipBodyBytes + kFcsBytes)
    return std::nullopt;
  if (std::memcmp(frame.body.data() + kDataHeaderBytes, "CSIP", 4) != 0) return std::nullopt;
  return load_le<std::uint64_t>(frame.body.data() + kCounterAt);
}

}  // namespace

DatPlayer::DatPlayer(const std::string& path, const PlayOptions& options)
    : options_(options), file_(path, DatOptions{options.rate_hz, false}) {
  plan();
  if (plan_.empty()) throw SetupError(ExitStatus::bad_data, path + " holds no CSI record to play");
}

void DatPlayer::plan() {
  std::optional<std::uint64_t> first;
  for (std::size_t i = 0; i < file_.packets().size(); ++i) {
    const DatPacket& packet = file_.packets()[i];
    if (packet.csi.code == 0) continue;
    const auto counter = csip_counter(packet.frame);
    if (plan_.empty()) first = counter;
    has_csip_ = first.has_value();
    const bool counted = counter && first && *counter >= *first;
    plan_.push_back({i,
                     counted         ? *counter - *first
                     : plan_.empty() ? 0
                                     : plan_.back().number + 1,
                     packet.arrival_ns});
  }
  if (plan_.empty()) return;
  const std::int64_t origin_ns = plan_.front().at_ns;
  for (Planned& planned : plan_)
    planned.at_ns =
        options_.rate_hz > 0
            ? static_cast<std::int64_t>(1e9 * static_cast<double>(planned.number) / options_.rate_hz)
            : planned.at_ns - origin_ns;
  span_ = plan_.back().number + 1;
  period_ = options_.rate_hz > 0
                ? Nanoseconds(static_cast<std::int64_t>(1e9 * static_cast<double>(span_) / options_.rate_hz))
                : file_.period();
  period_ = std::max(period_, Nanoseconds(plan_.back().at_ns + 1));
}

void DatPlayer::start(SteadyTime now) {
  start_ = now;
  round_ = 0;
  next_ = 0;
  if (!options_.loop) return;
  round_ = static_cast<std::uint64_t>(ns(now) / ns(period_));
  start_ = SteadyTime(period_ * static_cast<std::int64_t>(round_));
  while (next_ < plan_.size() && next_at() < now) ++next_;
  if (next_ == plan_.size()) next_ = 0, ++round_, start_ += period_;
}

SteadyTime DatPlayer::next_at() const {
  assert(!ended());
  return start_ + Nanoseconds(plan_[next_].at_ns);
}

ByteView DatPlayer::take() {
  const Planned& planned = plan_[next_];
  records_.clear();
  append_frame(planned);
  append_csi(planned);
  if (++next_ == plan_.size() && options_.loop) next_ = 0, ++round_, start_ += period_;
  return records_;
}

void DatPlayer::append_frame(const Planned& planned) {
  const RawRecord& frame = file_.packets()[planned.packet].frame;
  if (options_.loop || (options_.inject_counter && !has_csip_)) {
    const auto at_ns = static_cast<std::uint64_t>(ns(next_at()));
    const auto record = encode_csip_record({1, round_number() + planned.number, at_ns});
    records_.insert(records_.end(), record.begin(), record.end());
  } else if (frame.code != 0) {
    records_.insert(records_.end(), frame.framed().begin(), frame.framed().end());
  }
}

void DatPlayer::append_csi(const Planned& planned) {
  const ByteView csi = file_.packets()[planned.packet].csi.framed();
  const std::size_t body = records_.size() + kRecordHeaderBytes;
  records_.insert(records_.end(), csi.begin(), csi.end());
  if (csi.size() < kRecordHeaderBytes + kBfeeCountAt + 2) return;
  if (options_.loop || options_.rate_hz > 0)
    store_le<std::uint32_t>(records_.data() + body + kTimestampAt,
                            static_cast<std::uint32_t>(ns(next_at()) / 1000));
  if (options_.loop)
    store_le<std::uint16_t>(records_.data() + body + kBfeeCountAt,
                            static_cast<std::uint16_t>(round_ * plan_.size() + next_));
}

}  // namespace csipose
