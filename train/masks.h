// train/masks.h - which of a window's 180 tokens pre-training hides, and which it shows.
//
// Every index list ascends. Draws depend on the generator alone: one for each (seed, epoch, sample), so that a run is the
// same whatever the threads, and after it was interrupted. Sources: link, time, random and block follow the WiFi-JEPA
// paper (60 % hidden); ijepa follows facebookresearch/ijepa, src/masks/multiblock.py.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "model/config.h"
#include "model/seeded_random.h"
#include "proto/shape.h"

namespace csipose::train {

enum class Masking : std::uint8_t { link, time, random, block, ijepa };
inline constexpr std::array<std::string_view, 5> kMaskingNames = {"link", "time", "random", "block", "ijepa"};
/// Throws SetupError (usage) that lists the names.
Masking masking_named(std::string_view name);

using TokenList = std::vector<std::int64_t>;

/// Tokens of these links (or receivers) at all samples; tokens of all links at these samples.
TokenList tokens_of_columns(std::span<const std::size_t> columns, const TokenGrid& grid = {});
TokenList tokens_of_times(std::span<const std::size_t> times, const TokenGrid& grid = {});
/// All of `count` tokens that `tokens` does not name.
TokenList other_tokens(const TokenList& tokens, std::size_t count = kTokens);
/// Flat tokens (model/config.h): all rows of the patch columns that these links own. A column belongs to the link of most of its
/// six samples, the lower one of two with as many.
TokenList flat_tokens_of_links(std::span<const std::size_t> links);

/// A batch's masks, rectangular: every sample has as many context tokens as the others, and as many in each target.
struct BatchMasks {
  std::vector<TokenList> context;               ///< [sample]
  std::vector<std::vector<TokenList>> targets;  ///< [target block][sample]; one block, with ijepa four
};

/// Masks for the samples `samples` of an epoch. link hides 5 links, time 12 samples of all links, random 108 tokens, block
/// 108 tokens in blocks that may overlap; ijepa predicts four blocks apart from each other out of one large block.
BatchMasks draw_masks(Masking masking, std::uint64_t seed, std::uint64_t epoch,
                      std::span<const std::uint64_t> samples);
/// Of receiver tokens: link hides all of two receivers, six of the nine links, time 12 samples. Throws SetupError (bad_config)
/// for the others, which tell the links of a receiver apart.
BatchMasks draw_receiver_masks(Masking masking, std::uint64_t seed, std::uint64_t epoch,
                               std::span<const std::uint64_t> samples);
/// Link masking of flat tokens: the columns of 5 links. Links own three columns or four, so how many of them own four is drawn
/// for the batch, and each sample's links among those that fit: any five links are as likely as any others.
BatchMasks draw_flat_masks(std::uint64_t seed, std::uint64_t epoch, std::span<const std::uint64_t> samples);

}  // namespace csipose::train
