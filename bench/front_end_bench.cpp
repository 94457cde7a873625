// Packets a second through FrontEnd::add() and windows a second through FrontEnd::take(), on made-up receivers.
//
//   packet   one 0xC1 and one 0xBB record of one receiver, 3x1, counter by CSIP: decoded, sanitised and placed
//   window   20 samples of three whole receivers assembled
#include <benchmark/benchmark.h>

#include "capture/front_end.h"
#include "tests/capture/made_up_packets.h"

namespace csipose {
namespace {

std::vector<testing::StoredPacket> packets_of(double hz, bool with_counters) {
  testing::MadeUpTransmitter transmitter;
  transmitter.hz = hz;
  transmitter.frames = 3000;
  transmitter.access_jitter_us = 26;
  transmitter.frame_record =
      with_counters ? [](std::int64_t f) { return testing::csip_frame(static_cast<std::uint64_t>(f)); }
                    : testing::no_frame;
  return make_packets(transmitter, std::vector<testing::MadeUpReceiver>(3));
}

void add(benchmark::State& state, bool with_counters) {
  const auto packets = packets_of(1000, with_counters);
  std::int64_t added = 0;
  for (auto _ : state) {
    state.PauseTiming();
    FrontEnd front_end({});
    state.ResumeTiming();
    for (const auto& packet : packets) front_end.add(packet.packet());
    added += static_cast<std::int64_t>(packets.size());
    benchmark::DoNotOptimize(front_end.newest_slot());
  }
  state.SetItemsProcessed(added);
}

void add_by_counter(benchmark::State& state) { add(state, true); }
void add_by_time(benchmark::State& state) { add(state, false); }

void take(benchmark::State& state) {
  FrontEnd front_end({.hop = 1});
  for (const auto& packet : packets_of(300, true)) front_end.add(packet.packet());
  front_end.skip_before(front_end.next()->last_sample +
                        std::chrono::seconds(8));  // the ring holds the last 3 s
  Window window;
  std::int64_t whole = 0, windows = 0;
  for (auto _ : state) {
    if (front_end.next()->end_slot > front_end.newest_slot()) {
      state.SkipWithError("ran out of samples");
      break;
    }
    front_end.take(window);
    whole += window.links.all();
    ++windows;
  }
  if (whole != windows) state.SkipWithError("a window was not whole");
  state.SetItemsProcessed(windows);
}

BENCHMARK(add_by_counter)->Unit(benchmark::kMillisecond);
BENCHMARK(add_by_time)->Unit(benchmark::kMillisecond);
BENCHMARK(take)->Unit(benchmark::kMicrosecond)->Iterations(500);

}  // namespace
}  // namespace csipose

BENCHMARK_MAIN();
