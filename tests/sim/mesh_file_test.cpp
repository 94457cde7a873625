// OBJ and PLY files: what is read, and the words for what is not.
#include "sim/mesh_file.h"

#include <gtest/gtest.h>

#include <cstring>

#include "proto/result.h"

namespace csipose::sim {
namespace {

constexpr const char* kTetrahedron = R"(# a tetrahedron
mtllib not_there.mtl
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1.5
usemtl wood
f 1 3 2
f 1/1 2/2 4/4
f 2//1 3//1 4//1
usemtl glass
f -2 -4 -1   # relative indices
)";

std::string refusal(const std::string& text, const MeshImport& import = {}, bool ply = false) {
  try {
    (ply ? parse_ply : parse_obj)(text, "room.obj", import);
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    return error.what();
  }
  return "";
}

#define EXPECT_REFUSED(text, part) \
  EXPECT_NE(refusal(text).find(part), std::string::npos) << "says: " << refusal(text)

TEST(Obj, IsReadWithItsMaterials) {
  const Mesh mesh = parse_obj(kTetrahedron, "t.obj", {});
  EXPECT_EQ(mesh.points.size(), 4u);
  ASSERT_EQ(mesh.triangles.size(), 4u);
  EXPECT_EQ(mesh.materials, (std::vector<std::string>{"wood", "glass"}));
  EXPECT_EQ(mesh.triangles[2].material, 0u);
  EXPECT_EQ(mesh.triangles[3].material, 1u);
  const MeshChecks found = check(mesh);
  EXPECT_TRUE(found.closed);
  EXPECT_TRUE(found.convex);
  EXPECT_NEAR(found.volume_m3, 1.5 / 6, 1e-12);
}

TEST(Obj, ScalesAndRenames) {
  std::string text = kTetrahedron;
  text.replace(text.find("usemtl wood"), 11, "usemtl Oak");
  const Mesh mesh = parse_obj(text, "t.obj", {.scale = 2, .material = {}, .materials = {{"Oak", "wood"}}});
  EXPECT_EQ(mesh.materials[0], "wood");
  EXPECT_NEAR(check(mesh).volume_m3, 8 * 1.5 / 6, 1e-12);
}

TEST(Obj, QuadsBecomeTwoTrianglesAndCornersAreWelded) {
  const Mesh mesh = parse_obj(
      "usemtl wood\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
      "v 0 1 0\nv 1 1 0\nv 1 1 1\nf 5 6 7\n",
      "q.obj", {});
  EXPECT_EQ(mesh.triangles.size(), 3u);
  EXPECT_EQ(mesh.points.size(), 5u);
}

TEST(Obj, RefusesInWords) {
  const std::string v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  EXPECT_REFUSED(v, "room.obj: has no faces");
  EXPECT_REFUSED(v + "f 1 2 3\n", "room.obj:4: this face has no material");
  EXPECT_REFUSED("usemtl straw\n" + v, "room.obj:1: there is no material 'straw'");
  EXPECT_REFUSED("usemtl wood\n" + v + "f 1 2 4\n", "room.obj:5: names point 4, but there are 3");
  EXPECT_REFUSED("usemtl wood\n" + v + "f 1 2\n", "this face has 2 corners");
  EXPECT_REFUSED("usemtl wood\n" + v + "f 1 2 x\n", "'x' where a corner should be");
  EXPECT_REFUSED("v 0 0\n", "room.obj:1: ends where z should be");
  EXPECT_REFUSED("v 0 0 nan\n", "not finite");
  EXPECT_REFUSED("usemtl wood\nv 0 0 0\nv 4000 0 0\nv 0 3000 0\nf 1 2 3\n",
                 "surely its unit is not the metre");
  EXPECT_REFUSED("usemtl wood\nv 0 0 0\nv 2 0 0\nv 0.2 0.2 0\nv 0 2 0\nf 1 2 3 4\nf 2 3 4 1\n", "not convex");
}

TEST(Obj, ABodyMustBeClosed) {
  Mesh mesh = parse_obj(kTetrahedron, "t.obj", {});
  turn_over(mesh);
  require_body(mesh, "t.obj");
  EXPECT_GT(check(mesh).volume_m3, 0) << "turned outward";
  mesh.triangles.pop_back();
  EXPECT_THROW(require_body(mesh, "t.obj"), SetupError);
}

constexpr const char* kPly =
    "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty "
    "float z\n"
    "property uchar red\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0 9\n1 0 0 9\n0 1 0 9\n0 0 1.5 9\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n";

TEST(Ply, IsReadAsText) {
  const Mesh mesh = parse_ply(kPly, "t.ply", {.scale = 1, .material = "metal", .materials = {}});
  EXPECT_EQ(mesh.materials, (std::vector<std::string>{"metal"}));
  EXPECT_NEAR(check(mesh).volume_m3, 1.5 / 6, 1e-12);
  EXPECT_TRUE(check(mesh).closed);
}

TEST(Ply, IsReadAsBytes) {
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty double x\nproperty double "
      "y\nproperty double z\n"
      "element face 1\nproperty list uchar uint vertex_index\nend_header\n";
  const auto append = [&bytes](const auto& x) {
    char raw[sizeof x];
    std::memcpy(raw, &x, sizeof x);
    bytes.append(raw, sizeof x);
  };
  for (const double x : {0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0}) append(x);
  append(std::uint8_t{3});
  for (const std::uint32_t i : {0u, 1u, 2u}) append(i);
  EXPECT_EQ(parse_ply(bytes, "t.ply", {.scale = 1, .material = "metal", .materials = {}}).triangles.size(),
            1u);
  bytes.pop_back();
  EXPECT_NE(refusal(bytes, {.scale = 1, .material = "metal", .materials = {}}, true).find("ends too early"),
            std::string::npos);
}

TEST(Ply, RefusesInWords) {
  const auto words = [](std::string text, const std::string& from, const std::string& to) {
    text.replace(text.find(from), from.size(), to);
    return refusal(text, {.scale = 1, .material = "metal", .materials = {}}, true);
  };
  EXPECT_NE(words(kPly, "ply\n", "plx\n").find("does not begin with 'ply'"), std::string::npos);
  EXPECT_NE(words(kPly, "ascii", "binary_big_endian").find("is not read here"), std::string::npos);
  EXPECT_NE(words(kPly, "float", "flaot").find("where a type should be"), std::string::npos);
  EXPECT_NE(words(kPly, "3 0 2 1", "3 0 2 7").find("names point 7"), std::string::npos);
  EXPECT_NE(words(kPly, "property float z\n", "").find("finite"), std::string::npos);
  EXPECT_NE(refusal(kPly, {}, true).find("has no material"), std::string::npos);
}

TEST(ReadMesh, AsksForAFileThatItKnows) {
  EXPECT_THROW(read_mesh("room.fbx", {}), SetupError);
  EXPECT_THROW(read_mesh("not-there.obj", {}), SetupError);
}

}  // namespace
}  // namespace csipose::sim
