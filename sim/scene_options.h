// sim/scene_options.h - the words with which commands name a scene and what the radio does to it.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "sim/captured_scene.h"
#include "sim/human_scene.h"
#include "sim/radio.h"
#include "sim/random_room.h"
#include "sim/solved_scene.h"

namespace CLI {
class App;
}

namespace csipose::sim {

/// Who is in a room of people and what they do.
struct PeopleOptions {
  std::vector<std::string> actions{"all"};
  bool chairs = false, opposite = false;

  /// "all" is everything but falling.
  std::vector<Action> allowed() const;
};
void add_people_options(CLI::App& command, PeopleOptions& options);

void add_ways_options(CLI::App& command, Ways& ways);

/// One scene that runs on.
struct SceneOptions {
  std::string scene = "office";  ///< a room, "random", "object" or "reflector"
  std::size_t people = 1;
  PeopleOptions who;
  Ways ways;
  CaptureSpec capture;  ///< with files: who moves as they say, instead of `people` and `who`
  std::uint64_t seed = 1;
  std::uint32_t clip = 0;
  double rate_hz = 300;
};
void add_scene_options(CLI::App& command, SceneOptions& options);
/// Nothing for the reflector, which has no bodies. Throws SetupError for a room that is not there.
std::unique_ptr<MovingScene> open_moving_scene(const SceneOptions& options);
std::unique_ptr<ChannelSource> open_channels(const SceneOptions& options);

/// What the radio spoils.
struct RadioOptions {
  std::string level = "5300";
  std::vector<std::string> off;
  std::uint32_t power_up = 0;

  Impairments impairments() const;
  /// For manifests: "5300", "5300 less losses, power-up 2".
  std::string words() const;
};
void add_radio_options(CLI::App& command, RadioOptions& options);

}  // namespace csipose::sim
