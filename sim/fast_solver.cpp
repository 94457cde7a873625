#include "sim/fast_solver.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include "sim/fast_optics.h"
#include "sim/geometry.h"
#include "sim/pairs.h"
#include "sim/reference_solver.h"

namespace csipose::sim {
namespace {
constexpr std::size_t kTonesPerSum = 32;
constexpr std::size_t kShadowsEvery = 2, kBodyPathsEvery = 4;  // snapshots; the others are interpolated
// Paths by bodies, as parts of the still channel's rms: below the first their shadows are left out, below the second they are
// asked for at every other key. Most are that weak. Chosen so that the gates of the tests' scenes still hold.
constexpr double kFaint = 5e-4, kWeak = 8e-3;
constexpr float kNewtonFound =
    1e-4f;  // |T^T g| above this: three updates did not find it, the reference solver must
constexpr float kFarAway_m = 1e6;  // padding of columns: near nothing

/// Which snapshots are computed in full, and how the others follow from them: cubic in time through the four nearest.
class KeySnapshots {
 public:
  KeySnapshots(std::size_t snapshots, std::size_t every) {
    for (std::size_t t = 0; t < snapshots; t += every) keys_.push_back(t);
    if (snapshots > 0 && keys_.back() != snapshots - 1) keys_.push_back(snapshots - 1);
    for (std::size_t t = 0; t < snapshots; ++t) blends_.push_back(blend_at(t));
  }
  struct Blend {
    std::size_t first = 0, count = 0;  ///< keys
    std::array<float, 4> weight{};
  };
  const std::vector<std::size_t>& keys() const { return keys_; }
  const Blend& blend(std::size_t t) const { return blends_[t]; }

 private:
  Blend blend_at(std::size_t t) const {
    Blend blend;
    blend.count = std::min<std::size_t>(4, keys_.size());
    const std::size_t after =
        static_cast<std::size_t>(std::lower_bound(keys_.begin(), keys_.end(), t) - keys_.begin());
    blend.first = std::min(after > 2 ? after - 2 : 0, keys_.size() - blend.count);
    for (std::size_t i = 0; i < blend.count; ++i) {  // Lagrange
      double weight = 1;
      const double ti = static_cast<double>(keys_[blend.first + i]);
      for (std::size_t j = 0; j < blend.count; ++j) {
        const double tj = static_cast<double>(keys_[blend.first + j]);
        if (j != i) weight *= (static_cast<double>(t) - tj) / (ti - tj);
      }
      blend.weight[i] = f(weight);
    }
    return blend;
  }

  std::vector<std::size_t> keys_;
  std::vector<Blend> blends_;
};

/// Legs of all static paths to all antennas, as rows and as the kernels' columns.
struct LegTable {
  std::vector<LegRow> rows;
  std::vector<std::uint32_t> path;  ///< of each row
  std::array<std::vector<float>, 9> columns;

  void add(const Leg& leg, std::uint32_t path_index) {
    const LegRow row = leg_row(leg);
    rows.push_back(row);
    path.push_back(path_index);
    push({row.x, row.y, row.z, row.ux, row.uy, row.uz, row.length, row.before, row.total});
  }
  void pad() {
    while (columns[0].size() % 16 != 0) push({kFarAway_m, kFarAway_m, kFarAway_m, 1, 0, 0, 0, 0, 1});
  }
  LegColumns view() const {
    const auto& c = columns;
    return {c[0].data(), c[1].data(), c[2].data(), c[3].data(), c[4].data(),
            c[5].data(), c[6].data(), c[7].data(), c[8].data(), static_cast<int>(c[0].size())};
  }

 private:
  void push(const std::array<float, 9>& row) {
    for (std::size_t i = 0; i < row.size(); ++i) columns[i].push_back(row[i]);
  }
};

/// One question to the ellipsoid kernel.
struct EllipsoidTask {
  std::size_t body, pair, receiver;
  Vec3 source, sink;
};

/// A path by a body at one instant.
struct BodyPath {
  std::complex<double> amplitude;
  double length_m, bend_m;  ///< to the array's middle; radius of the wave front there
  Vec3 last;                ///< unit, direction of arrival
  Vec3 slope;               ///< of the length over the body's place
  std::complex<double> shadow = 1;
  bool shadow_known = true;  ///< else that of its neighbours in time serves
};
/// One that waits for its shadows.
struct Pending {
  BodyPath path;
  std::size_t slot;
};

/// Where paths by bodies have their place: by receiver, pair and reflecting part.
class PathSlots {
 public:
  void assign(const std::vector<Body>& bodies, std::size_t ways) {
    first_.clear();
    std::size_t parts = 0;
    for (const Body& body : bodies) {
      first_.push_back(parts);
      parts += body.shape == Shape::ellipsoid ? 1 : body.shape == Shape::box ? 6 : 3;
    }
    parts_ = parts;
    body_of_part_.resize(parts);
    for (std::size_t b = 0; b < bodies.size(); ++b)
      for (std::size_t i = first_[b]; i < (b + 1 < bodies.size() ? first_[b + 1] : parts); ++i)
        body_of_part_[i] = b;
    count_ = parts * ways;
  }
  /// `way`: receiver * pairs + pair.
  std::size_t slot(std::size_t way, std::size_t body, int face) const {
    const int part = face == kWholeSurface   ? 0
                     : face < kCylinderTop   ? face
                     : face == kCylinderSide ? 2
                                             : face - kCylinderTop;
    return way * parts_ + first_[body] + static_cast<std::size_t>(part);
  }
  std::size_t count() const { return count_; }
  std::size_t way(std::size_t slot) const { return slot / parts_; }
  std::size_t body(std::size_t slot) const { return body_of_part_[slot % parts_]; }

 private:
  std::vector<std::size_t> first_, body_of_part_;
  std::size_t parts_ = 0, count_ = 0;
};
/// How body `body` dims leg `leg` of pending path `path`.
struct Question {
  std::size_t path, leg, body;
};

}  // namespace

class FastSolver::Impl {
 public:
  Impl(const Scene& scene, const FastKernels& kernels);
  void solve(std::span<const std::vector<Body>> bodies, std::span<std::complex<float>> out);

 private:
  using Snapshots = std::span<const std::vector<Body>>;
  using Factor = std::complex<float>;

  void add_static_row(std::size_t antenna, const Path& path, bool shadows);
  ToneSum* sum_at(std::size_t t, std::size_t antenna) {
    return &sums_[(t * antennas_.size() + antenna) * blocks_];
  }
  const FresnelTable& table_of(const Surface& surface);

  void compute_shadows(Snapshots bodies, const KeySnapshots& keys);
  void apply_shadows(std::size_t snapshots, const KeySnapshots& keys);
  void find_body_paths(Snapshots bodies, const KeySnapshots& keys, std::size_t key);
  void fill_in_shadows(std::size_t keys);
  void add_body_paths(Snapshots bodies, const KeySnapshots& keys);
  BodyPath between_keys(Snapshots bodies, const KeySnapshots& keys, std::size_t slot, std::size_t t) const;
  void reflect_on_ellipsoids(const std::vector<Body>& bodies, const std::vector<EllipsoidTask>& tasks);
  void add_reflection(const std::vector<Body>& bodies, const Reflection& r, const EllipsoidTask& task);
  void ask_for_shadows_of(const Body& body);
  void finish_pending(std::size_t keys, std::size_t key);
  void add_to_antennas(const BodyPath& path, std::size_t receiver, std::size_t t);
  void write(std::size_t snapshots, std::span<std::complex<float>> out) const;

  Scene scene_;
  const FastKernels& kernels_;
  double lambda_m_;
  FastOptics optics_;
  std::vector<Antenna> antennas_, middles_;  ///< receiver by receiver; and each receiver's middle
  std::size_t per_receiver_, blocks_;
  std::vector<float> offsets_hz_;
  std::vector<Pair> pairs_;
  LegTable legs_;
  std::vector<ToneSum> rows_;  ///< [static path][block]; antenna by antenna
  std::vector<std::size_t> antenna_of_row_;
  std::vector<double> still_rms_;    ///< [receiver]
  std::vector<ToneSum> static_sum_;  ///< [antenna][block]
  std::vector<BodyRow> furniture_rows_;
  std::vector<FresnelTable> wall_tables_;
  std::vector<std::pair<Surface, FresnelTable>> body_tables_;

  // Of the solve at hand.
  std::vector<ToneSum> sums_;    ///< [snapshot][antenna][block]
  std::vector<Factor> factors_;  ///< [path][key]
  std::vector<char> shadowed_;   ///< [path]
  std::vector<std::uint32_t> near_;
  std::vector<FastOptics::Job> jobs_;
  std::vector<Reflection> found_;
  std::size_t key_ = 0;  ///< being solved

  PathSlots slots_;
  std::vector<std::optional<BodyPath>> paths_;  ///< [slot][key]

  // Of the snapshot at hand.
  std::vector<BodyRow> body_rows_;
  BodyTable body_table_;
  std::vector<Pending> pending_;
};

double power_of(const Path& path) { return std::norm(path.amplitude * path.shadow); }

/// Furniture adds hundreds of faint paths. Those that together carry 1e-5 of the power keep their light whatever stands
/// in their way: an error of 0.3 % of the rms at most.
double weakest_that_counts(const std::vector<Path>& paths) {
  constexpr double kUnseenShare = 1e-5;
  std::vector<double> powers;
  for (const Path& path : paths)
    if (!path.diffuse) powers.push_back(power_of(path));
  std::sort(powers.begin(), powers.end());
  double left = kUnseenShare * std::accumulate(powers.begin(), powers.end(), 0.0);
  for (const double power : powers)
    if ((left -= power) < 0) return power;
  return 0;
}

FastSolver::Impl::Impl(const Scene& scene, const FastKernels& kernels)
    : scene_(scene),
      kernels_(kernels),
      lambda_m_(scene.wavelength_m()),
      optics_(kernels, lambda_m_),
      per_receiver_(scene.receivers[0].size()),
      blocks_((scene.tones.size() + kTonesPerSum - 1) / kTonesPerSum),
      offsets_hz_(blocks_ * kTonesPerSum),
      pairs_(pairs_of(scene)) {
  scene_.bodies.clear();
  for (std::size_t k = 0; k < scene.tones.size(); ++k) offsets_hz_[k] = f(scene.tones[k] * kToneSpacing_hz);
  for (const Surface& wall : scene.room.walls) wall_tables_.emplace_back(wall, lambda_m_);
  for (const auto& receiver : scene.receivers) {
    antennas_.insert(antennas_.end(), receiver.begin(), receiver.end());
    middles_.push_back(receiver[0]);
    middles_.back().position = (receiver.front().position + receiver.back().position) / 2.0;
  }
  for (const Body& body : scene.furniture) furniture_rows_.push_back(body_row(body));
  static_sum_.resize(antennas_.size() * blocks_);
  for (std::size_t a = 0; a < antennas_.size(); ++a) {
    const std::vector<Path> paths = reference_paths(scene_, antennas_[a], 0);
    const double weakest = weakest_that_counts(paths);
    for (const Path& path : paths) add_static_row(a, path, !path.diffuse && power_of(path) >= weakest);
  }
  legs_.pad();
  for (std::size_t r = 0; r < middles_.size(); ++r) {
    double power = 0;
    for (std::size_t a = r * per_receiver_; a < (r + 1) * per_receiver_; ++a)
      for (std::size_t k = 0; k < scene.tones.size(); ++k) {
        const ToneSum& sum = static_sum_[a * blocks_ + k / kTonesPerSum];
        power += std::norm(std::complex<double>(sum.re[k % kTonesPerSum], sum.im[k % kTonesPerSum]));
      }
    still_rms_.push_back(std::sqrt(power / static_cast<double>(per_receiver_ * scene.tones.size())));
  }
}

/// Walls and furniture alone: F, their shadows on each other, stays as it is. Where what moves never `shadows` it, it is part
/// of the sum only.
void FastSolver::Impl::add_static_row(std::size_t antenna, const Path& path, bool shadows) {
  const std::complex<double> amplitude = path.amplitude * path.shadow;
  std::vector<ToneSum> row(blocks_);
  for (std::size_t k = 0; k < scene_.tones.size(); ++k) {
    const double hz = scene_.carrier_hz + scene_.tones[k] * kToneSpacing_hz;
    const auto h =
        amplitude * std::polar(1.0, -2 * kPi * std::fmod(hz / kSpeedOfLight_m_s * path.length_m, 1.0));
    const std::size_t block = k / kTonesPerSum, lane = k % kTonesPerSum;
    ToneSum& total = static_sum_[antenna * blocks_ + block];
    row[block].re[lane] = f(h.real()), row[block].im[lane] = f(h.imag());
    total.re[lane] += row[block].re[lane], total.im[lane] += row[block].im[lane];
  }
  if (!shadows) return;
  const std::size_t row_index = antenna_of_row_.size();
  antenna_of_row_.push_back(antenna);
  rows_.insert(rows_.end(), row.begin(), row.end());
  for (const Leg& leg : path.legs)
    if (!leg.is_point()) legs_.add(leg, static_cast<std::uint32_t>(row_index));
}

const FresnelTable& FastSolver::Impl::table_of(const Surface& surface) {
  for (const auto& [known, table] : body_tables_)
    if (known.eta == surface.eta && known.thickness_m == surface.thickness_m) return table;
  body_tables_.emplace_back(surface, FresnelTable(surface, lambda_m_));
  return body_tables_.back().second;
}

void FastSolver::Impl::solve(Snapshots bodies, std::span<std::complex<float>> out) {
  assert(out.size() == bodies.size() * scene_.tones.size() * antennas_.size());
  sums_.clear();
  for (std::size_t t = 0; t < bodies.size(); ++t)
    sums_.insert(sums_.end(), static_sum_.begin(), static_sum_.end());
  const KeySnapshots shadow_keys(bodies.size(), kShadowsEvery), path_keys(bodies.size(), kBodyPathsEvery);
  compute_shadows(bodies, shadow_keys);
  apply_shadows(bodies.size(), shadow_keys);
  slots_.assign(bodies[0], middles_.size() * pairs_.size());
  paths_.assign(slots_.count() * path_keys.keys().size(), std::nullopt);
  for (std::size_t key = 0; key < path_keys.keys().size(); ++key) find_body_paths(bodies, path_keys, key);
  fill_in_shadows(path_keys.keys().size());
  add_body_paths(bodies, path_keys);
  write(bodies.size(), out);
}

void FastSolver::Impl::compute_shadows(Snapshots bodies, const KeySnapshots& keys) {
  const std::size_t all = antenna_of_row_.size(), key_count = keys.keys().size();
  factors_.assign(all * key_count, 1.0f);
  shadowed_.assign(all, 0);
  near_.resize(legs_.columns[0].size() + 16);
  for (std::size_t key = 0; key < key_count; ++key) {
    optics_.begin_shadows(all);
    for (const Body& body : bodies[keys.keys()[key]]) ask_for_shadows_of(body);
    const auto factors = optics_.take_shadows();
    for (std::size_t path = 0; path < all; ++path) {
      if (factors[path] == 1.0f) continue;
      factors_[path * key_count + key] = factors[path];
      shadowed_[path] = 1;
    }
  }
}

/// On all legs of static paths.
void FastSolver::Impl::ask_for_shadows_of(const Body& body) {
  const BodyRow row = body_row(body);
  const Ball ball{row.centre[0], row.centre[1], row.centre[2], row.radius};
  const int count = kernels_.near_legs(legs_.view(), ball, f(2 / lambda_m_), near_.data());
  jobs_.clear();
  for (int i = 0; i < count; ++i) {
    const std::uint32_t leg = near_[static_cast<std::size_t>(i)];
    jobs_.push_back({&legs_.rows[leg], &row, legs_.path[leg]});
  }
  optics_.add_shadows(jobs_);
}

void FastSolver::Impl::apply_shadows(std::size_t snapshots, const KeySnapshots& keys) {
  const std::size_t key_count = keys.keys().size();
  for (std::size_t path = 0; path < shadowed_.size(); ++path) {
    if (!shadowed_[path]) continue;
    for (std::size_t t = 0; t < snapshots; ++t) {
      const auto& blend = keys.blend(t);
      Factor change = -1.0f;
      for (std::size_t i = 0; i < blend.count; ++i)
        change += blend.weight[i] * factors_[path * key_count + blend.first + i];
      ToneSum* sum = sum_at(t, antenna_of_row_[path]);
      for (std::size_t b = 0; b < blocks_; ++b)
        kernels_.add_scaled(sum[b], change.real(), change.imag(), rows_[path * blocks_ + b]);
    }
  }
}

void FastSolver::Impl::find_body_paths(Snapshots snapshots, const KeySnapshots& keys, std::size_t key) {
  const std::vector<Body>& bodies = snapshots[keys.keys()[key]];
  body_rows_.clear();
  for (const Body& body : bodies) body_rows_.push_back(body_row(body));
  body_rows_.insert(body_rows_.end(), furniture_rows_.begin(), furniture_rows_.end());
  key_ = key;
  body_table_.assign(body_rows_);
  pending_.clear();
  optics_.begin_shadows(slots_.count());
  std::vector<EllipsoidTask> ellipsoids;
  for (std::size_t r = 0; r < middles_.size(); ++r)
    for (std::size_t b = 0; b < bodies.size(); ++b)
      for (std::size_t p = 0; p < pairs_.size(); ++p) {
        const EllipsoidTask task{b, p, r, source_of(scene_, pairs_[p]),
                                 sink_of(scene_, pairs_[p], middles_[r].position)};
        if (bodies[b].shape == Shape::ellipsoid) {
          ellipsoids.push_back(task);
          continue;
        }
        found_.clear();
        add_edged_reflections(bodies[b], task.source, task.sink, lambda_m_, optics_, found_);
        for (const Reflection& found : found_) add_reflection(bodies, found, task);
      }
  reflect_on_ellipsoids(bodies, ellipsoids);
  finish_pending(keys.keys().size(), key);
}

/// What was not asked for is the mean of what was just before and after; where there is neither, nothing dims the path.
void FastSolver::Impl::fill_in_shadows(std::size_t keys) {
  for (std::size_t i = 0; i < paths_.size(); ++i) {
    if (!paths_[i] || paths_[i]->shadow_known) continue;
    std::complex<double> sum = 0;
    int known = 0;
    const auto take = [&](std::size_t neighbour) {
      if (!paths_[neighbour] || !paths_[neighbour]->shadow_known) return;
      sum += paths_[neighbour]->shadow;
      ++known;
    };
    if (i % keys > 0) take(i - 1);
    if (i % keys + 1 < keys) take(i + 1);
    if (known > 0) paths_[i]->shadow = sum / static_cast<double>(known);
  }
}

/// Amplitude and length change smoothly, and are interpolated between keys. The length follows each key's body to where it
/// really is: a body that bounces off a wall between two keys is met exactly to first order.
BodyPath FastSolver::Impl::between_keys(Snapshots bodies, const KeySnapshots& keys, std::size_t slot,
                                        std::size_t t) const {
  const auto& blend = keys.blend(t);
  const std::size_t body = slots_.body(slot);
  const std::optional<BodyPath>* at_keys = &paths_[slot * keys.keys().size()];
  BodyPath path{};
  for (std::size_t i = 0; i < blend.count; ++i) {
    std::size_t key = blend.first + i;
    const bool there = at_keys[key].has_value();
    // Out of sight at this key: nothing comes from there, but it has a length; that of the nearest key in sight.
    for (std::size_t step = 1; !at_keys[key]; ++step) {
      const std::size_t at = blend.first + i;
      if (at >= step && at_keys[at - step])
        key = at - step;
      else if (at + step < keys.keys().size() && at_keys[at + step])
        key = at + step;
    }
    const BodyPath& known = *at_keys[key];
    const double weight = blend.weight[i];
    const Vec3 moved = bodies[t][body].centre - bodies[keys.keys()[key]][body].centre;
    if (there) path.amplitude += weight * known.amplitude * known.shadow;
    path.length_m += weight * (known.length_m + glm::dot(known.slope, moved));
    path.bend_m += weight * known.bend_m;
    path.last += weight * known.last;
  }
  return path;
}

void FastSolver::Impl::add_body_paths(Snapshots bodies, const KeySnapshots& keys) {
  const std::size_t key_count = keys.keys().size();
  for (std::size_t slot = 0; slot < slots_.count(); ++slot) {
    const auto* at_keys = &paths_[slot * key_count];
    if (std::none_of(at_keys, at_keys + key_count, [](const auto& path) { return path.has_value(); }))
      continue;
    for (std::size_t t = 0; t < bodies.size(); ++t) {
      const BodyPath path = between_keys(bodies, keys, slot, t);
      if (path.amplitude != 0.0) add_to_antennas(path, slots_.way(slot) / pairs_.size(), t);
    }
  }
}

void FastSolver::Impl::reflect_on_ellipsoids(const std::vector<Body>& bodies,
                                             const std::vector<EllipsoidTask>& tasks) {
  EllipsoidLanes lanes;
  for (std::size_t first = 0; first < tasks.size(); first += 16) {
    for (std::size_t lane = 0; lane < 16; ++lane) {
      const EllipsoidTask& task = tasks[std::min(first + lane, tasks.size() - 1)];
      const Body& body = bodies[task.body];
      const Vec3 s = task.source - body.centre, q = task.sink - body.centre;
      const Mat3 j = stretch_of(body);
      lanes.sx[lane] = f(s.x), lanes.sy[lane] = f(s.y), lanes.sz[lane] = f(s.z);
      lanes.qx[lane] = f(q.x), lanes.qy[lane] = f(q.y), lanes.qz[lane] = f(q.z);
      for (std::size_t i = 0; i < 9; ++i)
        lanes.j[i][lane] = f(j[static_cast<int>(i / 3)][static_cast<int>(i % 3)]);
    }
    kernels_.ellipsoids(lanes);
    for (std::size_t lane = 0; lane < 16 && first + lane < tasks.size(); ++lane) {
      const EllipsoidTask& task = tasks[first + lane];
      const Body& body = bodies[task.body];
      if (!(lanes.slope[lane] < kNewtonFound)) {
        for (const Reflection& r : reflections(body, task.source, task.sink, lambda_m_))
          add_reflection(bodies, r, task);
        continue;
      }
      const Vec3 u = glm::normalize(Vec3{lanes.ux[lane], lanes.uy[lane], lanes.uz[lane]});
      if (const auto r = ellipsoid_reflection(body, u, task.source, task.sink))
        add_reflection(bodies, *r, task);
    }
  }
}

void FastSolver::Impl::add_reflection(const std::vector<Body>& bodies, const Reflection& r,
                                      const EllipsoidTask& task) {
  if (std::abs(r.spreading) * r.s1_m < kWeakestReflection) return;
  const Pair& pair = pairs_[task.pair];
  const Antenna& rx = middles_[task.receiver];
  const BodyWay way = body_way(scene_, pair, r, task.source, task.sink, rx.position);
  if (!is_open(scene_, way)) return;
  const FresnelTable& surface = table_of(bodies[task.body].surface);
  const std::complex<double> gain = field_gain(
      scene_.transmitter, rx, way.points_span(), way.normals_span(), [&](std::size_t i, double cosine) {
        return i == way.body_bounce ? surface.at(cosine) : wall_tables_[way.wall_of(i)].at(cosine);
      });
  const std::size_t slot = slots_.slot(task.receiver * pairs_.size() + task.pair, task.body, r.face);
  const Vec3 slope = glm::normalize(r.point - task.source) + glm::normalize(r.point - task.sink);
  BodyPath path{lambda_m_ / (4 * kPi) * r.spreading * gain, r.s1_m + r.s2_m, r.caustic_m + r.s2_m,
                glm::normalize(rx.position - way.points[way.legs - 1]), slope};
  const double strength = std::abs(path.amplitude) / still_rms_[task.receiver];
  const bool faint = strength < kFaint;
  path.shadow_known = faint || strength >= kWeak || key_ % 2 == 0;
  if (path.shadow_known && !faint)
    for (std::size_t i = 0; i < way.legs; ++i)
      if (const Leg leg = way.leg(i, r); !leg.is_point())
        optics_.add_shadows(leg_row(leg), body_table_, way.touches_body(i) ? static_cast<int>(task.body) : -1,
                            static_cast<std::uint32_t>(slot));
  pending_.push_back({path, slot});
}

void FastSolver::Impl::finish_pending(std::size_t keys, std::size_t key) {
  const auto factors = optics_.take_shadows();
  for (Pending& pending : pending_) {
    pending.path.shadow = std::complex<double>(factors[pending.slot]);
    paths_[pending.slot * keys + key] = pending.path;
  }
}

void FastSolver::Impl::add_to_antennas(const BodyPath& path, std::size_t receiver, std::size_t t) {
  // From the middle of the array to its antennas: along the ray, and across it as the wave front bends.
  for (std::size_t a = 0; a < per_receiver_; ++a) {
    const Vec3 step = antennas_[receiver * per_receiver_ + a].position - middles_[receiver].position;
    const double onward_m = glm::dot(step, path.last);
    const double length_m =
        path.length_m + onward_m + (glm::dot(step, step) - onward_m * onward_m) / (2 * path.bend_m);
    const double cycles = scene_.carrier_hz / kSpeedOfLight_m_s * length_m,
                 turns = cycles - std::floor(cycles);
    ToneSum* sum = sum_at(t, receiver * per_receiver_ + a);
    for (std::size_t b = 0; b < blocks_; ++b)
      kernels_.add_path(sum[b], f(path.amplitude.real()), f(path.amplitude.imag()), f(turns),
                        f(length_m / kSpeedOfLight_m_s), &offsets_hz_[b * kTonesPerSum]);
  }
}

void FastSolver::Impl::write(std::size_t snapshots, std::span<std::complex<float>> out) const {
  const std::size_t tones = scene_.tones.size(), antennas = antennas_.size();
  for (std::size_t t = 0; t < snapshots; ++t)
    for (std::size_t a = 0; a < antennas; ++a) {
      const ToneSum* sum = &sums_[(t * antennas + a) * blocks_];
      for (std::size_t k = 0; k < tones; ++k) {
        const std::size_t block = k / kTonesPerSum, lane = k % kTonesPerSum;
        out[(t * tones + k) * antennas + a] = {sum[block].re[lane], sum[block].im[lane]};
      }
    }
}

FastSolver::FastSolver(const Scene& scene, const FastKernels& kernels)
    : impl_(std::make_unique<Impl>(scene, kernels)) {}
FastSolver::~FastSolver() = default;
FastSolver::FastSolver(const FastSolver& other) : impl_(std::make_unique<Impl>(*other.impl_)) {}

void FastSolver::solve(std::span<const std::vector<Body>> bodies, std::span<std::complex<float>> out) {
  impl_->solve(bodies, out);
}

std::vector<std::vector<Body>> bodies_over_time(const Scene& scene) {
  std::vector<std::vector<Body>> snapshots(static_cast<std::size_t>(scene.snapshots));
  for (std::size_t t = 0; t < snapshots.size(); ++t)
    for (const MovingBody& body : scene.bodies)
      snapshots[t].push_back(body.at(static_cast<double>(t) * scene.step_s));
  return snapshots;
}

std::vector<std::complex<float>> solve_fast(const Scene& scene, const FastKernels& kernels) {
  const auto bodies = bodies_over_time(scene);
  std::vector<std::complex<float>> h(bodies.size() * scene.tones.size() * scene.receivers.size() *
                                     scene.receivers[0].size());
  FastSolver(scene, kernels).solve(bodies, h);
  return h;
}

}  // namespace csipose::sim
