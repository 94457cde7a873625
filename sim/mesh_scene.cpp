#include "sim/mesh_scene.h"

#include <fmt/core.h>

#include "proto/result.h"
#include "sim/material.h"
#include "sim/mesh_file.h"
#include "sim/scene_file.h"

namespace csipose::sim {
namespace {

/// Meshes one after the other, with what each of their materials is.
struct Collection {
  Mesh mesh;
  std::vector<Surface> surfaces;

  void add(const Mesh& part, const std::vector<Surface>& its_surfaces) {
    const auto first_point = static_cast<std::uint32_t>(mesh.points.size()),
               first_material = static_cast<std::uint32_t>(surfaces.size());
    mesh.points.insert(mesh.points.end(), part.points.begin(), part.points.end());
    for (Mesh::Triangle t : part.triangles) {
      for (std::uint32_t& corner : t.corners) corner += first_point;
      t.material += first_material;
      mesh.triangles.push_back(t);
    }
    mesh.materials.insert(mesh.materials.end(), part.materials.begin(), part.materials.end());
    surfaces.insert(surfaces.end(), its_surfaces.begin(), its_surfaces.end());
  }
};

std::vector<Surface> walls_of(const Mesh& mesh, double carrier_hz) {
  std::vector<Surface> surfaces;
  for (const std::string& name : mesh.materials) {
    const Material& material = *find_material(name);
    surfaces.push_back({material.permittivity(carrier_hz), material.slab_m});
  }
  return surfaces;
}

void check_indoors(const Scene& scene, const MeshSurfaces& surfaces) {
  const auto check = [&](const Vec3& p, const std::string& what) {
    if (!surfaces.is_indoors(p))
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format(
              "{}: {} at ({:.3f}, {:.3f}, {:.3f}) has no floor below or no ceiling above it; is it outside "
              "the room, or is z not the height? An OBJ file for this must have z up",
              scene.mesh_uses[0].file, what, p.x, p.y, p.z));
  };
  check(scene.transmitter.position, "the transmitter");
  for (std::size_t r = 0; r < scene.receivers.size(); ++r)
    for (const Antenna& antenna : scene.receivers[r])
      check(antenna.position, fmt::format("receiver {}", r + 1));
}

void read_still_meshes(Scene& scene, const std::filesystem::path& folder) {
  Collection all;
  if (scene.walls) all.add(mesh_of(scene.room, {}), {scene.room.walls.begin(), scene.room.walls.end()});
  for (const MeshUse& use : scene.mesh_uses) {
    const Mesh mesh = read_mesh(folder / use.file, use.import);
    all.add(mesh, walls_of(mesh, scene.carrier_hz));
  }
  auto surfaces = std::make_shared<const MeshSurfaces>(all.mesh, all.surfaces);
  if (chains_of(surfaces->polygons(), scene.wall_order) > kMostChains)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format(
            "{}: with {} polygons there are too many paths of {} bounces; give a smaller \"order\", or a "
            "mesh with fewer planes",
            scene.mesh_uses[0].file, surfaces->polygons(), scene.wall_order));
  if (!scene.walls) check_indoors(scene, *surfaces);
  scene.meshes = std::move(surfaces);
}

}  // namespace

void read_meshes(Scene& scene, const std::filesystem::path& folder) {
  if (!scene.mesh_uses.empty()) read_still_meshes(scene, folder);
  for (MeshBody& body : scene.mesh_bodies) {
    const std::string file = (folder / body.use.file).string();
    body.mesh = read_mesh(file, body.use.import);
    require_body(body.mesh, file);
    body.mesh = refined(body.mesh, kBodyFacet_m);
  }
}

Scene read_scene_with_meshes(const std::filesystem::path& file) {
  Scene scene = read_scene(file);
  read_meshes(scene, file.parent_path());
  return scene;
}

}  // namespace csipose::sim
