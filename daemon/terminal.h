// daemon/terminal.h - a screen that is redrawn in place, and the signals that end a command.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "daemon/styled_text.h"

namespace csipose {

struct TerminalSize {
  std::size_t columns = 80, rows = 24;
};

bool stdout_is_terminal();
/// On a terminal, unless --no-color, NO_COLOR (no-color.org) or a dumb terminal say otherwise.
bool stdout_takes_color();
TerminalSize terminal_size();
/// To stdout at once; what cannot be written any more (a closed pipe) ends the program's output quietly:
/// false.
bool print_out(const std::string& text);

/// The alternate screen of the terminal while it lives; what was there before comes back. For stdout
/// terminals only.
class LiveScreen {
 public:
  LiveScreen();
  ~LiveScreen();
  LiveScreen(const LiveScreen&) = delete;
  LiveScreen& operator=(const LiveScreen&) = delete;
  /// Replaces what is shown, without flicker.
  void draw(const std::vector<Line>& lines, TerminalSize size) const;

 private:
  bool color_;
};

/// While it lives SIGINT and SIGTERM (and a closed pipe) do not kill but make stop_wanted() true and
/// interrupt waiting.
class StopSignals {
 public:
  StopSignals();
  static bool stop_wanted();
};

}  // namespace csipose
