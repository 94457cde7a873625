// model/one_euro.h - a low-pass filter whose cutoff rises with speed: calm at rest, prompt in motion.
//
// source: Casiez, Roussel, Vogel, "1 euro filter", CHI 2012, algorithm 1.
#pragma once

#include <cmath>
#include <numbers>

namespace csipose {

/// Values for joints in metres, by reasoning and not by tuning on data: at rest 1.5 Hz quietens the network's
/// jitter from window to window; a hand at 2 m/s is filtered at 5.5 Hz, a lag of 30 ms.
struct OneEuroSettings {
  double min_cutoff_hz = 1.5;
  double beta_per_m = 2.0;  ///< added cutoff in Hz for each m/s
  double speed_cutoff_hz = 1.0;
};

class OneEuro {
 public:
  /// The filtered value after `dt_s` seconds; the first call, and a call without time passing, give `value`
  /// itself.
  double filter(double value, double dt_s, const OneEuroSettings& settings = {}) {
    if (!started_ || dt_s <= 0) {
      started_ = true;
      return value_ = value;
    }
    const double speed = (value - value_) / dt_s;
    speed_ += weight(settings.speed_cutoff_hz, dt_s) * (speed - speed_);
    const double cutoff_hz = settings.min_cutoff_hz + settings.beta_per_m * std::fabs(speed_);
    return value_ += weight(cutoff_hz, dt_s) * (value - value_);
  }

 private:
  static double weight(double cutoff_hz, double dt_s) {
    return 1 / (1 + 1 / (2 * std::numbers::pi * cutoff_hz * dt_s));
  }
  bool started_ = false;
  double value_ = 0, speed_ = 0;
};

}  // namespace csipose
