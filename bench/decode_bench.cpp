// Records a second, stage by stage: decode_bench [LOG.dat] [google-benchmark's options]. Without a log it makes one of
// 3,000 records, 3 chains and 1 stream, each after its frame. bench/decode runs it beside csiread.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "capture/features.h"
#include "capture/tx_counter.h"
#include "proto/frame_record.h"
#include "proto/intel5300.h"

namespace csipose {
namespace {

std::string log_path;
std::vector<std::uint8_t> made_log;

std::vector<std::uint8_t> make_log() {
  std::mt19937 random(1);
  std::vector<std::uint8_t> bytes;
  for (std::uint64_t i = 0; i < 3000; ++i) {
    const auto frame = encode_csip_record({.session = 1, .counter = i, .transmit_ns = 0});
    bytes.insert(bytes.end(), frame.begin(), frame.end());
    CsiRecord record;
    record.nrx = 3, record.ntx = 1, record.antenna_sel = i % 2 == 0 ? 0x18 : 0x24, record.rssi = {36, 23, 20};
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
        for (std::size_t part = 0; part < 2; ++part)
          record.csi[CsiRecord::index(k, antenna, 0) + part] = static_cast<std::int8_t>(random());
    append_bfee_record(record, bytes);
  }
  return bytes;
}

void read_log(std::vector<std::uint8_t>& bytes) {
  if (log_path.empty()) {
    bytes = made_log;
    return;
  }
  std::FILE* file = std::fopen(log_path.c_str(), "rb");
  if (file == nullptr) return;
  bytes.resize(std::filesystem::file_size(log_path));
  bytes.resize(std::fread(bytes.data(), 1, bytes.size(), file));
  std::fclose(file);
}
std::vector<std::uint8_t> read_log() {
  std::vector<std::uint8_t> bytes;
  read_log(bytes);
  return bytes;
}

template <class Use>
std::size_t for_each_csi(ByteView bytes, Use use) {
  RecordStream stream(bytes, RecordStream::Policy::resynchronising);
  std::size_t records = 0;
  CsiRecord record;
  while (const auto raw = stream.next())
    if (raw->code == kCsiCode && !decode_bfee(raw->body, record)) use(record), ++records;
  return records;
}

/// One pass over the whole log per iteration; `use` sees each record.
template <class Use>
void run(benchmark::State& state, Use use) {
  const std::vector<std::uint8_t> bytes = read_log();
  std::size_t records = 0;
  for (auto _ : state) records += for_each_csi(bytes, use);
  state.SetItemsProcessed(static_cast<std::int64_t>(records));
}

void decode(benchmark::State& state) {
  run(state, [](const CsiRecord& record) { benchmark::DoNotOptimize(record.csi.data()); });
}
void decode_and_scale(benchmark::State& state) {
  std::array<std::complex<float>, kCsiRows * kMaxStreams> h;
  run(state, [&h](const CsiRecord& record) {
    benchmark::DoNotOptimize(scale_csi(record, {h.data(), kCsiRows * record.ntx}));
  });
}
void decode_and_features(benchmark::State& state) {
  Features features;
  run(state, [&](const CsiRecord& record) {
    if (record.usable()) benchmark::DoNotOptimize(extract_features(record, {}, features));
  });
}

/// What csiread's Intel.read() does, and its get_scaled_csi() after it: the file is opened and read, and every
/// record and scaled matrix is kept. Room is made beforehand, as by csiread's constructor, which is told the sizes.
struct Kept {
  std::vector<std::uint8_t> file;
  std::vector<CsiRecord> records;
  std::vector<std::complex<float>> scaled;  // [record][30][3][T]
  std::size_t streams = 0;                  // T

  Kept() {
    read_log(file);
    std::size_t bodies = 0;
    RecordStream stream(file, RecordStream::Policy::resynchronising);
    while (const auto raw = stream.next()) {
      if (raw->code != kCsiCode || raw->body.size() < kBfeeHeaderBytes) continue;
      ++bodies;
      streams = std::clamp<std::size_t>(raw->body[9], streams, kMaxStreams);
    }
    records.resize(bodies);
    scaled.resize(bodies * kCsiRows * streams);
  }
  std::size_t read(bool with_scale) {
    read_log(file);
    const std::size_t size = kCsiRows * streams;
    std::size_t n = 0;
    RecordStream stream(file, RecordStream::Policy::resynchronising);
    while (const auto raw = stream.next()) {
      if (raw->code != kCsiCode || decode_bfee(raw->body, records[n])) continue;
      if (with_scale) scale_csi(records[n], {scaled.data() + n * size, size});
      ++n;
    }
    return n;
  }
};
void read_file(benchmark::State& state, bool with_scale) {
  Kept kept;
  std::size_t records = 0;
  for (auto _ : state) records += kept.read(with_scale);
  state.SetItemsProcessed(static_cast<std::int64_t>(records));
}
void file_to_records(benchmark::State& state) { read_file(state, false); }
void file_to_scaled(benchmark::State& state) { read_file(state, true); }

void recover_counters(benchmark::State& state) {
  const std::vector<std::uint8_t> bytes = read_log();
  CounterRecovery counters(CounterMethod::automatic);
  std::int64_t frames = 0;
  for (auto _ : state) {
    RecordStream stream(bytes, RecordStream::Policy::strict);
    while (const auto raw = stream.next()) {
      if (raw->code != kFrameCode) continue;
      if (const auto mpdu = parse_mpdu(raw->body)) benchmark::DoNotOptimize(counters.recover(*mpdu));
      ++frames;
    }
  }
  state.SetItemsProcessed(frames);
}

BENCHMARK(decode);
BENCHMARK(decode_and_scale);
BENCHMARK(decode_and_features);
BENCHMARK(recover_counters);
BENCHMARK(file_to_records);
BENCHMARK(file_to_scaled);

}  // namespace
}  // namespace csipose

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (argc > 1) csipose::log_path = argv[1];
  if (csipose::log_path.empty()) csipose::made_log = csipose::make_log();
  if (csipose::read_log().empty()) return 66;
  benchmark::RunSpecifiedBenchmarks();
}
