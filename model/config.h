// model/config.h - the sizes of a network, its presets, and the tensors that follow from them.
//
// Encoder: `depth` pre-LN transformer blocks of width `dim` over 180 tokens (20 samples x 9 links) of 60
// channels. Decoder: `queries` learned queries of width `decoder_dim` pass `decoder_layers` post-LN layers
// against the encoder's memory; `refine_layers` more layers then correct each of the 14 joints. The decoder
// follows PETR as in aiotgroup/Person-in-WiFi-3D-repo, the encoder follows facebookresearch/ijepa.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "proto/shape.h"
#include "proto/window.h"

namespace csipose {

/// How tokens lie: token = row * columns + column.
struct TokenGrid {
  std::size_t rows = kSamples, columns = kLinks;
  std::size_t size() const { return rows * columns; }
  bool operator==(const TokenGrid&) const = default;
};
/// Receiver tokens: the three links of a receiver, of one sample, in one.
inline constexpr TokenGrid kReceiverGrid = {kSamples, kReceivers};
/// Flat tokens: patches of 6 by 6 of the window as an image of 60 channels by 180 columns l * 20 + t.
inline constexpr std::size_t kPatch = 6;
inline constexpr TokenGrid kFlatGrid = {kChannels / kPatch, kTokens / kPatch};

struct NetworkConfig {
  std::string preset;             ///< "paper", "base", "small", "tiny", "micro", or "custom"
  std::size_t dim = 0;            ///< D, width of the encoder; a multiple of 4
  std::size_t depth = 0;          ///< blocks of the encoder
  std::size_t heads = 0;          ///< attention heads of the encoder; MLP width is 4 D
  std::size_t decoder_dim = 0;    ///< E, width of decoder and refinement
  std::size_t decoder_heads = 0;  ///< attention heads of decoder and refinement
  std::size_t ffn = 0;            ///< hidden width of the decoder's feed-forward
  std::size_t kpt_hidden = 0;     ///< hidden width of the keypoint heads
  std::size_t queries = 0;        ///< Q, at most 180
  std::size_t decoder_layers = 0;
  std::size_t refine_layers = 0;  ///< 0: the last decoder layer has the last word
  bool identity_conditioning =
      true;                         ///< refinement sees which person it refines; off in parity with the paper
  bool query_conditioning = false;  ///< queries see the poses they begin from; off in parity with the paper
  /// Tokens also say how much people move their link's channels in this installation; off in parity with the paper.
  bool background_conditioning = false;
  /// One token for each sample and receiver, its links side by side, in the place of one for each link: what an angle of arrival
  /// is read from, how a response differs between antennas, is then within a token. Off in parity with the paper.
  bool receiver_tokens = false;
  /// Each link's token also has the numbers of its receiver's other two. Off in parity with the paper.
  bool receiver_conditioning = false;
  /// Flat tokens in the place of one for each sample and link, for comparisons: training computes them, no engine does.
  bool flat_tokens = false;
  bool joint_sigma = false;  ///< has the head for the expected error per joint

  /// Numbers of a link in its token: its channels, and with background_conditioning as many of its installation.
  std::size_t link_numbers() const { return background_conditioning ? 2 * kChannels : kChannels; }
  /// Links whose numbers stand side by side in a token; not of flat ones.
  std::size_t token_links() const { return receiver_tokens || receiver_conditioning ? kAntennas : 1; }
  /// Which link is i-th in a column's tokens: a receiver's in turn, or the column's own and then those that follow it.
  std::size_t token_link(std::size_t column, std::size_t i) const {
    return receiver_tokens ? column * kAntennas + i
                           : column / kAntennas * kAntennas + (column + i) % kAntennas;
  }
  /// Those of all tokens of a sample, one after the other.
  std::vector<std::int64_t> token_links_in_turn() const;
  /// Numbers of a token: those of its links; or a patch.
  std::size_t token_numbers() const { return flat_tokens ? kPatch * kPatch : token_links() * link_numbers(); }
  TokenGrid token_grid() const {
    if (flat_tokens) return kFlatGrid;
    return receiver_tokens ? kReceiverGrid : TokenGrid{};
  }
  /// Is it there in a window with these links: its link, or one of its receiver's? Not of flat tokens.
  bool has_token(std::size_t token, LinkSet links) const {
    if (!receiver_tokens) return links[token % kLinks];
    return (links >> token % kReceivers * kAntennas & LinkSet(0b111)).any();
  }
  /// All that are, ascending; how many.
  std::vector<std::size_t> tokens_there(LinkSet links) const;
  std::size_t token_count(LinkSet links) const;

  bool operator==(const NetworkConfig&) const = default;
};

/// All presets, largest first.
std::vector<std::string_view> preset_names();
/// Throws SetupError (usage) that lists the presets when `preset` is none of them. Decoder heads are 32 wide
/// in all, as in the paper's (256 / 8).
NetworkConfig preset_config(std::string_view preset);

/// One line of JSON with every size and switch; `preset` is not in it.
std::string to_json(const NetworkConfig& config);
/// The inverse. Strict: every key once, none unknown, sizes that make a network; and a preset's name must go
/// with its sizes. Throws SetupError (bad data) with words that start with the culprit.
NetworkConfig config_from_json(const std::string& preset, const std::string& json);

/// Throws SetupError (bad_data): a network with flat tokens, which only training computes.
void require_engine_tokens(const NetworkConfig& config);

struct TensorSpec {
  std::string name;
  std::vector<std::size_t> shape;
};
/// Every tensor that the network computes with, in the order of computation. Names are those of
/// docs/weights.md.
std::vector<TensorSpec> required_tensors(const NetworkConfig& config);
/// Numbers in all of them together.
std::size_t parameter_count(const NetworkConfig& config);

}  // namespace csipose
