// csipose-sim - rooms, bodies and radio that make Intel 5300 CSI.
#include <CLI/CLI.hpp>
#include <cstdio>

#include "proto/result.h"
#include "sim/commands.h"
#include "version.h"

using csipose::ExitStatus;

int main(int argc, char** argv) {
  CLI::App app("csipose-sim: rooms, bodies and radio that make Intel 5300 CSI");
  app.set_version_flag("--version", "csipose-sim " CSIPOSE_VERSION " (" CSIPOSE_COMMIT ")");
  app.require_subcommand(1);
  csipose::sim::add_bench(app);
  csipose::sim::add_dataset(app);
  csipose::sim::add_live(app);
  csipose::sim::add_record(app);
  csipose::sim::add_render(app);
  csipose::sim::add_solve(app);
  csipose::sim::add_stats(app);
  try {
    app.parse(argc, argv);
    return static_cast<int>(ExitStatus::ok);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? static_cast<int>(ExitStatus::ok) : static_cast<int>(ExitStatus::usage);
  } catch (const csipose::SetupError& error) {
    std::fprintf(stderr, "csipose-sim: %s\n", error.what());
    return static_cast<int>(error.status);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "csipose-sim: stopped by a fault of its own: %s\n", error.what());
    return static_cast<int>(ExitStatus::bug);
  }
}
