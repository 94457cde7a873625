// sim/fast_kernels.h - the inner loops of the fast solver, compiled three times and chosen at run time.
//
// Plain structs and pointers only: what is compiled for AVX-512 must share no inline function with the rest.
#pragma once

#include <cstdint>
#include <string_view>

namespace csipose::sim {

/// A closed outline in scaled coordinates (metres times s of shadow.h), origin at the ray: centre + cos a +
/// sin b.
struct EllipseOutline {
  float cx, cy, ax, ay, bx, by;
};
/// Straight edge from (x, y) by (dx, dy).
struct EdgePiece {
  float x, y, dx, dy;
  int panels;  ///< of 8 Gauss points
};
/// The part of an ellipse from `start` over `span`, in turns.
struct ArcPiece {
  EllipseOutline ellipse;
  float start, span;
  int panels;
};
/// Edge of a flat face in metres, relative to the mirror point; z along the mirror ray.
struct FaceEdge {
  float x, y, z, dx, dy, dz;
  int panels;
};
/// Rim of a round face, likewise.
struct FaceRim {
  float cx, cy, cz, ax, ay, az, bx, by, bz;
};
/// The mirror ray: image to mirror point d1, mirror point to sink d2; k is the wave number, 1/m.
struct MirrorRay {
  float d1, d2, k;
};

/// Straight legs, column by column, padded to a multiple of 16 with legs of length 0 far away.
struct LegColumns {
  const float *x, *y, *z, *ux, *uy, *uz, *length, *before, *total;
  int count;
};
struct Ball {
  float x, y, z, radius;
};
struct LegRow {
  float x, y, z, ux, uy, uz, length, before, total;
};

/// Sixteen shortest ways by an ellipsoid at once: from S over c + J u to Q, all relative to c.
struct EllipsoidLanes {
  float sx[16], sy[16], sz[16], qx[16], qy[16], qz[16];
  float j[9][16];                ///< J, column by column
  float ux[16], uy[16], uz[16];  ///< out: the minimum
  float slope[16];               ///< out: |T^T g| there; 0 when found
};

/// Sixteen pairs of a leg and a body at once: how the body's outline looks along the leg, scaled (shadow.h).
struct ShadowLanes {
  float leg[9][16];     ///< LegRow, field by field
  float centre[3][16];  ///< the body's
  float j[9][16];       ///< its half axes as vectors: J, column by column
  float radius[16];     ///< of its bounding sphere
  float kind[16];       ///< 0 ellipsoid, 1 box, 2 cylinder
  // Out.
  float weight[16];              ///< of F - 1
  float x[16], y[16];            ///< of the outline's middle
  float px[3][16], py[3][16];    ///< the three half axes as seen along the leg
  float ax[16], ay[16], by[16];  ///< of an ellipsoid: conjugate half axes (ax, ay) and (0, by)
  float points[16];              ///< ... and how many points its outline wants
};

/// Bodies, column by column, padded to a multiple of 16 with balls of no size far away: the lanes of ShadowLanes.
struct BodyColumns {
  const float *centre[3], *j[9], *radius, *kind;
  int count;
};
/// Sixteen outlines of ellipsoids at once, with equally many points.
struct OutlineLanes {
  float x[16], y[16], ax[16], ay[16], by[16];  ///< as in ShadowLanes
  float re[16], im[16];                        ///< out: the integrals over 2 pi
};

/// One path's tones: 32 of them, the last ones padding.
struct ToneSum {
  float re[32], im[32];
};

struct FastKernels {
  std::string_view name;
  /// Outline integrals of shadow.h over 2 pi. `cosines`, `sines`: `points` (a multiple of 16) of one turn.
  void (*ellipses)(OutlineLanes&, const float* cosines, const float* sines, int points);
  void (*edges)(const EdgePiece*, int count, float sum[2]);
  void (*arcs)(const ArcPiece*, int count, float sum[2]);
  /// Aperture factors of body.h.
  void (*face)(const FaceEdge*, int count, const MirrorRay&, float sum[2]);
  void (*rim)(const FaceRim&, const MirrorRay&, const float* cosines, const float* sines, int points,
              float sum[2]);
  /// Indices of legs so close that a shadow may be more than nothing; returns how many.
  int (*near_legs)(const LegColumns&, const Ball&, float two_over_lambda, std::uint32_t* found);
  void (*ellipsoids)(EllipsoidLanes&);
  void (*shadow_views)(ShadowLanes&, float two_over_lambda);
  /// One leg against the bodies block .. block + 15; false, and nothing written, when all are clear of it.
  bool (*leg_views)(const BodyColumns&, int block, const LegRow&, float two_over_lambda, ShadowLanes&);
  /// sum += (re, im) e^{-j 2 pi (turns + offsets[k] delay)}, offsets in Hz.
  void (*add_path)(ToneSum& sum, float re, float im, float turns, float delay_s, const float offsets_hz[32]);
  /// sum += (re, im) * path, tone by tone.
  void (*add_scaled)(ToneSum& sum, float re, float im, const ToneSum& path);
};

/// For this processor, or those that the environment's CSIPOSE_SIM_ISA names. The three differ in the last bits only.
const FastKernels& best_kernels();
/// "avx512", "avx2" or "plain"; nullptr when this processor cannot run it.
const FastKernels* find_kernels(std::string_view name);

}  // namespace csipose::sim
