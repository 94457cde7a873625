// csipose-sim live: people in a room, as three receivers that csiposed hears through its UDP door.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "proto/keys.h"
#include "proto/result.h"
#include "sim/commands.h"
#include "sim/live.h"
#include "sim/scene_options.h"

namespace csipose::sim {
namespace {

struct LiveWords {
  std::string to, truth_socket;
  std::vector<std::string> keys;
  std::vector<std::size_t> silent;
  SceneOptions scene;
  RadioOptions radio;
  double speed = 1, seconds = 0;
};

std::array<AgentKey, kReceivers> load_keys(const std::vector<std::string>& files) {
  if (files.size() != kReceivers)
    throw SetupError(ExitStatus::usage,
                     fmt::format("--keys names {} files; give {}, in the order of the room's "
                                 "receivers: rx1.key,rx2.key,rx3.key",
                                 files.size(), kReceivers));
  std::array<AgentKey, kReceivers> keys;
  for (std::size_t r = 0; r < kReceivers; ++r) {
    keys[r] = load_agent_key(files[r]);
    if (keys[r].kind != KeyKind::simulated)
      throw SetupError(
          ExitStatus::bad_config,
          fmt::format(
              "the key {0} is of kind {1}: frames would say {1} of what is simulated. Make one for the "
              "simulator: csipose agent add {2} --sim",
              files[r], name(keys[r].kind), keys[r].name));
    for (std::size_t other = 0; other < r; ++other)
      if (keys[other].name == keys[r].name)
        throw SetupError(ExitStatus::bad_config,
                         fmt::format("{} and {} are both keys of {}: each receiver needs its own",
                                     files[other], files[r], keys[r].name));
  }
  return keys;
}

/// "office, 2 people: walk"
std::string words_of(const SceneOptions& scene) {
  return fmt::format("{}, {} {}: {}", scene.scene, scene.people, scene.people == 1 ? "person" : "people",
                     fmt::join(scene.who.actions, " "));
}

void live(const LiveWords& words) {
  const PollStop signals;  // before any thread begins
  auto scene = open_moving_scene(words.scene);
  if (!scene)
    throw SetupError(ExitStatus::usage,
                     fmt::format("the {} has no room and nobody in it; csipose-sim record makes logs of it, "
                                 "which csipose-agent --dat plays",
                                 words.scene.scene));
  LiveOptions options;
  options.daemon = words.to;
  options.keys = load_keys(words.keys);
  for (const std::size_t number : words.silent) options.silent.set(number - 1);
  options.radio = words.radio.impairments();
  options.impair_name = words.radio.words();
  options.rate_hz = words.scene.rate_hz;
  options.seed = words.scene.seed;
  options.clip = words.scene.clip;
  options.speed = words.speed;
  if (words.seconds > 0) options.seconds = words.seconds;
  options.truth_socket = words.truth_socket;
  options.what = words.scene.scene == "object" ? "flying solids, nobody" : words_of(words.scene);
  run_live(options, std::move(scene), signals);
}

}  // namespace

void add_live(CLI::App& app) {
  auto words = std::make_shared<LiveWords>();
  words->scene.people = 2;
  words->scene.who.actions = {"walk"};
  CLI::App* command = app.add_subcommand(
      "live", "three virtual receivers that a running csiposed hears through its UDP door");
  command->add_option("--to", words->to, "UDP door of the daemon")->type_name("HOST:PORT")->required();
  command->add_option("--keys", words->keys, "keys of kind simulated, in the order of the room's receivers")
      ->type_name("FILE,FILE,FILE")
      ->delimiter(',')
      ->required();
  add_scene_options(*command, words->scene);
  add_radio_options(*command, words->radio);
  command->add_option("--speed", words->speed, "simulated seconds per second")
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  command
      ->add_option("--truth", words->truth_socket,
                   "Unix socket to make, which says where people really are (docs/truth.md)")
      ->type_name("PATH");
  command
      ->add_option("--silent", words->silent,
                   "receivers that are switched off, by number from 1 in the order of --keys: a daemon with "
                   "less than it needs")
      ->type_name("N,N")
      ->delimiter(',')
      ->check(CLI::Range(std::size_t{1}, kReceivers));
  command->add_option("--seconds", words->seconds, "end after so many simulated seconds")
      ->check(CLI::PositiveNumber);
  command->callback([words] { live(*words); });
}

}  // namespace csipose::sim
