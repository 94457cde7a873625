#include "daemon/frame_maker.h"

#include <algorithm>
#include <cassert>

namespace csipose {
namespace {

Reasons reasons_of(const Window& window) {
  Reasons reasons = 0;
  if (window.reasons & kReceiverMissing) reasons |= reason_bit(Reason::rx_missing);
  if (window.reasons & kGap) reasons |= reason_bit(Reason::gap);
  if (window.reasons & kSkew) reasons |= reason_bit(Reason::skew);
  if (window.reasons & kNotFinite) reasons |= reason_bit(Reason::nan_input);
  if (window.reasons & kMixedWidth) reasons |= reason_bit(Reason::mixed_width);
  return reasons;
}

}  // namespace

Verdict judge(const Window& window, const Estimate& estimate) {
  Verdict verdict{State::empty, reasons_of(window) | estimate.reasons};
  if (!window.links.all() || estimate.reasons != 0)
    verdict.state = State::degraded;
  else if (estimate.people_count > 0)
    verdict.state = State::tracking;
  return verdict;
}

FrameMaker::FrameMaker(FrontEnd& front_end, PoseEstimator& estimator, const EstimatorConfig& people,
                       const FrameFacts& facts)
    : front_end_(front_end),
      estimator_(estimator),
      facts_(facts),
      smoothed_(people.smoothing != Smoothing::none) {}

void FrameMaker::configure(const EstimatorConfig& people) {
  estimator_.configure(people);
  smoothed_ = people.smoothing != Smoothing::none;
}

void FrameMaker::add(const Packet& packet) {
  last_arrival_ = std::max(last_arrival_, packet.arrival);
  status_.last_packet[packet.receiver] = packet.arrival_utc;
  front_end_.add(packet);
}

const Window& FrameMaker::take(SteadyTime tick) {
  front_end_.take(window_);
  stale_ = tick - last_arrival_ > facts_.stale_after;
  count_window();
  return window_;
}

void FrameMaker::count_window() {
  if (window_.reasons & kNotFinite)
    ++status_.not_finite;
  else if (window_.reasons & kSkew)
    ++status_.skew;
  else if (window_.reasons & (kGap | kReceiverMissing | kMixedWidth))
    ++status_.gap;
  else
    ++status_.ok;
}

void FrameMaker::estimate() {
  estimate_ = stale_ ? nullptr : &estimator_.estimate(window_);
  if (stale_) estimator_.reset();  // nobody is followed across the silence
}

void FrameMaker::begin_frame(const Verdict& verdict) {
  frame_ = {};
  frame_.seq = ++seq_;
  frame_.session = facts_.session;
  frame_.source = facts_.source;
  frame_.state = verdict.state;
  frame_.reasons = verdict.reasons;
  frame_.model = facts_.model;
  frame_.untrained = facts_.untrained;
  if (facts_.untrained) frame_.reasons |= reason_bit(Reason::untrained);
  frame_.smoothed = smoothed_;
  status_.state = frame_.state;
  status_.reasons = frame_.reasons;
}

PoseFrame& FrameMaker::window_frame() {
  if (estimate_ == nullptr)
    begin_frame({State::stale, reason_bit(Reason::no_data)});
  else
    begin_frame(judge(window_, *estimate_));
  frame_.window_start = window_.first_sample_utc;
  frame_.window_end = window_.last_sample_utc;
  frame_.receivers = window_.receivers;
  if (estimate_ != nullptr) {
    frame_.people_count = estimate_->people_count;
    frame_.people = estimate_->people;
  }
  status_.people = frame_.people_count;
  return frame_;
}

PoseFrame& FrameMaker::state_frame(State state, Reasons reasons) {
  begin_frame({state, reasons});
  for (ReceiverQuality& receiver : frame_.receivers)
    receiver.rssi_dbm.fill(kUnknown);  // no window, nothing measured
  status_.people = 0;
  return frame_;
}

void FrameMaker::fill_status() {
  status_.links = window_.links;
  status_.receivers = window_.receivers;
  status_.front_end = front_end_.stats();
}

}  // namespace csipose
