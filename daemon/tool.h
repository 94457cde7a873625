// daemon/tool.h - what all commands of `csipose` share: common options, the programs beside this one, talk
// and output.
//
// A command is a file of its own, NAME_command.cpp, with one `void add_NAME(CLI::App& app)` declared here.
// Its callback runs the command; what a person must put right is thrown as SetupError and told once, in
// main().
#pragma once

#include <string>
#include <vector>

#include "proto/result.h"

namespace CLI {
class App;
}

namespace csipose {

/// Options that come before or after any command. Set by main() before a command runs, then only read.
struct ToolOptions {
  std::string config;             ///< empty = /etc/csiposed/csiposed.toml
  std::vector<std::string> sets;  ///< "section.key=value", in order
  std::string log_level;          ///< empty = as configured
  bool json = false, quiet = false, no_color = false;
};
const ToolOptions& tool_options();
/// The same for main() and tests.
ToolOptions& mutable_tool_options();

/// Full path of a program that lies in the folder of this one. Throws SetupError when it is not there.
std::string sibling_program(const std::string& name);
/// The weights that came with the program, ../share/csiposed/models/simulated-rooms.safetensors from where it lies; "" when there are none.
std::string shipped_weights();
/// Becomes that program; returns only by throwing SetupError.
[[noreturn]] void become_sibling(const std::string& name, const std::vector<std::string>& arguments);
/// The entry of `known` that `word` was most likely meant to be; empty when none is near.
std::string nearest_word(const std::string& word, const std::vector<std::string>& known);
/// Throws SetupError (cannot_create) when the file that a command is to write is there and --force was not said.
void require_free(const std::string& file, bool force);

// The commands, each in its own file.
void add_agent(CLI::App& app);
void add_config(CLI::App& app);
void add_demo(CLI::App& app);
void add_record(CLI::App& app);
void add_replay(CLI::App& app);
void add_status(CLI::App& app);
void add_top(CLI::App& app);
void add_watch(CLI::App& app);
void add_model(CLI::App& app);
void add_background(CLI::App& model_command);
void add_calibrate(CLI::App& model_command);
void add_infer(CLI::App& app);
void add_inspect(CLI::App& app);
void add_convert(CLI::App& app);

}  // namespace csipose
