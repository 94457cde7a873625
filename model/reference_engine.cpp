// model/reference.h behind the interface of engine.h: normalise, encode, decode, and keep every stage.
#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <map>

#include "model/engine.h"
#include "model/model.h"
#include "model/reference.h"

namespace csipose {
namespace {

using reference::Matrix;

class ReferenceEngine final : public Engine {
 public:
  explicit ReferenceEngine(std::shared_ptr<const Model> model) : model_(std::move(model)) {}

  std::span<const float> stage(const std::string& name) const override {
    const auto found = stages_.find(name);
    return found == stages_.end() ? std::span<const float>() : std::span<const float>(found->second);
  }

  Precision precision() const override { return Precision::f32; }
  std::string describe() const override { return "reference, plain loops, f32 with sums in f64, 1 thread"; }

 private:
  NetworkOutput infer(std::span<const float> x, LinkSet links, const Background* background) override {
    assert(links.any());
    stages_.clear();
    const NetworkConfig& c = model_->config();
    const std::vector<std::size_t> visible = c.tokens_there(links);
    const reference::EncoderOutput encoded =
        reference::encode(model_->tensors(), "encoder.", {c.dim, c.depth, c.heads, c.token_grid()},
                          normalised_tokens(x, links, background), visible);
    const Matrix memory = reference::linear(encoded.tokens, model_->tensors(), "proj");
    const reference::DecoderShape shape = {c.decoder_heads,         c.decoder_layers, c.refine_layers,
                                           c.identity_conditioning, c.joint_sigma,    c.query_conditioning};
    const reference::DecoderOutput decoded = reference::decode(model_->tensors(), shape, memory);
    keep(encoded, visible, memory);
    keep(decoded);
    const Matrix& last = decoded.refined.empty() ? decoded.kpt.back() : decoded.refined.back();
    stages_["poses"] = last.data;
    stages_["logits"] = decoded.cls.back().data;
    return {stages_["logits"], stages_["poses"], stages_["sigma"]};
  }

  Matrix normalised_tokens(std::span<const float> x, LinkSet links, const Background* background) const {
    const Normalisation& n = model_->normalisation();
    if (background == nullptr) background = nearest_background(n.backgrounds, x, links).background;
    const NetworkConfig& c = model_->config();
    const std::size_t numbers = c.token_numbers();
    Matrix present(c.token_count(links), numbers), tokens(c.token_grid().size(), numbers);
    write_tokens(c, n, background, x, links, present.data);
    std::size_t row = 0;
    for (const std::size_t token : c.tokens_there(links))
      std::copy_n(&present.data[row++ * numbers], numbers, &tokens.data[token * numbers]);
    return tokens;
  }

  void keep(const reference::EncoderOutput& encoded, std::span<const std::size_t> visible,
            const Matrix& memory) {
    stages_["embed"] = reference::gather(encoded.embed, visible).data;
    for (std::size_t i = 0; i < encoded.blocks.size(); ++i)
      stages_[fmt::format("block{}", i)] = encoded.blocks[i].data;
    stages_["encoder"] = encoded.tokens.data;
    stages_["memory"] = memory.data;
  }

  void keep(const reference::DecoderOutput& decoded) {
    stages_["enc_cls"] = decoded.enc_cls.data;
    stages_["enc_kpt"] = decoded.enc_kpt.data;
    stages_["topk"].assign(decoded.topk.begin(), decoded.topk.end());
    for (std::size_t i = 0; i < decoded.hidden.size(); ++i)
      stages_[fmt::format("layer{}", i)] = decoded.hidden[i].data;
    append("cls", decoded.cls);
    append("kpt", decoded.kpt);
    append("refined", decoded.refined);
    stages_["sigma"] = decoded.sigma_m.data;
  }

  void append(const std::string& name, const std::vector<Matrix>& layers) {
    std::vector<float>& all = stages_[name];
    for (const Matrix& layer : layers) all.insert(all.end(), layer.data.begin(), layer.data.end());
  }

  std::shared_ptr<const Model> model_;
  std::map<std::string, std::vector<float>> stages_;
};

}  // namespace

std::unique_ptr<Engine> make_reference_engine(std::shared_ptr<const Model> model) {
  require_engine_tokens(model->config());
  return std::make_unique<ReferenceEngine>(std::move(model));
}

}  // namespace csipose
