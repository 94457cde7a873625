// daemon/truth_recording.h - the truth that a simulated recording holds beside its packets, read along with the poses of its replay.
#pragma once

#include <memory>
#include <string>

#include "daemon/truth_source.h"
#include "proto/mapped_file.h"
#include "proto/truth_reader.h"

namespace csipose {

class TruthRecording final : public TruthSource {
 public:
  /// nullptr when the file is no recording, or when none of its first thousand messages is a truth. Throws SetupError when it cannot
  /// be read.
  static std::unique_ptr<TruthRecording> open(const std::string& path);

  const TruthHello* hello() const override { return nullptr; }
  void drain() override {}
  /// Reads on as far as it must. Throws SetupError (bad_data): a truth that is damaged.
  const Truth* at(UtcTime time) override;
  double age_s(const Truth&) const override { return 0; }
  std::string silence() const override { return "the recording says nothing of this time"; }

 private:
  explicit TruthRecording(const std::string& path);
  /// Keeps the next truth; false when there is no more among `messages` messages.
  bool read_on(std::uint64_t messages);

  MappedFile file_;
  TruthReader reader_;
};

}  // namespace csipose
