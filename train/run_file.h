// train/run_file.h - one TOML file says everything about a run: data, network, objective, where its files go.
//
// Each key is named once, in the table of run_file.cpp, with its range and its help; --set section.key=value has the last
// word. What a run was started with stands in each of its checkpoints, so that it can be told and gone on with.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "model/config.h"

namespace csipose::train {

struct RunSettings {
  struct {
    std::string out;  ///< folder of the run
    int seed = 0;
    int threads = 0;  ///< 0: as many as the machine has
    std::string device = "auto";
    std::string precision = "auto";
    double checkpoint_minutes = 10;
    double log_s = 10;
    int stop_after_steps = 0;  ///< 0: to the end
  } run;
  struct {
    std::string preset = "small";
    bool identity_conditioning = true;
    bool query_conditioning = true;
    bool background_conditioning = false;
    bool receiver_tokens = false;
    bool receiver_conditioning = false;
    bool flat_tokens = false;
    bool parity = false;
    std::string init = "fan_in";
  } network;
  struct {
    std::vector<std::string> train;
    std::vector<std::string> options;
    int take = 0;
    int most_people = 0;  ///< 0: any number
    double hold_out = 0.05;
    std::string norm = "corpus";
  } data;
  struct {
    std::string mask = "link";
    int epochs = 100, batch = 64;
    double lr = 0, lr_start = 1e-4, lr_final = 1e-6, warm_up = 0.1;
    double weight_decay = 0.05, weight_decay_final = 0;
    std::string ema = "cosine";
    double ema_start = 0.996;
  } pretrain;
  struct {
    std::string init, init_from = "context";
    int epochs = 100, batch = 32;
    double lr = 0, encoder_lr = 0, warm_up = 0.05;
    std::string schedule = "auto";
    double weight_decay = 1e-4, clip = 0.1, dropout = 0.1;
    double cls = 4, kpt = 70, refine = 70, root_relative = 0, ordered = 1, overlay = 0, map = 0;
    int overlay_people = 3;
    std::string error = "squared";
    bool proposal_bias = true, freeze_encoder = false, encoder_only = false;
    double lose_receiver = 0.2, lose_two_receivers = 0.05, lose_links = 0.1;
    int samples = 20;
    double all_samples_from = 0.8;
    int sigma_epochs = 2;
  } finetune;
};

/// Reads the file, then `set` ("section.key=value"). Throws SetupError (no_input, bad_config) whose words name every
/// mistake: file, line, key, why, and what is allowed. An empty path: defaults and `set` alone.
RunSettings read_run_file(const std::filesystem::path& path, const std::vector<std::string>& set);
/// The same from text, for what a checkpoint carries.
RunSettings parse_run_text(const std::string& text, const std::string& name);

/// All keys with their values as TOML; `with_help`: what each means and may be.
std::string to_toml(const RunSettings& settings, bool with_help);

/// The network that a run teaches, without the head for the expected error.
NetworkConfig network_of(const RunSettings& settings);

}  // namespace csipose::train
