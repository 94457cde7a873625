#include "daemon/styled_text.h"

#include <algorithm>
#include <array>

namespace csipose {
namespace {

constexpr bool continues(char c) { return (static_cast<unsigned char>(c) & 0xC0) == 0x80; }
constexpr bool is_badge(Tone tone) {
  return tone == Tone::badge || tone == Tone::badge_warning || tone == Tone::badge_alarm;
}

/// ANSI SGR parameters; the sixteen colours that every terminal's theme defines.
const char* sgr(Tone tone) {
  static constexpr std::array<const char*, 16> kSgr = {"",     "2",     "1",     "32",  "33",   "31",
                                                       "7",    "30;43", "37;41", "32",  "1;36", "1;35",
                                                       "1;33", "1;32",  "1;34",  "1;31"};
  return kSgr[static_cast<std::size_t>(tone)];
}

std::string_view first_columns(std::string_view text, std::size_t width) {
  std::size_t end = 0;
  for (std::size_t seen = 0; end < text.size(); ++end)
    if (!continues(text[end]) && seen++ == width) break;
  return text.substr(0, end);
}

}  // namespace

Tone person_tone(std::size_t number) {
  return static_cast<Tone>(static_cast<std::size_t>(Tone::person_0) + number % kPersonTones);
}

std::size_t columns(std::string_view text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return !continues(c); }));
}

std::string to_text(const Line& line, std::size_t width, bool color) {
  std::string out;
  std::size_t left = width;
  for (const Span& span : line) {
    const std::string badge =
        is_badge(span.tone) ? (color ? ' ' + span.text + ' ' : '[' + span.text + ']') : "";
    const std::string_view text = first_columns(badge.empty() ? std::string_view(span.text) : badge, left);
    left -= columns(text);
    const bool styled = color && span.tone != Tone::plain && !text.empty();
    if (styled) out += std::string("\x1b[") + sgr(span.tone) + 'm';
    out += text;
    if (styled) out += "\x1b[0m";
  }
  return out;
}

}  // namespace csipose
