// daemon/convert.h - logs and recordings into NumPy arrays that others can hold us against, and logs into recordings.
//
// Arrays, per receiver (n records that decode, T = most streams of any of them):
//   fields.npy        int64      [n][18]         offset, length, timestamp_low, bfee_count, nrx, ntx, rssi_a, rssi_b,
//                                                rssi_c, noise, agc, antenna_sel, len, rate, perm0, perm1, perm2,
//                                                perm_valid; offset is -1 for a recording
//   csi_raw.npy       int8       [n][30][3][T][2]  subcarrier, antenna A B C, stream, (re, im); absent ones 0
//   csi_scaled.npy    complex64  [n][30][3][T]   in units of sqrt(SNR); NaN where a record cannot be scaled
//   csi_scaled_sm.npy complex64  [n][30][3][T]   spatial mapping removed too; only where T > 1
//   phase_METHOD.npy  float64    [n][3][30]      sanitised phase of one stream, as asked for
//   phase_mask.npy    uint8      [n][3][30]      1 where that phase is defined: entry not 0, record fit for the method
// Windows, of all receivers together (n windows of the front end):
//   tensor.npy        float32    [n][60][20][9]  proto/window.h
//   tensor_links.npy  uint8      [n][9]          1 = link is there
//   tensor_samples.npy uint8     [n][20][3]      0 missing, 1 filled from an older sample, 2 received
//   tensor_time_ns.npy int64     [n][2]          UTC of the first and the last sample
//   tensor_slot.npy   int64      [n]             grid index of the last sample
// Every file appears whole or not at all.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "capture/recorded_windows.h"

namespace csipose {

struct ConvertOptions {
  std::optional<PhaseMethod> phase;  ///< sanitised phases are written only when asked for
  int stream = 0;                    ///< that phases are taken of
  bool undo_40mhz_rotation = true;   ///< off: phases as the peers have them
};

/// Writes the arrays of each receiver of one file: into `folder` itself, for a recording of several receivers into a
/// folder of each one's name below it. Throws SetupError, also when the file holds no CSI.
void convert_to_npy(const std::string& file, const std::filesystem::path& folder,
                    const ConvertOptions& options);

struct TensorOptions {
  FrontEndConfig front_end;
  double rate_hz = 0;                 ///< of .dat files whose NIC clock is unusable
  Nanoseconds jitter = kUsualJitter;  ///< how long a window waits for stragglers
};

/// Runs one recording, or one to three .dat files (file i is receiver i), through the front end and writes its windows.
/// Returns how many there were; throws SetupError, also when there were none.
std::size_t convert_to_tensor(const std::vector<std::string>& files, const std::filesystem::path& folder,
                              const TensorOptions& options);

/// Writes the packets of one to three .dat files (or of a recording) as one recording. Throws SetupError, also when
/// `recording` is there already. Returns the number of packets.
std::uint64_t convert_to_recording(const std::vector<std::string>& files, const std::string& recording,
                                   double rate_hz);

}  // namespace csipose
