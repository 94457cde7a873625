#include "train/batch.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <map>
#include <set>

#include "model/background_meter.h"
#include "model/seeded_random.h"
#include "proto/result.h"
#include "proto/window.h"
#include "train/network.h"

namespace csipose::train {
namespace {

constexpr std::size_t kWindowNumbers = kChannels * kTokens;

/// Sums behind mean and deviation.
struct Moments {
  double count = 0, sum = 0, squares = 0;
  void add(std::span<const float> numbers) {
    for (const float number : numbers) {
      const auto value = static_cast<double>(number);
      sum += value;
      squares += value * value;
    }
    count += static_cast<double>(numbers.size());
  }
  double mean() const { return sum / std::max(count, 1.); }
  double deviation() const {
    return std::sqrt(std::max(squares / std::max(count, 1.) - mean() * mean(), 0.));
  }
};

Normalisation normalisation_of(const Moments& amplitude, const Moments& phase, const std::string& source) {
  const double phase_rms = std::sqrt(phase.squares / std::max(phase.count, 1.));
  if (!(amplitude.deviation() > 0) || !(phase_rms > 0) || !std::isfinite(amplitude.deviation() + phase_rms))
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("data set {}: its amplitudes or phases do not vary, or are no numbers", source));
  return {static_cast<float>(amplitude.mean()),
          static_cast<float>(amplitude.deviation()),
          static_cast<float>(phase_rms),
          {}};
}

/// That of the window's own installation, where it is known by name; as the daemon finds it otherwise.
const Background* background_of(const Normalisation& scaling, const std::string& room,
                                std::span<const float> x) {
  const auto named = std::ranges::find(scaling.backgrounds, room, &Background::name);
  if (named != scaling.backgrounds.end()) return &*named;
  return nearest_background(scaling.backgrounds, x, LinkSet().set()).background;
}

}  // namespace

Pool::Pool(std::vector<std::shared_ptr<const WindowSource>> sources)
    : sources_(std::move(sources)), first_{0} {
  for (const auto& source : sources_) first_.push_back(first_.back() + source->size());
  scaling_.resize(sources_.size());
}

std::pair<std::size_t, std::size_t> Pool::locate(std::size_t i) const {
  const auto above = std::upper_bound(first_.begin(), first_.end(), i);
  const auto source = static_cast<std::size_t>(above - first_.begin()) - 1;
  return {source, i - first_[source]};
}

std::string Pool::describe() const {
  std::string words;
  for (const auto& source : sources_)
    words += fmt::format("{}{} ({})", words.empty() ? "" : ", ", source->name(), source->size());
  return words;
}

void Pool::require_samples(std::size_t wanted, std::string_view what) const {
  for (const auto& source : sources_)
    if (source->samples() < wanted)
      throw SetupError(
          ExitStatus::bad_config,
          fmt::format(
              "data set {}: it keeps {} of a window's samples, {} takes {}; leave the set out, or make "
              "it with --snapshots {}",
              source->name(), source->samples(), what, wanted, wanted));
}

void Pool::read(std::size_t i, std::span<float> x) const {
  const auto [source, window] = locate(i);
  sources_[source]->read(window, x);
}
std::span<const Skeleton> Pool::people(std::size_t i) const {
  const auto [source, window] = locate(i);
  return sources_[source]->people(window);
}
std::uint64_t Pool::clip(std::size_t i) const {
  const auto [source, window] = locate(i);
  return (static_cast<std::uint64_t>(source) << 48) ^ sources_[source]->clip(window);
}

std::string Pool::installation(std::size_t i) const {
  const auto [source, window] = locate(i);
  return sources_[source]->room(window);
}

ScaledBy scaled_by(const std::string& norm) {
  if (norm == "pooled") return ScaledBy::all;
  return norm == "background" ? ScaledBy::background : ScaledBy::set;
}

void Pool::measure_scaling(std::span<const std::uint64_t> windows, ScaledBy by) {
  const bool together = by != ScaledBy::set;
  std::map<std::string, BackgroundMeter> rooms;
  std::vector<Moments> amplitude(sources_.size()), phase(sources_.size());
  std::vector<float> x(kWindowNumbers);
  constexpr std::size_t kAmplitudes = kSubcarriers * kTokens;
  for (const std::uint64_t i : windows) {
    const auto [source, window] = locate(i);
    sources_[source]->read(window, x);
    const std::size_t corpus = together ? 0 : source;
    amplitude[corpus].add(std::span(x).first(kAmplitudes));
    phase[corpus].add(std::span(x).subspan(kAmplitudes));
    if (by == ScaledBy::background) rooms[sources_[source]->room(window)].add(x);
  }
  if (together && amplitude[0].count > 0) {
    Normalisation scaling = normalisation_of(amplitude[0], phase[0], describe());
    for (const auto& [name, moments] : rooms) scaling.backgrounds.push_back(moments.background(name));
    return set_scaling(scaling);
  }
  for (std::size_t s = 0; s < sources_.size(); ++s)
    if (amplitude[s].count > 0) scaling_[s] = normalisation_of(amplitude[s], phase[s], sources_[s]->name());
}

void Pool::give_for(const NetworkConfig& config) {
  for (std::size_t s = 0; s < sources_.size() && config.background_conditioning; ++s)
    if (scaling_[s].backgrounds.empty())
      throw SetupError(
          ExitStatus::bad_config,
          fmt::format(
              "data set {}: no backgrounds are known, and network.background_conditioning tells the "
              "network of them; set data.norm to \"background\", or to \"init\" with a file that has them",
              sources_[s]->name()));
  flat_ = config.flat_tokens;
  given_ = config;
  given_.flat_tokens = false;
}

void Pool::write_tokens_of(std::uint64_t window, std::span<float> tokens) const {
  std::vector<float> x(kWindowNumbers);
  const auto [source, i] = locate(window);
  sources_[source]->read(i, x);
  write_tokens(given_, scaling_[source], background_of(scaling_[source], sources_[source]->room(i), x), x,
               LinkSet().set(), tokens);
}

/// What tokens say of the installation stays what it is.
void Pool::add_departures(std::uint64_t window, std::span<float> tokens) const {
  std::vector<float> others(tokens.size());
  write_tokens_of(window, others);
  for (std::size_t link = 0; link < tokens.size(); link += given_.link_numbers())
    for (std::size_t c = link; c < link + kChannels; ++c) tokens[c] += others[c];
}

at::Tensor Pool::tokens(std::span<const std::uint64_t> windows, const Added& added) const {
  assert(added.empty() || (added.size() == windows.size() && !flat_));
  const auto count = static_cast<std::int64_t>(windows.size());
  const std::size_t rows = given_.token_grid().size(), of_window = rows * given_.token_numbers();
  at::Tensor out =
      at::empty({count, static_cast<std::int64_t>(rows), static_cast<std::int64_t>(given_.token_numbers())});
  float* numbers = out.data_ptr<float>();
  at::parallel_for(0, count, 8, [&](std::int64_t from, std::int64_t to) {
    for (std::int64_t b = from; b < to; ++b) {
      const auto row = static_cast<std::size_t>(b);
      const std::span<float> here(numbers + row * of_window, of_window);
      write_tokens_of(windows[row], here);
      for (const std::uint64_t other : added.empty() ? std::vector<std::uint64_t>() : added[row])
        add_departures(other, here);
    }
  });
  return (flat_ ? flat_tokens_of(out) : out).to(device_);
}

People Pool::people_of(std::span<const std::uint64_t> windows, const Added& added) const {
  std::vector<std::vector<Skeleton>> all;
  std::size_t most = 0;
  for (std::size_t b = 0; b < windows.size(); ++b) {
    const std::span<const Skeleton> own = people(windows[b]);
    all.emplace_back(own.begin(), own.end());
    for (const std::uint64_t other : added.empty() ? std::vector<std::uint64_t>() : added[b]) {
      const std::span<const Skeleton> more = people(other);
      all.back().insert(all.back().end(), more.begin(), more.end());
    }
    most = std::max(most, all.back().size());
  }
  People out;
  out.poses =
      at::zeros({static_cast<std::int64_t>(windows.size()), static_cast<std::int64_t>(most), kPoseWidth});
  float* pose = out.poses.data_ptr<float>();
  for (const std::vector<Skeleton>& there : all) {
    out.count.push_back(static_cast<std::int64_t>(there.size()));
    float* number = pose;
    for (const Skeleton& person : there)
      for (const Point3& joint : person) {
        *number++ = joint.x;
        *number++ = joint.y;
        *number++ = joint.z;
      }
    pose += most * kPoseWidth;
  }
  out.poses = out.poses.to(device_);
  return out;
}

Split split_by_clip(const Pool& pool, double share, std::uint64_t seed) {
  std::set<std::uint64_t> clips;
  for (std::size_t i = 0; i < pool.size(); ++i) clips.insert(pool.clip(i));
  const std::vector<std::uint64_t> order = shuffled({clips.begin(), clips.end()}, seed, UINT64_MAX);
  const double wanted =
      share > 0 && clips.size() > 1 ? std::max(1., share * static_cast<double>(clips.size())) : 0;
  const auto held = static_cast<std::size_t>(std::lround(wanted));
  const std::set<std::uint64_t> out(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(held));
  Split split;
  for (std::size_t i = 0; i < pool.size(); ++i)
    (out.count(pool.clip(i)) > 0 ? split.held_out : split.train).push_back(i);
  return split;
}

std::vector<std::uint64_t> spread(const std::vector<std::uint64_t>& windows, std::size_t count) {
  if (count == 0 || count >= windows.size()) return windows;
  std::vector<std::uint64_t> some;
  for (std::size_t i = 0; i < count; ++i) some.push_back(windows[i * windows.size() / count]);
  return some;
}

std::vector<std::uint64_t> shuffled(std::vector<std::uint64_t> windows, std::uint64_t seed,
                                    std::uint64_t epoch) {
  SeededRandom random(seed, "shuffle", {epoch});
  for (std::size_t i = windows.size(); i > 1; --i) std::swap(windows[i - 1], windows[random.index(i)]);
  return windows;
}

}  // namespace csipose::train
