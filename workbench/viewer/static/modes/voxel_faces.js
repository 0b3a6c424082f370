// Voxels as the at most three of their faces that can be seen; and the surface they were made of.

import { LOOK_GLSL } from "../shading.js";

/** Where a corner of a face comes: faces of one direction are drawn together, four corners each. */
const FACE_PLACE = `
uniform highp usampler2D u_records;       // of faces, in rows of 1024
uniform int u_first;                      // the face that is drawn first
uniform int u_axis;                       // that the faces look along
uniform int u_side;                       // 0 for faces on the lower side of voxels, 1 on the upper
uniform vec3 u_corner;                    // of the chunk
uniform float u_voxel;
uniform uint u_octants;                   // those of the chunk that are drawn, a bit each
uniform int u_half;                       // the bit of a cell that tells its octant
uniform vec3 u_from;                      // the eye
uniform mat4 u_clip;
uvec4 record;

// The place; false where the face looks away or is not to be drawn.
bool placed(out vec3 place) {
  int number = u_first + (gl_VertexID >> 2);
  record = texelFetch(u_records, ivec2(number & 1023, number >> 10), 0);
  uvec3 cell = uvec3(record.x, record.x >> 8, record.x >> 16) & 255u;
  uvec3 half_ = (cell >> u_half) & 1u;
  bool within = ((u_octants >> (half_.x | half_.y << 1 | half_.z << 2)) & 1u) != 0u;
  vec3 step = vec3(0.0);
  step[u_axis] = float(u_side);
  step[(u_axis + 1) % 3] = float(gl_VertexID & 1);
  step[(u_axis + 2) % 3] = float((gl_VertexID >> 1) & 1);
  place = u_corner + (vec3(cell) + step) * u_voxel;
  float before = u_from[u_axis] - place[u_axis];
  return within && (u_side == 1 ? before > 0.0 : before < 0.0);
}
const vec4 NOWHERE = vec4(2.0, 2.0, 2.0, 1.0);
`;

const SURFACE_PLACE = `
layout(location = 0) in vec3 a_place;
uniform vec3 u_corner;
uniform mat4 u_clip;
`;

// Surfaces reach beyond their chunk, where another shows them.
const IN_CHUNK = `
uniform vec3 u_low;
uniform vec3 u_high;
bool beyond(vec3 p) { return any(lessThan(p, u_low)) || any(greaterThan(p, u_high)); }
`;

export const VOXEL_VERTEX = `${FACE_PLACE}
uniform bool u_colored;
uniform bool u_turned;     // faces opposite those the file has: walls from inside
out vec3 v_point;
flat out vec3 v_normal;
flat out vec3 v_color;
void main() {
  vec3 place;
  bool shown = placed(place);
  v_point = place;
  v_normal = vec3(uvec3(record.y, record.y >> 10, record.y >> 20) & 1023u) - 512.0;
  if (u_turned) v_normal = -v_normal;
  v_color = u_colored ? vec3(uvec3(record.z, record.z >> 8, record.z >> 16) & 255u) / 255.0 : vec3(0.77);
  gl_Position = shown ? u_clip * vec4(place, 1.0) : NOWHERE;
}`;

export const SURFACE_VERTEX = `${SURFACE_PLACE}
layout(location = 1) in vec3 a_normal;
layout(location = 2) in vec3 a_color;
centroid out vec3 v_point;
out vec3 v_normal;
out vec3 v_color;
void main() {
  v_point = u_corner + a_place;
  v_normal = a_normal;
  v_color = a_color;
  gl_Position = u_clip * vec4(v_point, 1.0);
}`;

const shaded = (inputs, chosen) => `
${inputs}
uniform bool u_tinted;
uniform vec3 u_tint;       // sRGB
out vec4 o_color;
${LOOK_GLSL}
void main() {
  if (cut(v_point)) discard;
  ${chosen}
  vec3 albedo = decoded(u_tinted ? u_tint : v_color);
  o_color = vec4(encoded(lit(albedo, n, v_point)), 1.0);
}`;

export const VOXEL_FRAGMENT = shaded("in vec3 v_point; flat in vec3 v_normal; flat in vec3 v_color;", "vec3 n = v_normal;");
// A place beyond the edge of its triangle might lie in a chunk that does not have the triangle.
export const SURFACE_FRAGMENT = shaded(
  `centroid in vec3 v_point; in vec3 v_normal; in vec3 v_color;${IN_CHUNK}`,
  "if (beyond(v_point)) discard; vec3 n = gl_FrontFacing ? v_normal : -v_normal;",
);

export const VOXEL_ID_VERTEX = `${FACE_PLACE}
out vec3 v_point;
void main() {
  bool shown = placed(v_point);
  gl_Position = shown ? u_clip * vec4(v_point, 1.0) : NOWHERE;
}`;

export const SURFACE_ID_VERTEX = `${SURFACE_PLACE}
out vec3 v_point;
void main() {
  v_point = u_corner + a_place;
  gl_Position = u_clip * vec4(v_point, 1.0);
}`;

const numbered = (declared, left) => `
in vec3 v_point;
uniform vec4 u_section;
uniform int u_number;
out vec4 o_bytes;
${declared}
void main() {
  if (dot(u_section.xyz, v_point) + u_section.w < 0.0 ${left}) discard;
  o_bytes = vec4(u_number & 255, (u_number >> 8) & 255, (u_number >> 16) & 255, 255) / 255.0;
}`;

/** One more than the row of the node, in the lowest three bytes. */
export const VOXEL_ID_FRAGMENT = numbered("", "");
export const SURFACE_ID_FRAGMENT = numbered(IN_CHUNK, "|| beyond(v_point)");
