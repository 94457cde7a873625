// proto/wire_json.h - protobuf messages as JSON objects and back, by reflection: one description, two
// formats.
//
// Seen by wire.cpp only. Differs from protobuf's own JSON mapping where the stream's contract does: field
// names as they are written, enum values in lower case, fixed64 as decimal strings, 64-bit counts as numbers,
// NaN as null, points in rows of three.
#pragma once

#include <google/protobuf/message.h>

#include <optional>
#include <string>
#include <string_view>

#include "proto/wire.h"

namespace csipose {

/// Appends `"key":value` for every field that has something to say, separated by commas and without braces.
/// Empty number arrays and unset messages are left out; empty lists of anything else stay, as [].
void append_json_fields(const google::protobuf::Message& message, std::string& out);

/// Reads {"type":"NAME", ...} into the member NAME of the message's only oneof. Unknown keys are refused when
/// `strict` (what a client asks), passed over when not (a newer server may say more).
std::optional<WireError> read_typed_json(ByteView line, bool strict, google::protobuf::Message& message);

/// "live" for LIVE.
std::string json_enum_name(const google::protobuf::EnumValueDescriptor& value);

}  // namespace csipose
