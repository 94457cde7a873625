// tests/train/made_up_set.h - windows made here whose people can be told from them: a pose decides every link's amplitude.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "model/seeded_random.h"
#include "train/batch.h"

namespace csipose::testing {

/// Clips of ten windows; in each window up to `most_people` people somewhere in a room of 4 x 4 m, standing, with arms
/// that swing. The window is a smooth function of their places and angles, with noise.
class MadeUpSet : public train::WindowSource {
 public:
  MadeUpSet(std::size_t windows, std::size_t most_people, std::uint64_t seed)
      : windows_(windows), people_(windows) {
    for (std::size_t i = 0; i < windows; ++i) make(i, most_people, seed);
  }
  std::size_t size() const override { return windows_.size(); }
  std::string name() const override { return "made-up"; }
  void read(std::size_t i, std::span<float> x) const override {
    std::copy(windows_[i].begin(), windows_[i].end(), x.begin());
  }
  std::span<const Skeleton> people(std::size_t i) const override { return people_[i]; }
  std::uint64_t clip(std::size_t i) const override { return i / 10; }

 private:
  struct Figure {
    double x, y, swing;
  };

  static Skeleton skeleton(const Figure& figure) {
    Skeleton joints;
    for (std::size_t j = 0; j < kJoints; ++j) {
      const auto part = static_cast<double>(j);
      joints[j] = {static_cast<float>(figure.x + 0.2 * std::sin(part + figure.swing)),
                   static_cast<float>(figure.y + 0.2 * std::cos(2 * part + figure.swing)),
                   static_cast<float>(1.7 - 0.1 * part)};
    }
    return joints;
  }

  /// What a person adds to channel c of link l at sample t.
  static double echo(const Figure& figure, std::size_t c, std::size_t t, std::size_t l) {
    const double angle = 0.7 * static_cast<double>(l), depth = 0.05 * static_cast<double>(c % kSubcarriers);
    const double path = figure.x * std::cos(angle) + figure.y * std::sin(angle);
    const double moved = 0.3 * std::sin(figure.swing + 0.1 * static_cast<double>(t));
    return c < kSubcarriers ? std::cos((1 + depth) * path + moved) : std::sin((1 + depth) * path + moved);
  }

  void make(std::size_t i, std::size_t most_people, std::uint64_t seed) {
    SeededRandom random(seed, "made-up", {i});
    std::vector<Figure> figures(1 + random.index(most_people));
    for (Figure& figure : figures)
      figure = {random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-1, 1)};
    for (const Figure& figure : figures) people_[i].push_back(skeleton(figure));
    windows_[i].resize(kChannels * kTokens);
    for (std::size_t c = 0; c < kChannels; ++c)
      for (std::size_t t = 0; t < kSamples; ++t)
        for (std::size_t l = 0; l < kLinks; ++l) {
          double sum = 0.02 * random.normal();
          for (const Figure& figure : figures) sum += echo(figure, c, t, l);
          windows_[i][Window::index(c, t, l)] = static_cast<float>(sum);
        }
  }

  std::vector<std::vector<float>> windows_;
  std::vector<std::vector<Skeleton>> people_;
};

}  // namespace csipose::testing
