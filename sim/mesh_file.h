// sim/mesh_file.h - meshes from Wavefront OBJ and PLY files.
//
//   OBJ   v, f, usemtl; faces of any number of corners as long as they are convex; indices from either end. All else
//         (normals, texture coordinates, groups, mtllib) is passed over: a material is known by its name alone
//   PLY   1.0, ASCII or little-endian binary; element vertex with x y z, element face with a list vertex_indices or
//         vertex_index; other properties and elements are passed over. PLY has no materials: the import gives one
//
// Our own, and small: it keeps double precision and says in which line what is wrong. Points are welded (mesh.h).
#pragma once

#include <filesystem>
#include <string_view>

#include "sim/mesh.h"

namespace csipose::sim {

/// Throws SetupError (bad_data) with file and line: no number, a point that is not finite, an index that is not there, a face
/// of less than three corners or not convex, an unknown material, no faces, a size that is no room's or body's (2 cm - 200 m).
Mesh parse_obj(std::string_view text, const std::string& file, const MeshImport& import);
Mesh parse_ply(std::string_view bytes, const std::string& file, const MeshImport& import);
/// By the name's ending; SetupError (no_input) when it cannot be read.
Mesh read_mesh(const std::filesystem::path& file, const MeshImport& import);

/// A body must have an inside. Turns it outward if need be; SetupError (bad_data) in words unless the mesh is closed.
void require_body(Mesh& mesh, const std::string& file);

}  // namespace csipose::sim
