#include "sim/scene_options.h"

#include <fmt/core.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>

#include "proto/result.h"
#include "sim/object_clip.h"

namespace csipose::sim {
namespace {

std::vector<std::string> action_names() {
  std::vector<std::string> names{"all"};
  names.insert(names.end(), kActionNames.begin(), kActionNames.end());
  return names;
}

std::vector<std::string> impairment_names() {
  std::vector<std::string> names;
  for (const NamedImpairment& it : named_impairments()) names.emplace_back(it.name);
  return names;
}

ImpairmentLevel level_of(const std::string& name) {
  return name == "none"   ? ImpairmentLevel::none
         : name == "mild" ? ImpairmentLevel::mild
                          : ImpairmentLevel::intel5300;
}

void add_capture_options(CLI::App& command, CaptureSpec& capture) {
  CLI::Option* files = command
                           .add_option("--bvh", capture.files,
                                       "motion capture file of one person, instead of --people; may be given "
                                       "up to three times (docs/simulator-motion.md)")
                           ->expected(1, 3);
  command.add_option("--bvh-joints", capture.namings, "table of the names of joints")->needs(files);
  command
      .add_option("--bvh-unit", capture.part.metres_per_unit,
                  "metres per unit of length; otherwise what the table says")
      ->check(CLI::Range(1e-6, 1e3))
      ->needs(files);
  command
      .add_option_function<std::string>(
          "--bvh-up", [&capture](const std::string& axis) { capture.part.z_up = axis == "z"; },
          "axis that points up, y or z; otherwise what the table says")
      ->check(CLI::IsMember({"y", "z"}))
      ->needs(files);
  command.add_option("--bvh-from", capture.part.from_s, "begin so far into the file, seconds")->needs(files);
  command.add_option("--bvh-seconds", capture.part.seconds, "then stand still; otherwise at the file's end")
      ->needs(files);
}

}  // namespace

std::vector<Action> PeopleOptions::allowed() const {
  std::vector<Action> allowed;
  for (const std::string& name : actions) {
    if (const auto action = find_action(name))
      allowed.push_back(*action);
    else  // all
      for (std::size_t i = 0; i < kActions; ++i)
        if (static_cast<Action>(i) != Action::fall) allowed.push_back(static_cast<Action>(i));
  }
  return allowed;
}

void add_people_options(CLI::App& command, PeopleOptions& options) {
  command
      .add_option("--actions", options.actions,
                  fmt::format("what they do: {}; all is everything but fall", fmt::join(kActionNames, ", ")))
      ->delimiter(',')
      ->check(CLI::IsMember(action_names()))
      ->capture_default_str();
  command.add_flag("--chairs", options.chairs, "who begins by sitting has a chair and stays with it");
  command.add_flag("--opposite", options.opposite,
                   "in random rooms: transmitter at one side of the area, receivers at the three others");
}

void add_ways_options(CLI::App& command, Ways& ways) {
  command
      .add_option("--pairs", ways.pairs,
                  "ways by a body: 1 direct; 13 with one wall before or after it; 49 both")
      ->check(CLI::IsMember({1, 13, 49}))
      ->capture_default_str();
  command.add_flag("--clutter", ways.clutter, "walls scatter: roughness drawn from the seed, S up to 0.35");
}

void add_scene_options(CLI::App& command, SceneOptions& options) {
  command
      .add_option(
          "--scene", options.scene,
          "office, classroom, corridor, empty or a room's file: people in it; random: in a room drawn "
          "from the seed; object: flying solids; reflector: one point in closed form")
      ->capture_default_str();
  command.add_option("--people", options.people, "how many")->check(CLI::Range(0, 3))->capture_default_str();
  add_people_options(command, options.who);
  add_ways_options(command, options.ways);
  add_capture_options(command, options.capture);
  command.add_option("--seed", options.seed, "same seed, same bytes")->capture_default_str();
  command.add_option("--clip", options.clip, "which clip of that seed")->capture_default_str();
  command.add_option("--rate", options.rate_hz, "packets a second")
      ->check(CLI::Range(1.0, 10'000.0))
      ->capture_default_str();
}

std::unique_ptr<MovingScene> open_moving_scene(const SceneOptions& options) {
  const bool captured = !options.capture.files.empty();
  if (captured && (options.scene == "reflector" || options.scene == "object"))
    throw SetupError(ExitStatus::usage,
                     fmt::format("--bvh needs a room for people; the scene '{}' has none", options.scene));
  if (options.scene == "reflector") return nullptr;
  if (options.scene == "object")
    return object_scene(options.seed, options.clip, options.rate_hz, options.ways);
  HumanSpec spec;
  spec.room = options.scene == "random" ? draw_room(options.seed, options.clip, options.who.opposite)
                                        : read_room_plan(options.scene);
  set_ways(spec.room.still, options.ways, options.seed, options.clip);
  if (captured)
    return std::make_unique<CapturedScene>(spec.room, options.capture, options.seed, options.rate_hz);
  spec.people = options.people;
  spec.allowed = options.who.allowed();
  spec.chairs = options.who.chairs;
  return std::make_unique<HumanScene>(spec, options.seed, options.clip, options.rate_hz);
}

std::unique_ptr<ChannelSource> open_channels(const SceneOptions& options) {
  auto scene = open_moving_scene(options);
  return scene ? solve_as_it_moves(std::move(scene)) : reflector_channels(options.rate_hz);
}

Impairments RadioOptions::impairments() const {
  Impairments on = sim::impairments(level_of(level));
  for (const NamedImpairment& it : named_impairments())
    if (std::find(off.begin(), off.end(), it.name) != off.end()) on.*it.member = false;
  on.power_up = power_up;
  return on;
}

std::string RadioOptions::words() const {
  std::string words = off.empty() ? level : fmt::format("{} less {}", level, fmt::join(off, ", "));
  return power_up == 0 ? words : fmt::format("{}, power-up {}", words, power_up);
}

void add_radio_options(CLI::App& command, RadioOptions& options) {
  command.add_option("--impair", options.level, "what the radio spoils")
      ->check(CLI::IsMember({"none", "mild", "5300"}))
      ->capture_default_str();
  command
      .add_option("--impair-off", options.off,
                  fmt::format("but not: {}", fmt::join(impairment_names(), ", ")))
      ->delimiter(',')
      ->check(CLI::IsMember(impairment_names()));
  command
      .add_option("--power-up", options.power_up,
                  "the cards stay as this powering up left them; 0: anew for each clip and seed")
      ->capture_default_str();
}

}  // namespace csipose::sim
