// Whole runs at micro size: they learn, they go on to the same bits, two processes make the steps of one.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <complex>
#include <cstdlib>
#include <numeric>
#include <set>

#include "model/engine.h"
#include "model/model.h"
#include "proto/npy.h"
#include "proto/result.h"
#include "tests/train/made_up_set.h"
#include "train/checkpoint.h"
#include "train/finetune.h"
#include "train/pretrain.h"
#include "train/schedules.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::MadeUpSet;

/// Windows of one snapshot, held.
class Instants final : public MadeUpSet {
 public:
  explicit Instants(std::size_t windows) : MadeUpSet(windows, 1, 1) {}
  std::string name() const override { return "instants"; }
  std::size_t samples() const override { return 1; }
};

/// Never fewer than two people in a window.
class Crowded : public MadeUpSet {
 public:
  explicit Crowded(std::size_t windows) : MadeUpSet(windows, 1, 1), two_(2, MadeUpSet::people(0)[0]) {}
  std::span<const Skeleton> people(std::size_t) const override { return two_; }

 private:
  std::vector<Skeleton> two_;
};

/// The same windows, three times as large.
class Louder : public MadeUpSet {
 public:
  explicit Louder(std::size_t windows) : MadeUpSet(windows, 1, 1) {}
  void read(std::size_t i, std::span<float> x) const override {
    MadeUpSet::read(i, x);
    for (float& number : x) number *= 3;
  }
};

class Runs : public ::testing::Test {
 protected:
  Runs() {
    fs::remove_all(folder_);
    settings_.run.threads = 1;
    prepare_machine(settings_);
    settings_.run.precision = "f32";
    settings_.run.log_s = 0;
    settings_.network.preset = "micro";
    settings_.pretrain.batch = settings_.finetune.batch = 8;
    settings_.pretrain.epochs = settings_.finetune.epochs = 1;
    settings_.finetune.sigma_epochs = 0;
    // Small networks and few steps: the published start, nothing beside the matched losses.
    settings_.network.init = "fixed";
    settings_.finetune.ordered = settings_.finetune.warm_up = 0;
  }
  ~Runs() override { fs::remove_all(folder_); }

  RunSettings in(const std::string& name) const {
    RunSettings settings = settings_;
    settings.run.out = (folder_ / name).string();
    return settings;
  }
  static Pool made_up(std::size_t windows, std::size_t most_people = 1) {
    return Pool({std::make_shared<MadeUpSet>(windows, most_people, 1)});
  }
  static std::vector<char> bytes_of(const fs::path& path) {
    std::ifstream file(path, std::ios::binary);
    EXPECT_TRUE(file) << path;
    return {std::istreambuf_iterator<char>(file), {}};
  }
  static void expect_same_tensors(const fs::path& a, const fs::path& b) {
    const Parameters one = read_weights(a).parameters, other = read_weights(b).parameters;
    ASSERT_EQ(one.size(), other.size());
    for (const auto& [name, tensor] : one) EXPECT_TRUE(tensor.equal(other[name])) << name;
  }

  fs::path folder_ = fs::temp_directory_path() / ("csipose_runs_" + std::to_string(::getpid()));
  RunSettings settings_;
};

TEST_F(Runs, PretrainingStoppedAndGoneOnWithMakesTheSameBits) {
  Pool pool = made_up(32);
  ASSERT_TRUE(pretrain(in("whole"), pool, Workers()).finished);
  RunSettings part = in("part");
  part.run.stop_after_steps = 2;
  const Outcome stopped = pretrain(part, pool, Workers());
  EXPECT_FALSE(stopped.finished);
  EXPECT_EQ(stopped.steps, 2u);
  part.run.stop_after_steps = 0;
  const Outcome ended = pretrain(part, pool, Workers());
  EXPECT_TRUE(ended.finished);
  EXPECT_EQ(ended.steps, 4u);
  expect_same_tensors(folder_ / "whole/pretrained.safetensors", folder_ / "part/pretrained.safetensors");
  EXPECT_EQ(bytes_of(folder_ / "whole/step-00000004.optim.safetensors"),
            bytes_of(folder_ / "part/step-00000004.optim.safetensors"));
}

TEST_F(Runs, TwoAtOnceInAFolderAreRefusedAndOneAfterTheOtherAreNot) {
  Pool pool = made_up(48, 2);
  {
    CheckpointFolder other(in("run").run.out);
    other.claim();
    for (const auto& run : {pretrain, finetune}) try {
        run(in("run"), pool, Workers());
        ADD_FAILURE() << "not refused";
      } catch (const SetupError& error) {
        EXPECT_EQ(error.status, ExitStatus::try_again);
        EXPECT_NE(std::string(error.what()).find(in("run").run.out), std::string::npos) << error.what();
      }
    EXPECT_FALSE(other.newest());
  }
  EXPECT_TRUE(finetune(in("run"), pool, Workers()).finished);
}

TEST_F(Runs, FineTuningStoppedAndGoneOnWithMakesTheSameBits) {
  Pool pool = made_up(48, 2);
  settings_.finetune.epochs = 2;
  settings_.finetune.sigma_epochs = 1;
  settings_.finetune.lose_receiver = 0.5;
  ASSERT_TRUE(finetune(in("whole"), pool, Workers()).finished);
  for (const int stop : {2, 6, 13, 0}) {
    RunSettings part = in("part");
    part.run.stop_after_steps = stop;
    finetune(part, pool, Workers());
  }
  expect_same_tensors(folder_ / "whole/best.safetensors", folder_ / "part/best.safetensors");
  expect_same_tensors(folder_ / "whole/last.safetensors", folder_ / "part/last.safetensors");
}

TEST_F(Runs, AFolderOfAnotherRunIsRefused) {
  Pool pool = made_up(16);
  pretrain(in("run"), pool, Workers());
  RunSettings other = in("run");
  other.pretrain.mask = "time";
  EXPECT_THROW(pretrain(other, pool, Workers()), SetupError);
}

TEST_F(Runs, TooFewWindowsForABatchAreRefused) {
  Pool pool = made_up(4);
  EXPECT_THROW(pretrain(in("run"), pool, Workers()), SetupError);
}

TEST_F(Runs, ADeviceThatIsNotThereIsRefused) {
  if (torch::cuda::device_count() > 0) GTEST_SKIP() << "there is one";
  RunSettings settings = in("run");
  EXPECT_TRUE(device_of(settings, Workers()).is_cpu());
  settings.run.device = "cuda";
  Pool pool = made_up(16);
  try {
    finetune(settings, pool, Workers());
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::unavailable);
    EXPECT_NE(std::string(error.what()).find("run.device is cuda"), std::string::npos) << error.what();
  }
}

TEST_F(Runs, PretrainingLowersItsLossAndFeedsFineTuning) {
  Pool pool = made_up(64);
  settings_.pretrain.epochs = 12;
  ASSERT_TRUE(pretrain(in("jepa"), pool, Workers()).finished);
  std::ifstream log(folder_ / "jepa/log.csv");
  std::vector<double> losses;
  for (std::string line; std::getline(log, line);)
    if (const std::size_t at = line.find(",loss,"); at != std::string::npos)
      losses.push_back(std::stod(line.substr(at + 6)));
  ASSERT_EQ(losses.size(), 96u);
  EXPECT_LT(losses[90], 0.7 * losses[0]);

  settings_.finetune.init = (folder_ / "jepa/pretrained.safetensors").string();
  RunSettings tuned = in("tuned");
  tuned.run.stop_after_steps = 1;
  finetune(tuned, pool, Workers());
  const auto model = Model::load(folder_ / "tuned/step-00000001.safetensors");
  EXPECT_EQ(model->provenance().stage, "finetuned");
  const Parameters before = read_weights(settings_.finetune.init).parameters;
  const Parameters after = read_weights(folder_ / "tuned/step-00000001.safetensors").parameters;
  const double moved = (before["encoder.blocks.0.mlp.fc1.weight"] - after["encoder.blocks.0.mlp.fc1.weight"])
                           .abs()
                           .max()
                           .item<double>();
  EXPECT_LT(moved, 1e-3);  // one small step away from where pre-training ended
}

// The encoder alone, from the map; then everything, from what it has learnt.
TEST_F(Runs, TheEncoderLearnsAloneFirst) {
  Pool pool = made_up(64, 2);
  settings_.data.hold_out = 0.2;
  settings_.finetune.ordered = 0;
  settings_.finetune.map = 1;
  settings_.finetune.lr = 1e-3;
  settings_.finetune.encoder_lr = 1;
  RunSettings alone = in("alone");
  alone.finetune.encoder_only = true;
  alone.finetune.sigma_epochs = 0;
  alone.finetune.epochs = 8;
  ASSERT_TRUE(finetune(alone, pool, Workers()).finished);
  const Parameters first = untrained_weights(preset_config("micro"), 0).parameters;
  const Parameters learnt = read_weights(folder_ / "alone/best.safetensors").parameters;
  EXPECT_FALSE(learnt["encoder.blocks.0.mlp.fc1.weight"].equal(first["encoder.blocks.0.mlp.fc1.weight"]));
  EXPECT_TRUE(learnt["decoder.layers.0.linear1.weight"].equal(first["decoder.layers.0.linear1.weight"]));
  std::ifstream log(folder_ / "alone/log.csv");
  std::vector<double> losses;
  for (std::string line; std::getline(log, line);)
    if (const std::size_t at = line.find(",map,"); at != std::string::npos)
      losses.push_back(std::stod(line.substr(at + 5)));
  ASSERT_GT(losses.size(), 8u);
  EXPECT_LT(losses.back(), 0.9 * losses.front());

  settings_.finetune.init = (folder_ / "alone/best.safetensors").string();
  RunSettings all = in("all");
  all.run.stop_after_steps = 1;
  finetune(all, pool, Workers());
  const Parameters taken = read_weights(folder_ / "all/step-00000001.safetensors").parameters;
  EXPECT_LT((taken["predictor.map.2.weight"] - learnt["predictor.map.2.weight"]).abs().max().item<double>(),
            2e-3);
}

TEST(RunFile, AnEncoderThatNothingTeachesIsRefused) {
  EXPECT_THROW(
      read_run_file("", {"finetune.encoder_only=true", "finetune.sigma_epochs=0", "finetune.ordered=0"}),
      SetupError);
  EXPECT_THROW(read_run_file("", {"finetune.encoder_only=true", "finetune.map=1"}), SetupError);
}

// Eight windows, from scratch, learnt by heart; and the daemon's engine says what training says.
TEST_F(Runs, OverfittingReachesTenMillimetres) {
  Pool pool = made_up(8, 1);
  settings_.data.hold_out = 0;
  settings_.finetune.batch = 8;
  settings_.finetune.epochs = 500;
  settings_.finetune.lr =
      7e-4;  // 1 to 3 mm with every kernel of OpenBLAS that was tried; 350 steps at 1e-3: 1 to 53 mm
  settings_.finetune.encoder_lr = 1;
  const RunSettings defaults;  // the recipe that people get
  settings_.network.init = defaults.network.init;
  settings_.finetune.ordered = defaults.finetune.ordered;
  settings_.finetune.warm_up = defaults.finetune.warm_up;
  settings_.finetune.dropout = settings_.finetune.weight_decay = 0;
  settings_.finetune.lose_receiver = settings_.finetune.lose_two_receivers = settings_.finetune.lose_links =
      0;
  settings_.run.log_s = 5;
  settings_.run.precision = "f32";
  ASSERT_TRUE(finetune(in("overfit"), pool, Workers()).finished);
  const Weights weights = read_weights(folder_ / "overfit/last.safetensors");
  std::vector<std::uint64_t> all(pool.size());
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
  EXPECT_LT(1000 * oracle_error_m(weights.parameters, weights.config, pool, all, Numerics{}), 10);

  const auto model = Model::load(folder_ / "overfit/last.safetensors");
  const auto engine = make_reference_engine(model);
  std::vector<float> x(kChannels * kTokens);
  pool.read(5, x);
  const NetworkOutput theirs = engine->run(x, LinkSet().set());
  const std::array<std::uint64_t, 1> one = {5};
  const Poses ours = infer(weights.parameters, weights.config, pool.tokens(one), {}, Numerics{});
  for (std::int64_t i = 0; i < ours.joints.numel(); ++i)
    ASSERT_NEAR(ours.joints.flatten()[i].item<float>(), theirs.poses[static_cast<std::size_t>(i)], 1e-4);
}

// ---- which tokens a step sees ----

TEST_F(Runs, StepsSeeAFewSamplesAtFirstAndAllInTheEnd) {
  settings_.finetune.lose_receiver = settings_.finetune.lose_two_receivers = settings_.finetune.lose_links =
      0;
  settings_.finetune.samples = 5;
  settings_.finetune.all_samples_from = 0.5;
  const std::array<std::uint64_t, 3> windows = {4, 9, 2};
  const at::Tensor early = surviving_tokens(settings_, {50, 100, 3}, windows).tokens;
  ASSERT_EQ(early.sizes(), at::IntArrayRef({3, 5 * static_cast<std::int64_t>(kLinks)}));
  for (int w = 0; w < 3; ++w) {
    std::set<std::int64_t> samples;
    for (int i = 0; i < early.size(1); ++i) {
      const auto token = early[w][i].item<std::int64_t>();
      samples.insert(token / static_cast<std::int64_t>(kLinks));
      EXPECT_EQ(token % static_cast<std::int64_t>(kLinks),
                i % static_cast<int>(kLinks));  // all links of each sample
      if (i > 0) {
        EXPECT_GT(token, early[w][i - 1].item<std::int64_t>());
      }
    }
    ASSERT_EQ(samples.size(), 5u);
    std::int64_t fifth = 0;
    for (const std::int64_t sample : samples)
      EXPECT_EQ(sample / 4, fifth++) << "one of each part of the window";
  }
  EXPECT_FALSE(early[0].equal(early[1]));
  EXPECT_TRUE(
      early.equal(surviving_tokens(settings_, {49, 100, 3}, windows).tokens));  // by epoch and window alone
  EXPECT_FALSE(early.equal(surviving_tokens(settings_, {50, 100, 4}, windows).tokens));
  EXPECT_FALSE(surviving_tokens(settings_, {51, 100, 3}, windows).tokens.defined());

  settings_.finetune.lose_two_receivers = 1;
  const at::Tensor one_receiver = surviving_tokens(settings_, {50, 100, 3}, windows).tokens;
  EXPECT_EQ(one_receiver.size(1), 5 * static_cast<std::int64_t>(kAntennas));
  EXPECT_EQ(surviving_tokens(settings_, {51, 100, 3}, windows).tokens.size(1),
            static_cast<std::int64_t>(kSamples * kAntennas));
}

TEST_F(Runs, MostPeopleLeavesCrowdedWindowsOut) {
  Pool pool = made_up(64, 3);
  RunSettings settings = in("few");
  settings.data.hold_out = 0;
  settings.data.most_people = 1;
  settings.finetune.batch = 2;
  std::size_t alone = 0;
  for (std::size_t i = 0; i < pool.size(); ++i) alone += pool.people(i).size() == 1;
  ASSERT_GT(alone, 8u);
  ASSERT_LT(alone, 32u);
  EXPECT_EQ(finetune(settings, pool, Workers()).steps, alone / 2);
  settings.run.out = (folder_ / "none").string();
  Pool nobody({std::make_shared<Crowded>(8)});
  EXPECT_THROW(finetune(settings, nobody, Workers()), SetupError);
}

TEST_F(Runs, ARunThatGoesOnFromWeightsMayKeepTheirScaling) {
  Pool first = made_up(16);
  RunSettings settings = in("first");
  settings.data.hold_out = 0;
  settings.data.norm = "corpus";
  finetune(settings, first, Workers());
  settings.finetune.init = (folder_ / "first/last.safetensors").string();
  settings.run.out = (folder_ / "second").string();
  settings.data.norm = "init";
  Pool louder({std::make_shared<Louder>(24)});
  finetune(settings, louder, Workers());
  EXPECT_EQ(louder.scaling()[0].amp_std, first.scaling()[0].amp_std);
  const auto model = Model::load(folder_ / "second/last.safetensors");
  EXPECT_EQ(model->normalisation().amp_mean, first.scaling()[0].amp_mean);
  EXPECT_EQ(model->provenance().corpus, "made-up (16); then made-up (24)");
  settings.finetune.init.clear();
  settings.run.out = (folder_ / "third").string();
  EXPECT_THROW(finetune(settings, louder, Workers()), SetupError);
  EXPECT_THROW(pretrain(settings, louder, Workers()), SetupError);
}

TEST_F(Runs, WindowsOfFewSamplesAreRefusedWhereAStepTakesMore) {
  Pool pool({std::make_shared<MadeUpSet>(8, 1, 1), std::make_shared<Instants>(8)});
  const auto refusal = [&](const RunSettings& settings) {
    try {
      (void)finetune(settings, pool, Workers());
    } catch (const SetupError& error) {
      return std::string(error.what());
    }
    return std::string("none");
  };
  RunSettings settings = in("instants");
  settings.data.hold_out = 0;
  settings.finetune.sigma_epochs = 0;
  settings.finetune.samples = 1;
  settings.finetune.all_samples_from = 1;
  EXPECT_EQ(refusal(settings), "none");
  RunSettings more = settings;
  more.finetune.samples = 2;
  EXPECT_NE(refusal(more).find("instants: it keeps 1 of a window's samples, finetune.samples takes 2"),
            std::string::npos);
  more = settings;
  more.finetune.all_samples_from = 0.5;
  EXPECT_NE(refusal(more).find("finetune.all_samples_from below 1 takes 20"), std::string::npos);
  more = settings;
  more.finetune.sigma_epochs = 1;
  EXPECT_NE(refusal(more).find("finetune.sigma_epochs takes 20"), std::string::npos);
  EXPECT_THROW(pretrain(settings, pool, Workers()), SetupError);
}

TEST(Pool, IsScaledBySetsOrTogether) {
  const auto plain = std::make_shared<MadeUpSet>(8, 1, 1);
  const auto loud = std::make_shared<Louder>(8);
  Pool pool({plain, loud});
  std::vector<std::uint64_t> all(pool.size());
  std::iota(all.begin(), all.end(), std::uint64_t{0});
  pool.measure_scaling(all);
  const auto each = pool.scaling();
  EXPECT_NEAR(each[1].amp_std, 3 * each[0].amp_std, 1e-4);
  EXPECT_NEAR(pool.tokens(all).narrow(2, 0, kSubcarriers).std().item<double>(), 1, 1e-3);
  pool.measure_scaling(all, ScaledBy::all);
  const auto together = pool.scaling();
  EXPECT_EQ(together[0].amp_std, together[1].amp_std);
  EXPECT_EQ(together[0].ph_std, together[1].ph_std);
  // Two sets of the same size, one three times the other: mean of squares (1 + 9) / 2, mean (1 + 3) / 2.
  const double m = each[0].amp_mean, v = std::pow(each[0].amp_std, 2);
  EXPECT_NEAR(together[0].amp_mean, 2 * m, 1e-4);
  EXPECT_NEAR(std::pow(together[0].amp_std, 2), 5 * (v + m * m) - 4 * m * m, 1e-3);
}

/// The same people before walls of 20, as cards hear them whose branches turn link l by l `turn`.
class Installed : public MadeUpSet {
 public:
  Installed(std::size_t windows, double gain, double turn, std::string room)
      : MadeUpSet(windows, 1, 1), gain_(gain), turn_(turn), room_(std::move(room)) {}
  void read(std::size_t i, std::span<float> x) const override {
    MadeUpSet::read(i, x);
    const std::size_t first_phase = x.size() / 2;
    for (std::size_t n = 0; n < first_phase; ++n) {
      const std::complex<double> people(static_cast<double>(x[n]), static_cast<double>(x[first_phase + n]));
      const std::complex<double> heard =
          (20. + people) * std::polar(gain_, turn_ * static_cast<double>(n % kLinks));
      x[n] = static_cast<float>(std::abs(heard));
      x[first_phase + n] = static_cast<float>(std::arg(heard));
    }
  }
  std::string room(std::size_t) const override { return room_; }

 private:
  double gain_, turn_;
  std::string room_;
};

TEST_F(Runs, WindowsAreScaledByTheirInstallations) {
  Pool pool({std::make_shared<Installed>(200, 1, 0.2, "here"),
             std::make_shared<Installed>(200, 3, 2.5, "elsewhere")});
  std::vector<std::uint64_t> all(pool.size());
  std::iota(all.begin(), all.end(), std::uint64_t{0});
  pool.measure_scaling(all, ScaledBy::background);
  const Normalisation& scaling = pool.scaling().front();
  ASSERT_EQ(scaling.backgrounds.size(), 2u);
  EXPECT_EQ(scaling.backgrounds[0].name, "elsewhere");
  EXPECT_EQ(scaling.backgrounds[1].name, "here");
  const at::Tensor tokens = pool.tokens(all);
  for (const std::int64_t first : {0, 200}) {  // each of them alone: the middle samples are what was measured
    const at::Tensor part = tokens.narrow(0, first, 200).narrow(1, kTokens / 2, kLinks);
    EXPECT_LT((part.square().mean(0) - 1).abs().max().item<double>(), 1e-3);
  }
  // What the cards do falls out.
  EXPECT_LT((tokens.narrow(0, 0, 200) - tokens.narrow(0, 200, 200)).abs().max().item<double>(), 0.01);

  // What is written is what the daemon's side reads and does.
  fs::create_directories(folder_);
  for (const int kind : {0, 1, 2}) {
    NetworkConfig config = preset_config("micro");
    config.background_conditioning = kind > 0;
    config.receiver_tokens = kind == 1;
    config.receiver_conditioning = kind == 2;
    pool.give_for(config);
    Weights weights = untrained_weights(config, 1);
    set_normalisation(weights, scaling);
    write_weights(folder_ / "w.safetensors", weights);
    const auto engine = make_reference_engine(Model::load(folder_ / "w.safetensors"));
    std::vector<float> x(kChannels * kTokens);
    for (const std::uint64_t window : {5, 205}) {
      pool.read(window, x);
      const NetworkOutput theirs = engine->run(x, LinkSet().set());
      const at::Tensor ours =
          infer(weights.parameters, weights.config, pool.tokens(std::array{window}), {}, Numerics{})
              .joints.flatten();
      for (std::int64_t i = 0; i < ours.numel(); ++i)
        ASSERT_NEAR(ours[i].item<float>(), theirs.poses[static_cast<std::size_t>(i)], 1e-4);
    }
  }
}

// ---- the people of several windows at once ----

TEST_F(Runs, DeparturesOfOneInstallationAddUp) {
  Pool pool({std::make_shared<Installed>(50, 1, 0.2, "here"),
             std::make_shared<Installed>(50, 3, 2.5, "elsewhere")});
  std::vector<std::uint64_t> all(pool.size());
  std::iota(all.begin(), all.end(), std::uint64_t{0});
  pool.measure_scaling(all, ScaledBy::background);
  NetworkConfig config = preset_config("micro");
  config.background_conditioning = config.receiver_tokens = true;
  pool.give_for(config);
  const std::array<std::uint64_t, 2> windows = {3, 60};
  const Added added = {{7, 9}, {}};
  const std::array<std::uint64_t, 3> each = {3, 7, 9};
  const at::Tensor one_by_one = pool.tokens(each).view({3, 180, 2, kChannels}),
                   together = pool.tokens(windows, added).view({2, 180, 2, kChannels});
  const auto off = [](const at::Tensor& a, const at::Tensor& b) { return (a - b).abs().max().item<float>(); };
  EXPECT_LT(off(together[0].select(1, 0), one_by_one.select(2, 0).sum(0)), 1e-4f);
  EXPECT_EQ(off(together[0].select(1, 1), one_by_one[0].select(1, 1)), 0) << "of the installation, as it is";
  EXPECT_TRUE(together[1].flatten().equal(pool.tokens(windows)[1].flatten()));

  const People people = pool.people_of(windows, added);
  ASSERT_EQ(people.count, (std::vector<std::int64_t>{3, 1}));
  const People apart = pool.people_of(each);
  for (std::int64_t p = 0; p < 3; ++p) EXPECT_TRUE(people.poses[0][p].equal(apart.poses[p][0])) << p;
}

TEST_F(Runs, PeopleAreAddedWithinAnInstallationAndToALimit) {
  Pool pool({std::make_shared<Installed>(50, 1, 0.2, "here"),
             std::make_shared<Installed>(50, 3, 2.5, "elsewhere")});
  std::vector<std::uint64_t> all(pool.size());
  std::iota(all.begin(), all.end(), std::uint64_t{0});
  EXPECT_TRUE(added_people(settings_, pool, all, {1, 10, 0}, all).empty()) << "unless it is asked for";
  settings_.finetune.overlay = 0.5;
  const Added added = added_people(settings_, pool, all, {1, 10, 0}, all);
  std::map<std::size_t, int> counts;
  for (std::size_t b = 0; b < all.size(); ++b) {
    ++counts[added[b].size()];
    for (const std::uint64_t other : added[b]) EXPECT_EQ(other < 50, b < 50) << "of the other installation";
  }
  EXPECT_EQ(counts.size(), 3u);  // none, one, two added to the one who is there
  EXPECT_NEAR(counts[0], 50, 20);
  EXPECT_NEAR(counts[2], 25, 15);
  EXPECT_EQ(added_people(settings_, pool, all, {2, 10, 0}, std::array{std::uint64_t{8}})[0], added[8])
      << "by epoch and window alone";
  EXPECT_NE(added_people(settings_, pool, all, {1, 10, 1}, all), added);

  settings_.data.norm = "corpus";
  EXPECT_THROW(finetune(settings_, pool, Workers()), SetupError) << "no background to depart from";
}

TEST_F(Runs, ReceiverTokensLoseLinksWithinThem) {
  settings_.network.receiver_tokens = true;
  settings_.finetune.lose_receiver = settings_.finetune.lose_two_receivers = 0;
  settings_.finetune.lose_links = 1;
  settings_.finetune.samples = 20;
  const std::array<std::uint64_t, 5> windows = {4, 9, 2, 11, 30};
  std::set<std::int64_t> lost;
  for (std::uint64_t epoch = 0; epoch < 30; ++epoch) {
    const Survivors left = surviving_tokens(settings_, {1, 10, epoch}, windows);
    ASSERT_EQ(left.tokens.sizes(), at::IntArrayRef({5, 60}));
    for (int w = 0; w < 5; ++w) {
      const at::Tensor receivers = left.links[w].view({3, 3}).sum(1);
      EXPECT_GE(receivers.min().item<float>(), 1) << "a receiver without links is another failure";
      lost.insert(9 - left.links[w].sum().item<std::int64_t>());
    }
  }
  EXPECT_EQ(lost, (std::set<std::int64_t>{1, 2, 3}));

  settings_.finetune.lose_links = 0;
  settings_.finetune.lose_receiver = 1;
  const Survivors left = surviving_tokens(settings_, {1, 10, 0}, windows);
  EXPECT_EQ(left.tokens.sizes(), at::IntArrayRef({5, 40}));
  EXPECT_FALSE(left.links.defined());
}

// A link's token has its receiver's other links: of one that is lost, neither its own token nor what the others have of it.
TEST_F(Runs, LostLinksAreLostToTheirReceiversOthersToo) {
  settings_.network.receiver_conditioning = true;
  settings_.finetune.lose_receiver = settings_.finetune.lose_two_receivers = 0;
  settings_.finetune.lose_links = 1;
  settings_.finetune.samples = 20;
  const std::array<std::uint64_t, 5> windows = {4, 9, 2, 11, 30};
  const Survivors left = surviving_tokens(settings_, {1, 10, 0}, windows);
  ASSERT_TRUE(left.links.defined());
  const NetworkConfig config = network_of(settings_);
  at::Tensor tokens = at::ones({5, 180, 3 * kChannels});
  silence(tokens, config, left.links);
  for (int w = 0; w < 5; ++w)
    for (std::int64_t row = 0; row < 180; ++row)
      for (std::int64_t i = 0; i < 3; ++i) {
        const std::int64_t link = row % 9, other = link - link % 3 + (link + i) % 3;
        EXPECT_EQ(tokens[w][row].narrow(0, i * kChannels, kChannels).mean().item<float>(),
                  left.links[w][other].item<float>());
      }
}

TEST_F(Runs, PretrainingHidesNoLinkThatOtherTokensHave) {
  Pool pool = made_up(16);
  settings_.network.receiver_conditioning = true;
  EXPECT_THROW(pretrain(in("links"), pool, Workers()), SetupError);
  settings_.pretrain.mask = "time";
  EXPECT_TRUE(pretrain(in("times"), pool, Workers()).finished);
}

// What was learnt without being told of backgrounds goes on as it was, and learns of them.
TEST_F(Runs, ARunMayBeginToTellOfBackgrounds) {
  const auto made = [] {
    return Pool({std::make_shared<Installed>(40, 1, 0.2, "here"),
                 std::make_shared<Installed>(40, 3, 2.5, "elsewhere")});
  };
  Pool first = made();
  RunSettings settings = in("untold");
  settings.data.hold_out = 0.1;
  settings.data.norm = "background";
  finetune(settings, first, Workers());
  settings.finetune.init = (folder_ / "untold/last.safetensors").string();
  settings.run.out = (folder_ / "told").string();
  settings.network.background_conditioning = true;
  settings.finetune.lr = 1e-12;
  settings.finetune.weight_decay = 0;
  Pool second = made();
  finetune(settings, second, Workers());
  const auto weight = [&](const char* run) {
    return read_weights(folder_ / run / "last.safetensors").parameters["encoder.patch_embed.proj.weight"];
  };
  EXPECT_LT((weight("told").narrow(1, 0, kChannels) - weight("untold")).abs().max().item<float>(), 1e-8f);
  EXPECT_LT(weight("told").narrow(1, kChannels, kChannels).abs().max().item<float>(), 1e-8f);

  settings.finetune.lr = 1e-3;
  settings.run.out = (folder_ / "learnt").string();
  finetune(settings, second, Workers());
  EXPECT_GT(weight("learnt").narrow(1, kChannels, kChannels).abs().max().item<float>(), 0);

  // The same goes for the other links of a token's receiver, from either of the two.
  settings.finetune.lr = 1e-12;
  settings.network.receiver_conditioning = true;
  for (const auto& [from, numbers] : {std::pair("untold", kChannels), std::pair("learnt", 2 * kChannels)}) {
    settings.finetune.init = (folder_ / from / "last.safetensors").string();
    settings.run.out = (folder_ / from / "among_others").string();
    Pool third = made();
    finetune(settings, third, Workers());
    const at::Tensor now = read_weights(fs::path(settings.run.out) / "last.safetensors")
                               .parameters["encoder.patch_embed.proj.weight"];
    ASSERT_EQ(now.size(1), 6 * kChannels);
    EXPECT_LT((now.narrow(1, 0, numbers) - weight(from)).abs().max().item<float>(), 1e-8f) << from;
    EXPECT_LT(now.slice(1, numbers).abs().max().item<float>(), 1e-8f) << from;
  }
  settings.network.receiver_conditioning = false;
  settings.network.receiver_tokens = true;
  settings.finetune.init = settings.run.out + "/last.safetensors";
  settings.run.out = (folder_ / "of_receivers").string();
  EXPECT_THROW(finetune(settings, second, Workers()), SetupError) << "the same shape, and other tokens";
  settings.network.receiver_tokens = false;
  settings.finetune.lr = 1e-3;
  settings.finetune.init = (folder_ / "untold/last.safetensors").string();

  settings.run.out = (folder_ / "larger").string();
  settings.network.preset = "tiny";
  EXPECT_THROW(finetune(settings, second, Workers()), SetupError) << "weights of another size";
  settings.network.preset = "micro";
  settings.finetune.init = (folder_ / "learnt/last.safetensors").string();
  settings.network.background_conditioning = false;
  EXPECT_THROW(finetune(settings, second, Workers()), SetupError) << "what it was told would be lost";
  settings.network.background_conditioning = true;

  settings.data.norm = "corpus";
  settings.run.out = (folder_ / "without").string();
  EXPECT_THROW(finetune(settings, second, Workers()), SetupError);
  EXPECT_THROW(pretrain(settings, second, Workers()), SetupError);
}

TEST(Pool, RefusesABackgroundThatDoesNotVary) {
  Pool one({std::make_shared<MadeUpSet>(1, 1, 1)});
  EXPECT_THROW(one.measure_scaling(std::array{std::uint64_t{0}}, ScaledBy::background), SetupError);
}

TEST(Spread, TakesWindowsFromEverywhere) {
  const std::vector<std::uint64_t> all = {3, 5, 7, 9, 11, 13, 15};
  EXPECT_EQ(spread(all, 3), (std::vector<std::uint64_t>{3, 7, 11}));
  EXPECT_EQ(spread(all, 0), all);
  EXPECT_EQ(spread(all, 8), all);
}

TEST(FanIn, EachMatrixGetsTheDeviationOfItsInputs) {
  const Parameters weights = initial_network(preset_config("tiny"), 1);
  const double norm = weights["encoder.norm.weight"].sum().item<double>();
  scale_to_fan_in(weights, "encoder.");
  for (const auto& [name, inputs] : {std::pair("encoder.patch_embed.proj.weight", 60.),
                                     std::pair("encoder.blocks.1.attn.qkv.weight", 128.),
                                     std::pair("encoder.blocks.2.mlp.fc2.weight", 512.)})
    EXPECT_NEAR(weights[name].std().item<double>() * std::sqrt(inputs), 1, 0.02) << name;
  EXPECT_EQ(weights["encoder.norm.weight"].sum().item<double>(), norm);
  EXPECT_TRUE(weights["proj.weight"].equal(initial_network(preset_config("tiny"), 1)["proj.weight"]));
}

TEST(WarmUp, RisesOverItsShareAndStays) {
  EXPECT_DOUBLE_EQ(warm_up_factor(0.1, 5, 100), 0.5);
  EXPECT_DOUBLE_EQ(warm_up_factor(0.1, 10, 100), 1);
  EXPECT_DOUBLE_EQ(warm_up_factor(0.1, 60, 100), 1);
  EXPECT_DOUBLE_EQ(warm_up_factor(0, 1, 100), 1);
}

// ---- folders of windows ----

class WindowFolders : public Runs {
 protected:
  WindowFolders() {
    fs::create_directories(folder_);
    std::vector<float> windows(2 * kChannels * kTokens, 0.5f), labels(2 * 2 * kPoseWidth, kUnknown);
    std::fill_n(labels.begin(), kPoseWidth, 1.f);
    const std::array<std::uint32_t, 2> clips = {7, 8};
    write_npy<float>(folder_ / "windows.npy", {2, kChannels, kSamples, kLinks}, windows);
    write_npy<float>(folder_ / "labels.npy", {2, 2, kJoints, 3}, labels);
    write_npy<std::uint32_t>(folder_ / "clip.npy", {2}, clips);
  }
  void expect_refusal(const char* file) const {
    try {
      open_window_folder(folder_);
      ADD_FAILURE() << "taken";
    } catch (const SetupError& error) {
      EXPECT_NE(std::string(error.what()).find(file), std::string::npos) << error.what();
    }
  }
};

TEST_F(WindowFolders, GiveWindowsPeopleAndClips) {
  const auto set = open_window_folder(folder_);
  ASSERT_EQ(set->size(), 2u);
  EXPECT_EQ(set->people(0).size(), 1u);
  EXPECT_EQ(set->people(1).size(), 0u);
  EXPECT_EQ(set->clip(1), 8u);
  std::vector<float> x(kChannels * kTokens);
  set->read(1, x);
  EXPECT_EQ(x.back(), 0.5f);
}

TEST_F(WindowFolders, OfOtherShapesAreRefusedByName) {
  const std::array<std::uint32_t, 1> one = {7};
  write_npy<std::uint32_t>(folder_ / "clip.npy", {1}, one);
  expect_refusal("clip.npy");
  const std::vector<float> flat(20 * 9);
  write_npy<float>(folder_ / "windows.npy", {1, 1, 20, 9}, flat);
  expect_refusal("windows.npy");
  fs::resize_file(folder_ / "windows.npy", 40);
  expect_refusal("windows.npy");
  fs::remove(folder_ / "windows.npy");
  expect_refusal("windows.npy");
}

TEST_F(WindowFolders, WithHalfAPersonAreRefused) {
  std::vector<float> labels(2 * kPoseWidth, kUnknown);
  labels[4] = 1;
  write_npy<float>(folder_ / "labels.npy", {2, 1, kJoints, 3}, labels);
  expect_refusal("labels.npy");
}

// ---- two processes ----

/// Runs pretrain as one of two processes, in a process of its own.
pid_t start_rank(int rank, int port, const RunSettings& settings) {
  const std::string script = fmt::format("--gtest_filter=DISABLED_Rank.Runs");
  const pid_t child = ::fork();
  if (child != 0) return child;
  ::setenv("RANK", std::to_string(rank).c_str(), 1);
  ::setenv("WORLD_SIZE", "2", 1);
  ::setenv("MASTER_ADDR", "127.0.0.1", 1);
  ::setenv("MASTER_PORT", std::to_string(port).c_str(), 1);
  ::setenv("CSIPOSE_TEST_RUN", settings.run.out.c_str(), 1);
  ::execl("/proc/self/exe", "loop_test", script.c_str(), "--gtest_also_run_disabled_tests", nullptr);
  ::_exit(127);
}

RunSettings settings_of_rank(RunSettings settings, std::string out) {
  settings.run.out = std::move(out);
  settings.pretrain.batch = 4;
  settings.finetune.batch = 4;
  settings.finetune.dropout = 0;  // each process draws its own
  settings.finetune.lose_receiver = settings.finetune.lose_two_receivers = settings.finetune.lose_links = 0;
  return settings;
}

class DISABLED_Rank : public Runs {};
TEST_F(DISABLED_Rank, Runs) {
  const std::string out = std::getenv("CSIPOSE_TEST_RUN");
  const Workers workers = Workers::from_environment();
  Pool pool = made_up(32, 2);
  ASSERT_TRUE(pretrain(settings_of_rank(settings_, out + "/jepa"), pool, workers).finished);
  ASSERT_TRUE(finetune(settings_of_rank(settings_, out + "/tuned"), pool, workers).finished);
}

TEST_F(Runs, TwoProcessesMakeTheStepsOfOne) {
  Pool pool = made_up(32, 2);
  RunSettings alone = settings_of_rank(settings_, (folder_ / "one/jepa").string());
  alone.pretrain.batch = alone.finetune.batch = 8;
  pretrain(alone, pool, Workers());
  alone.run.out = (folder_ / "one/tuned").string();
  finetune(alone, pool, Workers());

  const int port = 20000 + static_cast<int>(::getpid() % 20000);
  const RunSettings together = in("two");
  const std::array<pid_t, 2> ranks = {start_rank(0, port, together), start_rank(1, port, together)};
  for (const pid_t rank : ranks) {
    int status = 0;
    ASSERT_EQ(::waitpid(rank, &status, 0), rank);
    ASSERT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
  for (const std::string file : {"jepa/pretrained.safetensors", "tuned/last.safetensors"}) {
    const Parameters one = read_weights(folder_ / "one" / file).parameters,
                     two = read_weights(folder_ / "two" / file).parameters;
    for (const auto& [name, tensor] : one)
      EXPECT_LT((tensor - two[name]).abs().max().item<double>(), 2e-5) << file << ' ' << name;
  }
}

TEST(Workers, AVariableThatIsMissingIsNamed) {
  ::setenv("WORLD_SIZE", "2", 1);
  ::unsetenv("RANK");
  try {
    Workers::from_environment();
    ADD_FAILURE();
  } catch (const SetupError& error) {
    EXPECT_NE(std::string(error.what()).find("RANK"), std::string::npos);
  }
  ::unsetenv("WORLD_SIZE");
}

// ---- run files ----

TEST(RunFile, EveryMistakeIsNamedWithItsPlace) {
  const fs::path path = fs::temp_directory_path() / ("csipose_run_" + std::to_string(::getpid()) + ".toml");
  std::ofstream(path) << "[pretrain]\nmask = \"links\"\nbatch = 0\n[nothing]\nx = 1\n";
  try {
    read_run_file(path, {"run.seed=x"});
    ADD_FAILURE();
  } catch (const SetupError& error) {
    const std::string words = error.what();
    for (const char* part : {":2: pretrain.mask", ":3: pretrain.batch", "nothing.x", "run.seed"})
      EXPECT_NE(words.find(part), std::string::npos) << words;
  }
  fs::remove(path);
}

TEST(RunFile, WhatIsPrintedIsReadBack) {
  const RunSettings settings =
      read_run_file({}, {"data.train=[\"a \\\"b\", \"c\"]", "run.out=some where", "network.parity=true"});
  EXPECT_FALSE(settings.network.identity_conditioning);
  EXPECT_EQ(settings.data.train.at(0), "a \"b");
  EXPECT_EQ(to_toml(parse_run_text(to_toml(settings, true), "text"), false), to_toml(settings, false));
}

TEST(EffectiveRank, CountsDirections) {
  at::manual_seed(1);
  const at::Tensor line = at::randn({500, 1}).mm(at::ones({1, 8}));
  EXPECT_NEAR(effective_rank(line), 1, 0.05);
  EXPECT_NEAR(effective_rank(at::randn({20000, 8})), 8, 0.01);
}

}  // namespace
}  // namespace csipose::train
