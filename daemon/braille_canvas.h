// daemon/braille_canvas.h - a picture of 2 x 4 dots per character cell (Unicode block U+2800), with text on
// top.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "daemon/styled_text.h"

namespace csipose {

class BrailleCanvas {
 public:
  BrailleCanvas(std::size_t columns, std::size_t rows);
  int width() const { return static_cast<int>(columns_ * 2); }  ///< dots
  int height() const { return static_cast<int>(rows_ * 4); }

  /// Dots count from the top left; what lies outside is not drawn.
  void dot(int x, int y, Tone tone);
  void line(int x0, int y0, int x1, int y1, Tone tone);
  /// The same with every second dot only.
  void dotted_line(int x0, int y0, int x1, int y1, Tone tone);
  /// Text whose first letter stands where the dot is.
  void text(int x, int y, const std::string& letters, Tone tone);

  /// One line per row of cells, `columns` wide.
  std::vector<Line> lines() const;

 private:
  void line(int x0, int y0, int x1, int y1, Tone tone, int every);
  struct Cell {
    unsigned dots = 0;  ///< bit k as in U+2800 + bits
    char letter = 0;
    Tone tone = Tone::plain;
  };
  std::size_t columns_, rows_;
  std::vector<Cell> cells_;
};

}  // namespace csipose
