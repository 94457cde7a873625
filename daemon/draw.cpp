#include "daemon/draw.h"

#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <system_error>

#include "proto/result.h"

namespace csipose {
namespace {

constexpr int kPixelsPerSubcarrier = 4;
constexpr int kPanelHeight = kPixelsPerSubcarrier * static_cast<int>(kSubcarriers);
constexpr int kLeastPanelWidth = 800, kMargin = 12, kTitle = 22;
constexpr double kRangeDb = 40;  // of amplitudes shown below the greatest
const cv::Scalar kPaper(255, 255, 255), kInk(40, 40, 40);

double greatest_amplitude(const CsiTrace& trace) {
  float greatest = 0;
  for (const Features& features : trace.columns)
    for (std::size_t i = 0; i < kSubcarriers * kAntennas; ++i) greatest = std::max(greatest, features[i]);
  return greatest;
}

std::uint8_t amplitude_grey(double amplitude, double greatest) {
  const double below_db = -20 * std::log10(std::max(amplitude, 1e-9) / greatest);
  return cv::saturate_cast<std::uint8_t>(255 * (1 - below_db / kRangeDb));
}

std::uint8_t phase_grey(double phase_rad) {
  return cv::saturate_cast<std::uint8_t>(255 * (phase_rad + std::numbers::pi) / (2 * std::numbers::pi));
}

/// One antenna's amplitudes or phases, one pixel per number, before it is enlarged and coloured.
template <class Grey>
cv::Mat numbers_as_grey(const CsiTrace& trace, std::size_t antenna, std::size_t first_channel, Grey grey) {
  cv::Mat image(static_cast<int>(kSubcarriers), static_cast<int>(trace.columns.size()), CV_8UC1);
  for (std::size_t t = 0; t < trace.columns.size(); ++t)
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      image.at<std::uint8_t>(static_cast<int>(kSubcarriers - 1 - k), static_cast<int>(t)) =
          grey(trace.columns[t][(first_channel + k) * kAntennas + antenna]);
  return image;
}

std::string title(const CsiTrace& trace, std::size_t antenna) {
  const char letter = static_cast<char>('A' + antenna);
  return trace.name + " (" + std::to_string(trace.records) + " records), antenna " + letter + ": ";
}

cv::Mat panel(const cv::Mat& grey, int colours, const std::string& words) {
  cv::Mat enlarged, coloured;
  const int width = std::max(grey.cols, kLeastPanelWidth);
  cv::resize(grey, enlarged, {width, kPanelHeight}, 0, 0, cv::INTER_NEAREST);
  cv::applyColorMap(enlarged, coloured, colours);
  cv::Mat framed;
  cv::copyMakeBorder(coloured, framed, kTitle, kMargin, kMargin, kMargin, cv::BORDER_CONSTANT, kPaper);
  cv::putText(framed, words, {kMargin, kTitle - 6}, cv::FONT_HERSHEY_SIMPLEX, 0.45, kInk, 1, cv::LINE_AA);
  return framed;
}

/// Amplitudes of all antennas, then phases of all: six panels of one width, the time axis in common.
cv::Mat receiver_panels(const CsiTrace& trace) {
  const double greatest = greatest_amplitude(trace);
  std::vector<cv::Mat> panels;
  for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
    panels.push_back(panel(
        numbers_as_grey(trace, antenna, 0, [greatest](double a) { return amplitude_grey(a, greatest); }),
        cv::COLORMAP_VIRIDIS, title(trace, antenna) + "amplitude, dark is 40 dB down"));
  for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
    panels.push_back(panel(numbers_as_grey(trace, antenna, kSubcarriers, phase_grey), cv::COLORMAP_TWILIGHT,
                           title(trace, antenna) + "sanitised phase, -pi to pi"));
  cv::Mat picture;
  cv::vconcat(panels, picture);
  return picture;
}

/// One receiver under the other, each as wide as the widest.
cv::Mat draw(const std::vector<CsiTrace>& traces) {
  std::vector<cv::Mat> receivers;
  int width = 0;
  for (const CsiTrace& trace : traces) {
    if (trace.columns.empty()) continue;
    receivers.push_back(receiver_panels(trace));
    width = std::max(width, receivers.back().cols);
  }
  for (cv::Mat& receiver : receivers)
    cv::copyMakeBorder(receiver, receiver, 0, 0, 0, width - receiver.cols, cv::BORDER_CONSTANT, kPaper);
  cv::Mat picture;
  if (!receivers.empty()) cv::vconcat(receivers, picture);
  return picture;
}

void write_whole_file(const std::string& path, const std::vector<std::uint8_t>& bytes) {
  const std::string unfinished = path + ".part" + std::to_string(::getpid());
  std::ofstream file(unfinished, std::ios::binary | std::ios::trunc);
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  file.close();
  if (file && std::rename(unfinished.c_str(), path.c_str()) == 0) return;
  const std::string reason = std::generic_category().message(errno);
  std::remove(unfinished.c_str());
  throw SetupError(ExitStatus::cannot_create, "cannot write " + path + ": " + reason);
}

}  // namespace

void draw_csi(const std::vector<CsiTrace>& traces, const std::string& path) {
  const cv::Mat picture = draw(traces);
  if (picture.empty())
    throw SetupError(ExitStatus::bad_data, "cannot draw " + path + ": the file holds no usable CSI record.");
  std::vector<std::uint8_t> png;
  cv::imencode(".png", picture, png);
  write_whole_file(path, png);
}

}  // namespace csipose
