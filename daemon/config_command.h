// daemon/config_command.h - `csipose config`.
#pragma once

namespace CLI {
class App;
}

namespace csipose {
/// Adds `config check|show|default`; reads the program's own --config and --set.
void add_config(CLI::App& app);
}  // namespace csipose
