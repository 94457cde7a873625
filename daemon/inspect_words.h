// daemon/inspect_words.h - an inspection told to people, in words, and to programs, in JSON.
#pragma once

#include <string>
#include <vector>

#include "daemon/inspect.h"

namespace csipose {

/// Whatever is odd about a receiver's records, a sentence each; those that cost data first.
std::vector<std::string> anomalies(const ReceiverReport& receiver);

/// Some twenty lines per receiver.
std::string to_text(const Inspection& inspection);

/// One object. `records`, `usable`, `errors` (by name of RecordFault, only those that occurred) and `other_codes` (records
/// that are not CSI, by "0xc1") are sums over the file; `receivers` holds the rest.
std::string to_json(const Inspection& inspection);

}  // namespace csipose
