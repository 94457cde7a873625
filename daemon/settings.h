// daemon/settings.h - the configuration's words as the settings of each part, and whether they fit the model.
#pragma once

#include <memory>

#include "capture/front_end.h"
#include "capture/source.h"
#include "daemon/config.h"
#include "daemon/loop.h"
#include "daemon/publisher.h"
#include "daemon/recorder_thread.h"
#include "model/model.h"
#include "model/pose_estimator.h"

namespace csipose {

FrontEndConfig front_end_config(const Config& config);
EstimatorConfig estimator_config(const Config& config);
LoopTiming loop_timing(const Config& config);
StreamLimits stream_limits(const Config& config);
/// rx1, rx2, rx3 where the configuration names none.
std::vector<std::string> receiver_ids(const Config& config);
/// What every client is told first.
Hello hello_of(const Config& config, const Model& model, Source source, std::uint64_t session);

/// Loads the weights; throws SetupError when they are not those of model.sha256, or want windows that this
/// configuration does not make.
std::shared_ptr<const Model> load_model(const Config& config);
std::unique_ptr<Engine> make_engine(const Config& config, std::shared_ptr<const Model> model);

/// The source that the configuration names. `sockets`: inherited from systemd, by name. Throws SetupError.
std::unique_ptr<PacketSource> make_source(const Config& config, const std::map<std::string, int>& sockets);

/// The thread that records, not yet recording. Throws SetupError.
std::unique_ptr<RecorderThread> make_recorder(const Config& config, Source source);

/// A new session's number. Live: random. Replay: a digest of the recording, the model, the engine and every
/// setting that shapes a frame, so that the same replay has the same number.
std::uint64_t session_number(const Config& config, const Model& model);

}  // namespace csipose
