#include "train/evaluation_report.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <map>

namespace csipose::train {
namespace {

/// Not a number without any.
double percent(std::size_t part, std::size_t all) {
  return 100 * static_cast<double>(part) / static_cast<double>(all);
}

std::string cell(double value) { return std::isnan(value) ? "-" : fmt::format("{:.1f}", value); }

void print_row(const std::string& name, const Metrics& metrics) {
  const GroupMetrics all = metrics.all();
  std::map<std::size_t, GroupMetrics> groups = metrics.by_count();
  fmt::print("{:16}", name);
  fmt::print("{:>8}", cell(all.frame_mean.mpjpe));
  for (const std::size_t count : {1u, 2u, 3u})
    fmt::print("{:>8}", groups.count(count) ? cell(groups[count].frame_mean.mpjpe) : "-");
  fmt::print("{:>8}{:>8}{:>8}", cell(all.frame_mean.pa_mpjpe), cell(all.frame_mean.pck20),
             cell(all.frame_mean.pck50));
  fmt::print("{:>9}", cell(all.penalised_500));
  if (metrics.protocol() == Protocol::detect)
    fmt::print("{:>8}{:>8}{:>8}", cell(100 * all.precision()), cell(100 * all.recall()),
               cell(100 * all.count_accuracy()));
  fmt::print("\n");
}

void print_head(const char* title, Protocol protocol) {
  fmt::print("\n{}\n{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>9}", title, "", "MPJPE", "1", "2", "3", "PA",
             "PCK20", "PCK50", "pen.500");
  if (protocol == Protocol::detect) fmt::print("{:>8}{:>8}{:>8}", "prec.", "recall", "count");
  fmt::print("\n");
}

void print_errors(const std::vector<NamedFigures>& rows, const std::vector<TrivialFigures>& trivial) {
  print_head("detect: score 0.30, pose-NMS, pairs within 0.5 m (mm, %)", Protocol::detect);
  for (const NamedFigures& row : rows) print_row(row.name, row.figures.detect);
  print_head("piw3d: all hypotheses, no threshold, false positives cost nothing (mm, %)", Protocol::piw3d);
  for (const NamedFigures& row : rows) print_row(row.name, row.figures.piw3d);
  print_head("trivial answers, told how many people there are: optimal assignment, however far (mm, %)",
             Protocol::assigned);
  for (const TrivialFigures& row : trivial) print_row(row.name, row.assigned);
  print_head("trivial answers, pairs within 0.5 m only (mm, %)", Protocol::detect);
  for (const TrivialFigures& row : trivial) print_row(row.name, row.detect);
}

void print_stance(const std::string& name, const Metrics& metrics) {
  const PoseErrors mean = metrics.all().frame_mean;
  fmt::print("{:16}", name);
  for (const double figure :
       {mean.mpjpe, mean.mrpe, mean.root_mpjpe, mean.pa_mpjpe, mean.facing_deg, mean.breadth_mm})
    fmt::print("{:>9}", cell(figure));
  fmt::print("\n");
}

/// What of the error is where somebody is, and what is how he stands.
void print_stances(const std::vector<NamedFigures>& rows, const std::vector<TrivialFigures>& trivial) {
  fmt::print(
      "\nwhere and how somebody stands: piw3d; trivial answers assigned (mm, degrees)\n"
      "{:16}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}\n",
      "", "MPJPE", "root", "from it", "PA", "facing", "breadth");
  for (const NamedFigures& row : rows) print_stance(row.name, row.figures.piw3d);
  for (const TrivialFigures& row : trivial) print_stance(row.name, row.assigned);
}

/// The model by piw3d; beside it the mean pose at each person's true root.
void print_postures(const Evaluation& model, const std::vector<TrivialFigures>& trivial) {
  const Metrics& mean_at_root = std::ranges::find(trivial, "mean_at_root", &TrivialFigures::name)->assigned;
  fmt::print(
      "\nby how somebody stands: piw3d, over people (mm, degrees); recall by detect (%)\n"
      "{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>14}\n",
      "", "people", "MPJPE", "root", "from it", "PA", "facing", "recall", "mean_at_root");
  for (std::size_t i = 0; i < kPostures; ++i) {
    const auto posture = static_cast<Posture>(i);
    const PostureMetrics group = model.piw3d.by_posture(posture), found = model.detect.by_posture(posture);
    const PoseErrors& mean = group.person_mean;
    fmt::print("{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>14}\n", name_of(posture), group.people,
               cell(mean.mpjpe), cell(mean.mrpe), cell(mean.root_mpjpe), cell(mean.pa_mpjpe),
               cell(mean.facing_deg), cell(percent(found.matched, found.people)),
               cell(mean_at_root.by_posture(posture).person_mean.mpjpe));
  }
}

/// How far stated probabilities are from what came true; only rows that state some.
void print_reliability(const std::vector<NamedFigures>& rows) {
  fmt::print("\nexpected calibration error, ten bins, of what detect gives\n{:16}{:>8}{:>8}{:>8}{:>8}\n", "",
             "score", "people", "joints", "stated");
  const auto print_one = [](const Reliability& stated) {
    fmt::print("{:>8}{:>8}", stated.count() == 0 ? "-" : fmt::format("{:.4f}", stated.expected_error()),
               stated.count());
  };
  for (const NamedFigures& row : rows) {
    if (row.figures.score.count() == 0) continue;
    fmt::print("{:16}", row.name);
    print_one(row.figures.score);
    print_one(row.figures.joints);
    fmt::print("\n");
  }
}

/// Only of weights that know installations.
void print_installations(const std::vector<NamedFigures>& rows) {
  if (rows.front().figures.installations.windows == 0) return;
  fmt::print(
      "\nthe installation, from the windows of a clip so far (unlikeness; %)\n{:16}{:>8}{:>8}{:>9}{:>9}\n",
      "", "mean", "most", "unknown", "another");
  for (const NamedFigures& row : rows) {
    const Installations& of = row.figures.installations;
    fmt::print("{:16}{:>8.2f}{:>8.2f}{:>9}{:>9}\n", row.name,
               of.unlikeness_sum / static_cast<double>(of.windows), of.greatest_unlikeness,
               cell(percent(of.unknown, of.windows)), cell(percent(of.mistaken, of.named)));
  }
}

nlohmann::ordered_json installations_json(const Installations& of) {
  return {{"windows", of.windows},
          {"mean_unlikeness", of.unlikeness_sum / static_cast<double>(of.windows)},
          {"greatest_unlikeness", of.greatest_unlikeness},
          {"unknown_percent", percent(of.unknown, of.windows)},
          {"mistaken_percent", percent(of.mistaken, of.named)}};
}

nlohmann::ordered_json reliability_json(const Reliability& stated) {
  return {{"stated", stated.count()}, {"ece", stated.expected_error()}};
}

void put(nlohmann::ordered_json& results, const Metrics& metrics) {
  results[std::string(name_of(metrics.protocol()))] = nlohmann::ordered_json::parse(metrics_json(metrics));
}

}  // namespace

void print_tables(const std::vector<NamedFigures>& rows, const std::vector<TrivialFigures>& trivial) {
  print_errors(rows, trivial);
  print_stances(rows, trivial);
  print_postures(rows.front().figures, trivial);
  print_reliability(rows);
  print_installations(rows);
}

nlohmann::ordered_json results_json(const std::vector<NamedFigures>& rows,
                                    const std::vector<TrivialFigures>& trivial) {
  nlohmann::ordered_json results;
  for (const NamedFigures& row : rows) {
    nlohmann::ordered_json& one = results[row.name];
    put(one, row.figures.piw3d);
    put(one, row.figures.detect);
    if (row.figures.installations.windows > 0)
      one["installations"] = installations_json(row.figures.installations);
    if (row.figures.score.count() > 0) one["calibration"]["score"] = reliability_json(row.figures.score);
    if (row.figures.joints.count() > 0) one["calibration"]["joints"] = reliability_json(row.figures.joints);
  }
  for (const TrivialFigures& row : trivial) {
    nlohmann::ordered_json& one = results[row.name];
    put(one, row.assigned);
    put(one, row.detect);
  }
  return results;
}

}  // namespace csipose::train
