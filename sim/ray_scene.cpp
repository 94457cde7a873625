#include "sim/ray_scene.h"

#include <embree3/rtcore.h>

#include <cstddef>
#include <limits>

#include "proto/result.h"

namespace csipose::sim {
namespace {

float f(double x) { return static_cast<float>(x); }

RTCRay ray_of(const Vec3& origin, const Vec3& direction, double from_m, double to_m) {
  RTCRay ray{};
  ray.org_x = f(origin.x), ray.org_y = f(origin.y), ray.org_z = f(origin.z);
  ray.dir_x = f(direction.x), ray.dir_y = f(direction.y), ray.dir_z = f(direction.z);
  ray.tnear = f(from_m), ray.tfar = f(to_m);
  ray.mask = ~0u;
  return ray;
}

}  // namespace

struct RayScene::Handles {
  RTCDevice device = rtcNewDevice("threads=1");
  RTCScene scene = nullptr;

  Handles() {
    if (device == nullptr)
      throw SetupError(ExitStatus::os_refusal, "Embree does not start on this machine; does it have SSE2?");
    scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
  }
  ~Handles() {
    if (scene != nullptr) rtcReleaseScene(scene);
    if (device != nullptr) rtcReleaseDevice(device);
  }
  Handles(const Handles&) = delete;
  Handles& operator=(const Handles&) = delete;
};

RayScene::RayScene() : handles_(std::make_unique<Handles>()) {}
RayScene::~RayScene() = default;
RayScene::RayScene(RayScene&&) noexcept = default;
RayScene& RayScene::operator=(RayScene&&) noexcept = default;

void RayScene::add(const Mesh& mesh) {
  const RTCGeometry geometry = rtcNewGeometry(handles_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* points = static_cast<float*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), mesh.points.size()));
  auto* corners = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), mesh.triangles.size()));
  for (const Vec3& p : mesh.points)
    for (int axis = 0; axis < 3; ++axis) *points++ = f(p[axis]);
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t corner : t.corners) *corners++ = corner;
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(handles_->scene, geometry);
  rtcReleaseGeometry(geometry);
}

void RayScene::commit() {
  rtcCommitScene(handles_->scene);
  if (rtcGetDeviceError(handles_->device) != RTC_ERROR_NONE)
    throw SetupError(ExitStatus::os_refusal, "Embree could not take in the meshes; is there memory left?");
}

bool RayScene::is_blocked(const Vec3& from, const Vec3& to, double margin_m) const {
  const double length_m = glm::distance(from, to);
  if (length_m <= 2 * margin_m) return false;
  RTCRay ray = ray_of(from, (to - from) / length_m, margin_m, length_m - margin_m);
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(handles_->scene, &context, &ray);
  return ray.tfar < 0;
}

std::optional<RayScene::Hit> RayScene::first_hit(const Vec3& origin, const Vec3& direction,
                                                 double from_m) const {
  RTCRayHit query{};
  query.ray = ray_of(origin, direction, from_m, std::numeric_limits<double>::infinity());
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(handles_->scene, &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  return Hit{double{query.ray.tfar}, query.hit.geomID, query.hit.primID, double{query.hit.u},
             double{query.hit.v}};
}

}  // namespace csipose::sim
