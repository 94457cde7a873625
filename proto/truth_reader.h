// proto/truth_reader.h - the truth that a simulated recording holds beside its packets (proto/recording.h, channel /truth).
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "proto/mcap.h"
#include "proto/truth.h"

namespace csipose {

class TruthReader {
 public:
  /// `file` must live as long as the reader; `name` is for words.
  TruthReader(ByteView file, std::string name) : reader_(file), name_(std::move(name)) {}

  /// The next instant in file order; nullopt: there is no more, or none among the next `messages` messages. Of a file that is no
  /// recording there is none. Throws SetupError (bad_data): a truth that is damaged.
  std::optional<Truth> next(std::uint64_t messages = UINT64_MAX);

 private:
  McapReader reader_;
  std::string name_;
};

}  // namespace csipose
