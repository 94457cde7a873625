// model/json_words.h - JSON values in messages to people.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace csipose {

/// `value` as a refusal quotes it: itself, or its type where it has parts. A nested value is never written out: that
/// would recurse as deep as the file's author likes.
std::string brief(const nlohmann::json& value);

}  // namespace csipose
