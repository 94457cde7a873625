// daemon/styled_text.h - lines of text with tones, for terminals with colours, without, and for pipes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace csipose {

/// What a piece of text is, not which colour it has. person_0 to person_5 tell people apart.
enum class Tone : std::uint8_t {
  plain,
  dim,
  strong,
  good,
  warning,
  alarm,
  badge,
  badge_warning,
  badge_alarm,
  truth,  ///< what the simulator says, which is no result
  person_0,
  person_1,
  person_2,
  person_3,
  person_4,
  person_5
};
inline constexpr std::size_t kPersonTones = 6;
Tone person_tone(std::size_t number);

struct Span {
  std::string text;
  Tone tone = Tone::plain;
};
using Line = std::vector<Span>;

/// Columns that UTF-8 text takes: one per code point, which holds for everything we print.
std::size_t columns(std::string_view text);
/// At most `width` columns of it. Without colour a badge becomes [BADGE].
std::string to_text(const Line& line, std::size_t width, bool color);

}  // namespace csipose
