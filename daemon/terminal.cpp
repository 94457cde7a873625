#include "daemon/terminal.h"

#include <signal.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>

#include "daemon/tool.h"

namespace csipose {
namespace {

volatile sig_atomic_t stop_flag = 0;  // what a signal handler may write

}  // namespace

bool stdout_is_terminal() { return isatty(STDOUT_FILENO) == 1; }

bool stdout_takes_color() {
  const char *term = std::getenv("TERM"), *no_color = std::getenv("NO_COLOR");
  if (tool_options().no_color || (no_color != nullptr && *no_color != '\0')) return false;
  return stdout_is_terminal() && term != nullptr && std::string(term) != "dumb";
}

TerminalSize terminal_size() {
  winsize size{};
  if (ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0 || size.ws_row == 0) return {};
  return {size.ws_col, size.ws_row};
}

bool print_out(const std::string& text) {
  for (std::size_t at = 0; at < text.size();) {
    const ssize_t size = write(STDOUT_FILENO, text.data() + at, text.size() - at);
    if (size < 0 && errno == EINTR && !StopSignals::stop_wanted()) continue;
    if (size < 0) return false;
    at += static_cast<std::size_t>(size);
  }
  return true;
}

// DEC private modes: 1049 alternate screen, 25 cursor (xterm control sequences).
LiveScreen::LiveScreen() : color_(stdout_takes_color()) { print_out("\x1b[?1049h\x1b[?25l\x1b[2J"); }
LiveScreen::~LiveScreen() { print_out("\x1b[?25h\x1b[?1049l"); }

void LiveScreen::draw(const std::vector<Line>& lines, TerminalSize size) const {
  std::string screen = "\x1b[H";
  const std::size_t count = std::min(lines.size(), size.rows);
  for (std::size_t i = 0; i < count; ++i)  // the last line has no newline: the screen would scroll
    screen += to_text(lines[i], size.columns, color_) + "\x1b[K" + (i + 1 < size.rows ? "\r\n" : "");
  print_out(screen + "\x1b[J");
}

StopSignals::StopSignals() {
  struct sigaction action {};
  action.sa_handler = [](int) { stop_flag = 1; };
  sigemptyset(&action.sa_mask);  // and no SA_RESTART: whoever waits comes back
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  signal(SIGPIPE, SIG_IGN);
}
bool StopSignals::stop_wanted() { return stop_flag != 0; }

}  // namespace csipose
