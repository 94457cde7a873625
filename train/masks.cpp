#include "train/masks.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "proto/result.h"

namespace csipose::train {
namespace {

constexpr std::size_t kHiddenLinks = 5;      // round(0.6 * 9)
constexpr std::size_t kHiddenReceivers = 2;  // round(0.6 * 3)
constexpr std::size_t kHiddenTimes = 12;     // round(0.6 * 20)
constexpr std::size_t kHiddenTokens = 108;   // round(0.6 * 180)
constexpr std::size_t kTargetBlocks = 4;     // of ijepa
constexpr std::size_t kLeastContext = 10;    // of ijepa

/// A rectangle of tokens: `height` samples by `width` links.
struct Block {
  std::size_t top = 0, left = 0, height = 0, width = 0;
};
using Hidden = std::array<bool, kTokens>;

std::vector<std::size_t> choose(std::size_t count, std::size_t of, SeededRandom& random) {
  std::vector<std::size_t> all(of);
  std::iota(all.begin(), all.end(), std::size_t{0});
  for (std::size_t i = 0; i < count; ++i) std::swap(all[i], all[i + random.index(of - i)]);
  all.resize(count);
  std::sort(all.begin(), all.end());
  return all;
}

TokenList random_tokens(SeededRandom& random) {
  const std::vector<std::size_t> chosen = choose(kHiddenTokens, kTokens, random);
  return {chosen.begin(), chosen.end()};
}

TokenList list_of(const Hidden& hidden) {
  TokenList tokens;
  for (std::size_t token = 0; token < kTokens; ++token)
    if (hidden[token]) tokens.push_back(static_cast<std::int64_t>(token));
  return tokens;
}

void place(Block& block, SeededRandom& random) {
  block.top = random.index(kSamples - block.height + 1);
  block.left = random.index(kLinks - block.width + 1);
}

/// Tokens of a block in raster order.
TokenList tokens_in(const Block& block) {
  TokenList tokens;
  for (std::size_t t = block.top; t < block.top + block.height; ++t)
    for (std::size_t l = block.left; l < block.left + block.width; ++l)
      tokens.push_back(static_cast<std::int64_t>(t * kLinks + l));
  return tokens;
}

std::size_t rounded_within(double size, std::size_t most) {
  return std::clamp<std::size_t>(static_cast<std::size_t>(std::nearbyint(size)), 1, most);
}

/// Blocks of 15 to 20 % of the window until 108 tokens are covered; the last block gives back what is too many.
TokenList block_tokens(SeededRandom& random) {
  Hidden hidden{};
  std::size_t covered = 0;
  while (covered < kHiddenTokens) {
    const double area = random.uniform(0.15, 0.20) * kTokens, aspect = random.uniform(0.75, 1.5);
    Block block{0, 0, rounded_within(std::sqrt(area * aspect), kSamples - 1),
                rounded_within(std::sqrt(area / aspect), kLinks - 1)};
    place(block, random);
    TokenList fresh;
    for (const std::int64_t token : tokens_in(block))
      if (!hidden[static_cast<std::size_t>(token)]) fresh.push_back(token);
    for (const std::int64_t token : fresh) hidden[static_cast<std::size_t>(token)] = true;
    covered += fresh.size();
    for (; covered > kHiddenTokens; --covered, fresh.pop_back())
      hidden[static_cast<std::size_t>(fresh.back())] = false;
  }
  return list_of(hidden);
}

TokenList hidden_tokens(Masking masking, SeededRandom& random) {
  switch (masking) {
    case Masking::link:
      return tokens_of_columns(choose(kHiddenLinks, kLinks, random));
    case Masking::time:
      return tokens_of_times(choose(kHiddenTimes, kSamples, random));
    case Masking::random:
      return random_tokens(random);
    default:
      return block_tokens(random);
  }
}

/// Size of a block of ijepa: smaller than the window in both directions.
Block block_size(double least_area, double most_area, double least_aspect, double most_aspect,
                 SeededRandom& random) {
  const double area = random.uniform(least_area, most_area) * kTokens;
  const double aspect = random.uniform(least_aspect, most_aspect);
  return {0, 0, rounded_within(std::sqrt(area * aspect), kSamples - 1),
          rounded_within(std::sqrt(area / aspect), kLinks - 1)};
}

struct IjepaSample {
  TokenList context;
  std::vector<TokenList> targets;
};

IjepaSample draw_ijepa(Block target, Block context, SeededRandom& random) {
  for (;;) {
    IjepaSample sample;
    Hidden shown{};
    place(context, random);
    for (const std::int64_t token : tokens_in(context)) shown[static_cast<std::size_t>(token)] = true;
    for (std::size_t i = 0; i < kTargetBlocks; ++i) {
      place(target, random);
      sample.targets.push_back(tokens_in(target));
      for (const std::int64_t token : sample.targets.back()) shown[static_cast<std::size_t>(token)] = false;
    }
    sample.context = list_of(shown);
    if (sample.context.size() > kLeastContext) return sample;
  }
}

BatchMasks draw_ijepa_batch(std::uint64_t seed, std::uint64_t epoch, std::span<const std::uint64_t> samples) {
  SeededRandom sizes(seed, "mask sizes", {epoch, samples.front()});
  const Block target = block_size(0.15, 0.2, 0.75, 1.5, sizes), context = block_size(0.85, 1, 1, 1, sizes);
  BatchMasks masks;
  masks.targets.resize(kTargetBlocks);
  std::size_t shortest = kTokens;
  for (const std::uint64_t sample : samples) {
    SeededRandom random(seed, "mask", {epoch, sample});
    IjepaSample drawn = draw_ijepa(target, context, random);
    shortest = std::min(shortest, drawn.context.size());
    masks.context.push_back(std::move(drawn.context));
    for (std::size_t i = 0; i < kTargetBlocks; ++i) masks.targets[i].push_back(std::move(drawn.targets[i]));
  }
  for (TokenList& list : masks.context) list.resize(shortest);
  return masks;
}

/// Of the patch column, six samples of the row of all links' samples.
std::size_t owner(std::size_t column) {
  std::array<std::size_t, kLinks> samples{};
  for (std::size_t i = 0; i < kPatch; ++i) ++samples[(column * kPatch + i) / kSamples];
  return static_cast<std::size_t>(std::ranges::max_element(samples) - samples.begin());
}

/// Patch columns that these links own, ascending.
std::vector<std::size_t> columns_of(std::span<const std::size_t> links) {
  std::vector<std::size_t> columns;
  for (std::size_t column = 0; column < kFlatGrid.columns; ++column)
    if (std::ranges::find(links, owner(column)) != links.end()) columns.push_back(column);
  return columns;
}

}  // namespace

Masking masking_named(std::string_view name) {
  const auto* found = std::find(kMaskingNames.begin(), kMaskingNames.end(), name);
  if (found == kMaskingNames.end())
    throw SetupError(ExitStatus::usage, fmt::format("there is no masking '{}'; take one of {}", name,
                                                    fmt::join(kMaskingNames, ", ")));
  return static_cast<Masking>(found - kMaskingNames.begin());
}

TokenList tokens_of_columns(std::span<const std::size_t> columns, const TokenGrid& grid) {
  TokenList tokens;
  for (std::size_t row = 0; row < grid.rows; ++row)
    for (const std::size_t column : columns)
      tokens.push_back(static_cast<std::int64_t>(row * grid.columns + column));
  return tokens;
}

TokenList tokens_of_times(std::span<const std::size_t> times, const TokenGrid& grid) {
  TokenList tokens;
  for (const std::size_t t : times)
    for (std::size_t column = 0; column < grid.columns; ++column)
      tokens.push_back(static_cast<std::int64_t>(t * grid.columns + column));
  return tokens;
}

TokenList other_tokens(const TokenList& tokens, std::size_t count) {
  std::vector<bool> named(count);
  for (const std::int64_t token : tokens) named[static_cast<std::size_t>(token)] = true;
  TokenList rest;
  for (std::size_t token = 0; token < count; ++token)
    if (!named[token]) rest.push_back(static_cast<std::int64_t>(token));
  return rest;
}

TokenList flat_tokens_of_links(std::span<const std::size_t> links) {
  return tokens_of_columns(columns_of(links), kFlatGrid);
}

BatchMasks draw_masks(Masking masking, std::uint64_t seed, std::uint64_t epoch,
                      std::span<const std::uint64_t> samples) {
  if (masking == Masking::ijepa) return draw_ijepa_batch(seed, epoch, samples);
  BatchMasks masks;
  masks.targets.resize(1);
  for (const std::uint64_t sample : samples) {
    SeededRandom random(seed, "mask", {epoch, sample});
    masks.targets[0].push_back(hidden_tokens(masking, random));
    masks.context.push_back(other_tokens(masks.targets[0].back()));
  }
  return masks;
}

BatchMasks draw_receiver_masks(Masking masking, std::uint64_t seed, std::uint64_t epoch,
                               std::span<const std::uint64_t> samples) {
  if (masking != Masking::link && masking != Masking::time)
    throw SetupError(
        ExitStatus::bad_config,
        fmt::format("network.receiver_tokens goes with pretrain.mask = \"link\" or \"time\", not "
                    "\"{}\": its tokens are of a receiver's three links at once",
                    kMaskingNames[static_cast<std::size_t>(masking)]));
  BatchMasks masks;
  masks.targets.resize(1);
  for (const std::uint64_t sample : samples) {
    SeededRandom random(seed, "mask", {epoch, sample});
    masks.targets[0].push_back(
        masking == Masking::link
            ? tokens_of_columns(choose(kHiddenReceivers, kReceivers, random), kReceiverGrid)
            : tokens_of_times(choose(kHiddenTimes, kSamples, random), kReceiverGrid));
    masks.context.push_back(other_tokens(masks.targets[0].back(), kReceiverGrid.size()));
  }
  return masks;
}

BatchMasks draw_flat_masks(std::uint64_t seed, std::uint64_t epoch, std::span<const std::uint64_t> samples) {
  SeededRandom sizes(seed, "mask sizes", {epoch, samples.front()});
  const std::size_t columns = columns_of(choose(kHiddenLinks, kLinks, sizes)).size();
  BatchMasks masks;
  masks.targets.resize(1);
  for (const std::uint64_t sample : samples) {
    SeededRandom random(seed, "mask", {epoch, sample});
    std::vector<std::size_t> links;
    do links = choose(kHiddenLinks, kLinks, random);
    while (columns_of(links).size() != columns);
    masks.targets[0].push_back(flat_tokens_of_links(links));
    masks.context.push_back(other_tokens(masks.targets[0].back(), kFlatGrid.size()));
  }
  return masks;
}

}  // namespace csipose::train
