#include "daemon/braille_canvas.h"

#include <array>
#include <cstdlib>

namespace csipose {
namespace {

/// Bit of a dot within its cell, [row][column]: the Unicode block numbers dots 1-3 and 7 down the left, 4-6
/// and 8 down the right.
constexpr std::array<std::array<unsigned, 2>, 4> kDotBits = {
    {{0x01, 0x08}, {0x02, 0x10}, {0x04, 0x20}, {0x40, 0x80}}};

std::string braille(unsigned dots) {
  const unsigned code = 0x2800 + dots;  // always three bytes of UTF-8
  return {static_cast<char>(0xE0 | code >> 12), static_cast<char>(0x80 | (code >> 6 & 0x3F)),
          static_cast<char>(0x80 | (code & 0x3F))};
}

}  // namespace

BrailleCanvas::BrailleCanvas(std::size_t columns, std::size_t rows)
    : columns_(columns), rows_(rows), cells_(columns * rows) {}

void BrailleCanvas::dot(int x, int y, Tone tone) {
  if (x < 0 || y < 0 || x >= width() || y >= height()) return;
  Cell& cell = cells_[static_cast<std::size_t>(y / 4) * columns_ + static_cast<std::size_t>(x / 2)];
  cell.dots |= kDotBits[static_cast<std::size_t>(y % 4)][static_cast<std::size_t>(x % 2)];
  cell.tone = tone;
}

void BrailleCanvas::line(int x0, int y0, int x1, int y1, Tone tone) { line(x0, y0, x1, y1, tone, 1); }
void BrailleCanvas::dotted_line(int x0, int y0, int x1, int y1, Tone tone) { line(x0, y0, x1, y1, tone, 2); }

/// Bresenham's line.
void BrailleCanvas::line(int x0, int y0, int x1, int y1, Tone tone, int every) {
  const int dx = std::abs(x1 - x0), dy = -std::abs(y1 - y0);
  const int step_x = x0 < x1 ? 1 : -1, step_y = y0 < y1 ? 1 : -1;
  for (int error = dx + dy, number = 0;; ++number) {
    if (number % every == 0) dot(x0, y0, tone);
    if (x0 == x1 && y0 == y1) return;
    const int twice = 2 * error;
    if (twice >= dy) error += dy, x0 += step_x;
    if (twice <= dx) error += dx, y0 += step_y;
  }
}

void BrailleCanvas::text(int x, int y, const std::string& letters, Tone tone) {
  for (const char letter : letters) {
    if (x >= 0 && y >= 0 && x < width() && y < height()) {
      Cell& cell = cells_[static_cast<std::size_t>(y / 4) * columns_ + static_cast<std::size_t>(x / 2)];
      cell.letter = letter;
      cell.tone = tone;
    }
    x += 2;
  }
}

std::vector<Line> BrailleCanvas::lines() const {
  std::vector<Line> made(rows_);
  for (std::size_t row = 0; row < rows_; ++row)
    for (std::size_t column = 0; column < columns_; ++column) {
      const Cell& cell = cells_[row * columns_ + column];
      const bool empty = cell.letter == 0 && cell.dots == 0;
      const std::string glyph = cell.letter != 0 ? std::string(1, cell.letter)
                                : empty          ? " "
                                                 : braille(cell.dots);
      const Tone tone = empty ? Tone::plain : cell.tone;
      if (made[row].empty() || made[row].back().tone != tone) made[row].push_back({"", tone});
      made[row].back().text += glyph;
    }
  return made;
}

}  // namespace csipose
