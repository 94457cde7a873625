// csipose-sim solve: the channel of one stated scene, for whoever wants to check our physics.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "proto/npy.h"
#include "proto/result.h"
#include "sim/atomic_file.h"
#include "sim/commands.h"
#include "sim/facet_solver.h"
#include "sim/fast_solver.h"
#include "sim/mesh_scene.h"
#include "sim/reference_solver.h"

namespace csipose::sim {
namespace {

struct SolveOptions {
  std::filesystem::path scene, out, paths;
  bool reference = false;
  Scatter scatter = Scatter::analytic;
};

std::string json_line(const Path& path, int snapshot, std::size_t receiver, std::size_t antenna) {
  std::string walls;
  for (const Wall wall : path.walls)
    walls += fmt::format("{}\"{}\"", walls.empty() ? "" : ",", kWallNames[static_cast<std::size_t>(wall)]);
  const std::string kind =
      path.diffuse ? R"("type":"diffuse")"
      : path.body < 0
          ? fmt::format(R"("type":"wall","idx":[{},{},{}],"walls":[{}])", path.image.x, path.image.y,
                        path.image.z, walls)
          : fmt::format(R"("type":"body","body":{},"pair":[{},{}],"face":{})", path.body, path.wall_before,
                        path.wall_after, path.face == kWholeSurface ? "null" : std::to_string(path.face));
  return fmt::format(
      R"({{"snapshot":{},"rx":{},"ant":{},{},"len":{:.12g},"a":[{:.9g},{:.9g}],"F":[{:.9g},{:.9g}]}})"
      "\n",
      snapshot, receiver, antenna, kind, path.length_m, path.amplitude.real(), path.amplitude.imag(),
      path.shadow.real(), path.shadow.imag());
}

void write_paths(const Scene& scene, const std::filesystem::path& file) {
  AtomicFile out(file);
  for (int m = 0; m < scene.snapshots; ++m)
    for (std::size_t r = 0; r < scene.receivers.size(); ++r)
      for (std::size_t a = 0; a < scene.receivers[r].size(); ++a)
        for (const Path& path : reference_paths(scene, scene.receivers[r][a], m * scene.step_s))
          out.write(json_line(path, m, r, a));
  out.commit();
}

template <class Number>
void write_channel(const std::filesystem::path& file, const NpyShape& row, const std::vector<Number>& h) {
  NpyWriter<Number> out(file, row);
  out.append(h);
  out.finish();
}

void solve(const SolveOptions& options) {
  const Scene scene = read_scene_with_meshes(options.scene);
  if (options.scatter == Scatter::analytic && !scene.mesh_bodies.empty())
    throw SetupError(
        ExitStatus::usage,
        fmt::format("{}: has bodies that are meshes, which have no closed form; add --scatter po",
                    options.scene.string()));
  const NpyShape row{scene.tones.size(), scene.receivers.size(), scene.receivers[0].size()};
  if (options.scatter != Scatter::analytic)
    write_channel<std::complex<double>>(options.out, row, solve_facets(scene, options.scatter));
  else if (options.reference)
    write_channel<std::complex<double>>(options.out, row, solve_reference(scene));
  else
    write_channel<std::complex<float>>(options.out, row, solve_fast(scene));
  if (!options.paths.empty()) write_paths(scene, options.paths);
  fmt::print("{}: {} snapshots x {} subcarriers x {} receivers x {} antennas\n", options.out.string(),
             scene.snapshots, row[0], row[1], row[2]);
}

}  // namespace

void add_solve(CLI::App& app) {
  auto options = std::make_shared<SolveOptions>();
  CLI::App* command = app.add_subcommand(
      "solve", "one stated scene in, its channel H[snapshot][subcarrier][rx][antenna] out");
  command->add_option("scene", options->scene, "scene as JSON: docs/simulator-scene.md")->required();
  command
      ->add_option("--out", options->out,
                   "NumPy file to write: complex64; complex128 with --reference and facets")
      ->required();
  command->add_flag("--reference", options->reference, "plainly, in double precision, antenna by antenna");
  const std::map<std::string, Scatter> kinds{
      {"analytic", Scatter::analytic}, {"po", Scatter::po}, {"facet", Scatter::facet}};
  command
      ->add_option("--scatter", options->scatter,
                   "bodies as: analytic (default), po: physical optics over facets, which takes bodies of "
                   "any shape; facet: "
                   "triangles as hard mirrors, as a mesh ray tracer has them")
      ->transform(CLI::CheckedTransformer(kinds));
  command->add_option("--paths", options->paths,
                      "also write every path of the reference solver, one JSON line each, to this file");
  command->callback([options] { solve(*options); });
}

}  // namespace csipose::sim
