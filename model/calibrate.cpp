#include "model/calibrate.h"

#include <cassert>

#include "model/onednn_engine.h"

namespace csipose {
namespace {

OneDnnOptions with_threads(int threads) {
  OneDnnOptions options;
  options.threads = threads;
  return options;
}

}  // namespace

Int8Calibration calibrate_int8(std::shared_ptr<const Model> model, std::span<const WindowTensor> windows,
                               int threads) {
  assert(!windows.empty());
  OneDnnEngine engine(std::move(model), Precision::f32, with_threads(threads));
  engine.probe().watch_inputs = true;
  for (const WindowTensor& window : windows) engine.run(window, LinkSet().set());
  return {engine.probe().input_max()};
}

std::map<std::string, GateFigures> measure_precisions(std::shared_ptr<const Model> model,
                                                      std::span<const WindowTensor> windows, int threads) {
  OneDnnEngine exact(model, Precision::f32, with_threads(threads));
  std::map<std::string, GateFigures> figures;
  for (const Precision precision : {Precision::bf16, Precision::int8}) {
    if (why_not(precision, cpu_features(), *model)) continue;
    OneDnnEngine other(model, precision, with_threads(threads));
    figures[std::string(name_of(precision))] = measure_shift(exact, other, windows);
  }
  return figures;
}

std::vector<std::uint8_t> calibrate_file(const SafetensorsFile& file, std::span<const WindowTensor> windows,
                                         int threads) {
  const auto input_max = calibrate_int8(Model::from(file), windows, threads).input_max;
  const auto scaled = SafetensorsFile::parse(with_int8_calibration(file, input_max, {}), file.name());
  return with_int8_calibration(file, input_max, measure_precisions(Model::from(scaled), windows, threads));
}

}  // namespace csipose
