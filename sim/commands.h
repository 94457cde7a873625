// sim/commands.h - the commands of csipose-sim; each is one file cmd_NAME.cpp and throws SetupError.
#pragma once

namespace CLI {
class App;
}

namespace csipose::sim {
void add_bench(CLI::App& app);
void add_dataset(CLI::App& app);
void add_live(CLI::App& app);
void add_record(CLI::App& app);
void add_render(CLI::App& app);
void add_solve(CLI::App& app);
void add_stats(CLI::App& app);
}  // namespace csipose::sim
