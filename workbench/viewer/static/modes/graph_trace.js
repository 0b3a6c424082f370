// Rays through a sparse voxel graph on the card: each pixel walks down and along (Jaspe 2018, 5.5.1).

/** Entries of a row of the textures that arrays lie in. */
export const ROW_BITS = 11;

/** Where pixels' rays go, for pixels of any size. */
export const RAYS = `
uniform vec3 u_right;     // of the camera, unit
uniform vec3 u_above;
uniform vec3 u_ahead;
uniform vec2 u_middle;    // of the picture, in pixels
uniform float u_focal;    // pixels that a length of 1 at distance 1 covers
// The ray to a place of the picture, of depth 1.
vec3 rayOf(vec2 pixel) {
  vec2 at = (pixel - u_middle) / u_focal;
  return u_ahead + at.x * u_right + at.y * u_above;
}
`;

export const FULL_SCREEN = `
void main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }`;

/** The walk and what is at its end, for a graph of a level. */
export const traceFragment = (level) => `
precision highp usampler2D;
const int LEVEL = ${level};
const int SIDE = ${1 << level};
uniform usampler2D u_halves;
uniform usampler2D u_bricks;
uniform usampler2D u_below;
uniform sampler2D u_colors;
uniform bool u_colored;
uniform int u_starts[LEVEL + 1];
uniform uint u_turn;      // of the root
uniform vec3 u_origin;    // the eye, in voxels from the corner of the cube
uniform float u_slope;    // cells are not looked into whose side is less than so much of their distance
uniform vec4 u_section;   // in voxels from the corner
uniform bool u_shadows;
uniform vec3 u_light;
uniform float u_pixel;    // pixels of the picture along one of these
layout(location = 0) out uvec2 o_met; // bits of the depth in voxels; colour, level of the cell, shadow
${RAYS}
uint half_(uint at) { return texelFetch(u_halves, ivec2(at & ${(1 << ROW_BITS) - 1}u, at >> ${ROW_BITS}), 0).r; }
uvec2 brickAt(uint at) { return texelFetch(u_bricks, ivec2(at & ${(1 << ROW_BITS) - 1}u, at >> ${ROW_BITS}), 0).rg; }
uint belowAt(uint at) { return texelFetch(u_below, ivec2(at & ${(1 << ROW_BITS) - 1}u, at >> ${ROW_BITS}), 0).r; }

uint bits(uint word) {
  word -= (word >> 1) & 0x55555555u;
  word = (word & 0x33333333u) + ((word >> 2) & 0x33333333u);
  return (((word + (word >> 4)) & 0x0f0f0f0fu) * 0x01010101u) >> 24;
}
uint byteOf(uvec2 brick, uint slot) { return ((slot < 4u ? brick.x : brick.y) >> (8u * (slot & 3u))) & 255u; }
uint maskOfHeader(uint head) {
  uint m = (head | head >> 1) & 0x5555u;
  m = (m | m >> 1) & 0x3333u;
  m = (m | m >> 2) & 0x0f0fu;
  return (m | m >> 4) & 255u;
}
uint fourOf(uint word) {
  word |= word >> 4;
  word |= word >> 2;
  word |= word >> 1;
  return (word & 1u) | (word >> 7 & 2u) | (word >> 14 & 4u) | (word >> 21 & 8u);
}
uint maskOfBrick(uvec2 brick) { return fourOf(brick.x) | fourOf(brick.y) << 4; }
uint widths(uint codes) { return bits((codes | codes >> 1) & 0x5555u) + bits(codes >> 1 & 0x5555u); }
// Offset and turn that are told at a half-word.
uvec2 pointer(uint at, uint code) {
  uint first = half_(at);
  if (code == 1u) return uvec2(first & 8191u, first >> 13);
  uint long_ = first << 16 | half_(at + 1u);
  return uvec2((long_ & 0x1fffffffu) | (code & 1u) << 29, long_ >> 29);
}
struct Place { uint node; uint head; uvec2 brick; uint mask; uint turn; };
Place rootPlace(uint turn) {
  uint head = half_(0u);
  return Place(0u, head, uvec2(0u), maskOfHeader(head), turn);
}
// The child in a slot, whose depth is told.
Place childOf(Place at, int depth, uint slot) {
  if (depth == LEVEL - 1) {
    at.mask = byteOf(at.brick, slot);
    return at;
  }
  uint code = at.head >> (2u * slot) & 3u;
  uvec2 to = pointer(at.node + 1u + widths(at.head & ((1u << (2u * slot)) - 1u)), code);
  at.turn ^= to.y;
  if (depth == LEVEL - 2) {
    at.brick = brickAt(to.x);
    at.mask = maskOfBrick(at.brick);
    return at;
  }
  at.node = uint(u_starts[depth]) + to.x;
  at.head = half_(at.node);
  at.mask = maskOfHeader(at.head);
  return at;
}

struct Met { float distance; ivec3 cell; int size; };
// The first full cell of a ray from a place, over a stretch of it.
Met met(vec3 from, vec3 way, float nearest, float farthest, float slope) {
  Met found = Met(0.0, ivec3(0), 0);
  // The geometry is mirrored, not the ray.
  bvec3 back = lessThan(way, vec3(0.0));
  uint flip = uint(back.x) | uint(back.y) << 1 | uint(back.z) << 2;
  vec3 o = mix(from, float(SIDE) - from, back);
  vec3 i = 1.0 / max(abs(way), vec3(1e-20));
  vec3 enter = -o * i;
  vec3 leave = (float(SIDE) - o) * i;
  float t = max(nearest, max(enter.x, max(enter.y, enter.z)));
  float end = min(farthest, min(leave.x, min(leave.y, leave.z)));
  if (!(t < end)) return found;
  Place stack[LEVEL];
  Place at = rootPlace(u_turn ^ flip);
  int depth = 0;
  int h = SIDE >> 1;
  ivec3 c = ivec3(lessThanEqual((vec3(h) - o) * i, vec3(t))) * h;
  // A walk that rounding led astray ends, too.
  for (int steps = 0; steps < 16 * SIDE; steps++) {
    uint seen = uint((c.x & h) != 0) | uint((c.y & h) != 0) << 1 | uint((c.z & h) != 0) << 2;
    uint slot = seen ^ at.turn;
    if ((at.mask >> slot & 1u) != 0u) {
      vec3 enters = (vec3(c) - o) * i;
      float here = max(0.0, max(enters.x, max(enters.y, enters.z)));
      if (h == 1 || float(h) <= slope * here) {
        return Met(max(here, t), ivec3(mix(vec3(c), vec3(SIDE - h - c), back)), h);
      }
      stack[depth] = at;
      depth++;
      h >>= 1;
      at = childOf(at, depth, slot);
      c += ivec3(lessThanEqual((vec3(c + h) - o) * i, vec3(t))) * h;
      continue;
    }
    vec3 next = (vec3(c + h) - o) * i;
    ivec3 step = next.x <= next.y && next.x <= next.z ? ivec3(h, 0, 0) : next.y <= next.z ? ivec3(0, h, 0) : ivec3(0, 0, h);
    t = max(t, min(next.x, min(next.y, next.z)));
    ivec3 flips = c ^ (c + step);
    int changed = flips.x | flips.y | flips.z;
    c += step;
    if (changed >= SIDE || t >= end) return found;
    if (changed >= 2 * h) {
      while (changed >= 2 * h) {
        h *= 2;
        depth--;
      }
      c &= ivec3(-h);
      at = stack[depth];
    }
  }
  return found;
}

// Which voxels, in depth-first order, stand in a cell: the first and how many (Dado 2016).
uvec2 voxelsOf(ivec3 cell, int size) {
  Place at = rootPlace(u_turn);
  uint first = 0u;
  uint count = belowAt(0u);
  int h = SIDE >> 1;
  for (int depth = 0; depth < LEVEL && h >= size; depth++, h >>= 1) {
    uint c = uint((cell.x & h) != 0) | uint((cell.y & h) != 0) << 1 | uint((cell.z & h) != 0) << 2;
    uint place = at.node + 1u;
    uint own = 0u;
    for (uint slot = 0u; slot < 8u; slot++) {
      uint here = 0u;
      if (depth == LEVEL - 1) here = at.mask >> slot & 1u;
      else if (depth == LEVEL - 2) here = bits(byteOf(at.brick, slot));
      else {
        uint code = at.head >> (2u * slot) & 3u;
        if (code > 0u) {
          uint to = pointer(place, code).x;
          if (depth == LEVEL - 3) {
            uvec2 brick = brickAt(to);
            here = bits(brick.x) + bits(brick.y);
          } else here = belowAt(uint(u_starts[depth + 1]) + to);
          place += min(code, 2u);
        }
      }
      uint octant = slot ^ at.turn;
      if (octant < c) first += here;
      if (octant == c) own = here;
    }
    count = own;
    if (depth < LEVEL - 1) at = childOf(at, depth + 1, c ^ at.turn);
  }
  return uvec2(first, count);
}

// Mean of up to eight voxels of a cell, in linear light; sRGB bytes.
uint colorOf(ivec3 cell, int size) {
  uvec2 range = voxelsOf(cell, size);
  uint taken = min(range.y, 8u);
  vec3 sum = vec3(0.0);
  for (uint k = 0u; k < taken; k++) {
    uint at = range.x + (k * range.y + range.y / 2u) / taken;
    vec3 c = texelFetch(u_colors, ivec2(at & ${(1 << ROW_BITS) - 1}u, at >> ${ROW_BITS}), 0).rgb;
    sum += mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, lessThanEqual(c, vec3(0.04045)));
  }
  vec3 c = sum / float(max(taken, 1u));
  c = mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
  uvec3 b = uvec3(c * 255.0 + 0.5);
  return b.r | b.g << 8 | b.b << 16;
}

void main() {
  vec3 way = normalize(rayOf(gl_FragCoord.xy * u_pixel));
  vec2 stretch = vec2(0.0, 1e30);
  float [2] planes = float[2](dot(u_section.xyz, u_origin) + u_section.w, dot(u_section.xyz, way));
  if (planes[1] > 0.0) stretch.x = max(0.0, -planes[0] / planes[1]);
  else if (planes[1] < 0.0) stretch.y = -planes[0] / planes[1];
  else if (planes[0] < 0.0) stretch.y = 0.0;
  Met hit = met(u_origin, way, stretch.x, stretch.y, u_slope);
  o_met = uvec2(0u);
  if (hit.size == 0) return;
  uint color = u_colored ? colorOf(hit.cell, hit.size) : 0xc4c4c4u;
  uint level = bits(uint(hit.size) - 1u);
  bool dark = false;
  if (u_shadows) {
    float size = float(hit.size);
    // From a little before the surface, and not from its own steps.
    vec3 from = u_origin + way * (hit.distance - size);
    dark = met(from, u_light, 2.5 * size, 1e30, 0.0).size > 0;
  }
  o_met = uvec2(floatBitsToUint(hit.distance * dot(way, u_ahead)), color | level << 24 | uint(dark) << 31);
}`;
