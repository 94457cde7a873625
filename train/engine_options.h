// train/engine_options.h - which of the daemon's engines answers, as commands of csipose-train ask for it.
#pragma once

#include <memory>
#include <string>

#include "model/engine.h"

namespace CLI {
class App;
}

namespace csipose::train {

struct EngineOptions {
  std::string engine = "onednn", precision;
  int threads = 2;
};
void add_engine_options(CLI::App& command, EngineOptions& options);
/// All queries are refined. Throws SetupError when model, processor or engine cannot do what is asked.
std::unique_ptr<Engine> make_engine(const EngineOptions& options, std::shared_ptr<const Model> model);

}  // namespace csipose::train
