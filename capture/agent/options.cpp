#include "capture/agent/options.h"

#include <cmath>
#include <cstdlib>

#include "proto/result.h"

namespace csipose {
namespace {

[[noreturn]] void refuse(const std::string& words) {
  throw SetupError(ExitStatus::usage, words + "; `csipose-agent --help` lists the options");
}

double parse_rate(const std::string& text) {
  char* end = nullptr;
  const double rate = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !std::isfinite(rate) || rate <= 0 || rate > 100'000)
    refuse("--rate is packets a second, more than 0 and at most 100000, not '" + text + "'");
  return rate;
}

void require_sense(const AgentOptions& o) {
  const bool plays = !o.dat_file.empty();
  if (!plays && (o.play.rate_hz > 0 || o.play.loop || o.play.inject_counter))
    refuse("--rate, --loop and --inject-counter go with --dat FILE");
  if (!o.csitool_tcp.empty()) {
    if (!o.to.empty() || !o.key_file.empty()) refuse("--csitool-tcp takes the place of --to and --key");
    return;
  }
  if (o.id.empty()) refuse("--id is missing: the receiver's id in the daemon's configuration");
  if (o.key_file.empty()) refuse("--key is missing: the file that `csipose agent add` made");
  if (o.to.empty()) refuse("--to is missing: HOST:PORT of the daemon");
}

}  // namespace

const char* const kAgentHelp =
    "csipose-agent --id ID --key FILE --to HOST:PORT [--dat FILE [--rate HZ] [--loop] [--inject-counter]]\n"
    "\n"
    "Sends the CSI records of this host's Intel 5300 to csiposed, sealed. Runs until it is stopped.\n"
    "\n"
    "  --id ID            the receiver's id in the daemon's configuration; the key has to be for it\n"
    "  --key FILE         key of this receiver, mode 0400, made by `csipose agent add`\n"
    "  --to HOST:PORT     where csiposed listens\n"
    "  --help, --version\n"
    "\n"
    "For testing without a NIC:\n"
    "  --dat FILE         play a csitool log, paced by the NIC's clock in it; ends with the file\n"
    "  --rate HZ          paced by this rate instead; NIC timestamps are rewritten\n"
    "  --loop             repeat for ever on the host's clock; frames, timestamps and bfee_count are "
    "rewritten and go on\n"
    "                     counting. Agents that loop the same file at the same rate are in step\n"
    "  --inject-counter   put a counting frame before each CSI record of a log that has none\n"
    "  --csitool-tcp HOST:PORT   send as csitool's log_to_server does, in the clear, instead of --to and "
    "--key\n"
    "\n"
    "Every 10 s a line on stderr says what was sent and lost. Exit status as in sysexits.h.\n";

AgentOptions parse_agent_options(const std::vector<std::string>& arguments) {
  AgentOptions options;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& option = arguments[i];
    const auto value = [&]() -> const std::string& {
      if (i + 1 == arguments.size()) refuse(option + " needs a value");
      return arguments[++i];
    };
    if (option == "--id")
      options.id = value();
    else if (option == "--key")
      options.key_file = value();
    else if (option == "--to")
      options.to = value();
    else if (option == "--dat")
      options.dat_file = value();
    else if (option == "--rate")
      options.play.rate_hz = parse_rate(value());
    else if (option == "--csitool-tcp")
      options.csitool_tcp = value();
    else if (option == "--loop")
      options.play.loop = true;
    else if (option == "--inject-counter")
      options.play.inject_counter = true;
    else if (option == "--help" || option == "-h")
      options.help = true;
    else if (option == "--version")
      options.version = true;
    else
      refuse("'" + option + "' is no option of csipose-agent");
  }
  if (!options.help && !options.version) require_sense(options);
  return options;
}

}  // namespace csipose
