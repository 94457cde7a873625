// train/commands.h - the commands of csipose-train; each is one file cmd_NAME.cpp and throws SetupError.
#pragma once

namespace CLI {
class App;
}

namespace csipose::train {
void add_calibrate(CLI::App& app);
void add_dataset(CLI::App& app);
void add_defaults(CLI::App& app);
void add_eval(CLI::App& app);
void add_experiment(CLI::App& app);
void add_finetune(CLI::App& app);
void add_gate(CLI::App& app);
void add_pack(CLI::App& app);
void add_pretrain(CLI::App& app);
}  // namespace csipose::train
