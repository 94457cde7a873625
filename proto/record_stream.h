// proto/record_stream.h - csitool's log stream cut into records, and the closed list of what can be wrong
// with them.
//
//   +--------+--------+------+---------------------+
//   | length (BE, 16) | code | body, length-1 bytes |   and so on; no file header, no padding, no checksum
//   +--------+--------+------+---------------------+
//
// length counts the code byte and the body, not itself. A log on disk, csitool's TCP stream and the records
// inside our own datagrams and recordings all look like this. C++17, because the receiver's agent reads it
// too. Source: linux-80211n-csitool-supplementary, netlink/log_to_file.c. Not here: what a body means
// (intel5300.h for 0xBB, capture/mpdu.h for 0xC1).
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "proto/bytes.h"

namespace csipose {

inline constexpr std::uint8_t kCsiCode = 0xBB;  ///< beamforming notification: one CSI matrix
inline constexpr std::uint8_t kFrameCode =
    0xC1;  ///< the received 802.11 frame, before the CSI of the same frame
inline constexpr std::size_t kRecordHeaderBytes = 3;

/// What was met in a stream of records. A closed list; whoever reads a stream keeps one counter per value.
enum class RecordFault : std::uint8_t {
  // Framing: found by RecordStream.
  leftover,      ///< fewer than 3 bytes remain
  zero_length,   ///< a length of 0
  truncated,     ///< the record passes the end
  lost_framing,  ///< an unknown code that leads to nothing that could be a record
  // Content: found by decode_bfee(). The record is skipped by its length, framing is kept.
  short_record,   ///< body smaller than its fixed header
  bad_dims,       ///< Nrx or Ntx outside 1..3
  bad_len,        ///< len is not 60 * Nrx * Ntx + 12
  payload_short,  ///< body ends before its payload
  // Not refusals.
  resync,         ///< framing found again after a framing fault
  perm_invalid,   ///< decoded, but nobody can say which chain is which antenna
  all_zero_csi,   ///< decoded, all zero
  all_zero_rssi,  ///< decoded, cannot be scaled
};
inline constexpr std::size_t kRecordFaults = 12;

/// The name in statistics and in `csipose inspect --json`: the enumerator's own.
const char* name(RecordFault fault);

/// How often each fault and each record code was met.
struct RecordCounts {
  std::array<std::uint64_t, kRecordFaults> faults{};
  std::array<std::uint64_t, 256> codes{};

  std::uint64_t& operator[](RecordFault fault) { return faults[static_cast<std::size_t>(fault)]; }
  std::uint64_t operator[](RecordFault fault) const { return faults[static_cast<std::size_t>(fault)]; }
  RecordCounts& operator+=(const RecordCounts& other);
};

/// One record as it lies in the stream.
struct RawRecord {
  std::uint64_t offset = 0;  ///< of its length field, from the start of the stream
  std::uint8_t code = 0;
  ByteView body;  ///< after the code

  /// Length field, code and body together.
  ByteView framed() const { return {body.data() - kRecordHeaderBytes, body.size() + kRecordHeaderBytes}; }
};

struct FramingFault {
  RecordFault fault;
  std::uint64_t offset;  ///< where the record that could not be read begins
};

/// Whether the csitool's drivers are known to log such records. Any other code is passed over by its length
/// as long as that leads to something known.
bool is_known_code(std::uint8_t code);

class RecordStream {
 public:
  enum class Policy : std::uint8_t {
    strict,  ///< a framing fault ends the stream: for reliable carriers, where it means a lying sender
    /// Search on for the next plausible CSI record: for files, which lose bytes. A damaged length costs two
    /// records at the most, unless it happens to lead, at once or through bytes that look like a record of
    /// known code, exactly to a later record or the end: nobody can tell that from padding.
    resynchronising
  };
  enum class Input : std::uint8_t {
    whole,   ///< what is given is all there is
    growing  ///< more may come: a record cut off by the end is waited for
  };

  /// `data`, the start of the stream, stays the caller's and must live until the next refill().
  RecordStream(ByteView data, Policy policy, Input input = Input::whole)
      : data_(data), policy_(policy), input_(input) {}

  /// The next whole record. nullopt: the end; or, of a growing input, nothing whole yet.
  ///   errors  at most one framing fault lies between two records: fault() tells it, counts() has counted it
  ///   cost    O(1) when framing holds, no allocation; resynchronising looks at every byte once
  std::optional<RawRecord> next();

  /// The fault that the last next() met, if any.
  const std::optional<FramingFault>& fault() const { return fault_; }
  const RecordCounts& counts() const { return counts_; }
  /// Content faults, found by whoever decodes the body, belong to the same counters.
  RecordCounts& counts() { return counts_; }
  /// A strict stream has met a framing fault: nothing more will come of it.
  bool broken() const { return broken_; }

  /// Offset of the first byte not consumed, from the start of the stream.
  std::uint64_t offset() const { return base_ + position_; }
  /// Goes on with other memory, whose first byte has stream offset `data_offset` <= offset(). Bytes before
  /// offset() may be given again: a resynchronising stream then finds in them what a damaged length has
  /// swallowed.
  void refill(ByteView data, std::uint64_t data_offset);
  /// A growing input has ended; next() then judges what is left.
  void finish() { input_ = Input::whole; }

 private:
  enum class Plausible : std::uint8_t { no, yes, not_yet };

  std::optional<RecordFault> header_fault() const;
  bool leads_on(std::size_t at) const;
  bool must_wait() const;
  /// An unknown code is not believed where a damaged length may have led to it.
  bool in_doubt() const { return policy_ == Policy::resynchronising && doubt_.has_value(); }
  Plausible plausible_csi_at(std::size_t at) const;
  std::optional<RawRecord> search();
  std::uint64_t search_start() const;
  RawRecord take();
  void note_doubt(const RawRecord& record);
  void count(RecordFault fault) { ++counts_[fault]; }

  ByteView data_;
  Policy policy_;
  Input input_;
  std::size_t position_ = 0;
  std::uint64_t base_ = 0;              ///< stream offset of data_[0]
  std::optional<std::uint64_t> doubt_;  ///< from here on records may have been swallowed by a damaged length
  bool searching_ = false, broken_ = false;
  std::optional<FramingFault> fault_;
  RecordCounts counts_;
};

}  // namespace csipose
