// daemon/notify.h - what the daemon tells systemd, and the sockets it is given. All of it does nothing
// without systemd.
#pragma once

#include <map>
#include <string>

namespace csipose {

void notify_ready();
void notify_status(const std::string& text);
void notify_reloading();
void notify_stopping();
/// Feeds the watchdog. Called only when the loop has made progress: a loop that hangs is restarted.
void notify_watchdog();

/// Sockets that systemd has opened for us: "udp", "tcp", and Unix sockets by their file's name ("pose.sock").
/// Taken once, close-on-exec.
std::map<std::string, int> inherited_sockets();

}  // namespace csipose
