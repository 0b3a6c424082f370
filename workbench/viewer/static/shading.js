// How light falls on albedo, the same in every mode and in the pictures made without a browser.

/** Share of the light that comes from everywhere when a lamp or the camera's light is on. */
export const AMBIENT = 0.3;
/** Behind the model, sRGB-encoded. */
export const BACKGROUND = [0xd6 / 255, 0xd5 / 255, 0xd2 / 255];

/** To be put before a fragment shader: uniforms of the look, section and light. */
export const LOOK_GLSL = `
uniform vec3 u_light;    // unit, towards the lamp; from the camera where u_headlight
uniform float u_ambient; // 1 for colours as they are
uniform bool u_headlight;
uniform vec4 u_section;  // shown where dot(xyz, p) + w >= 0
uniform vec3 u_eye;

bool cut(vec3 p) { return dot(u_section.xyz, p) + u_section.w < 0.0; }

// Linear colour of a place p with normal n (either side of it) under the light.
vec3 lit(vec3 albedo, vec3 n, vec3 p) {
  vec3 l = u_headlight ? normalize(u_eye - p) : u_light;
  float size = length(n);
  float facing = size > 0.0 ? max(dot(n / size, l), 0.0) : 1.0;
  return albedo * (u_ambient + (1.0 - u_ambient) * facing);
}

vec3 encoded(vec3 linear) {
  vec3 c = clamp(linear, 0.0, 1.0);
  return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}

vec3 decoded(vec3 srgb) {
  return mix(pow((srgb + 0.055) / 1.055, vec3(2.4)), srgb / 12.92, lessThanEqual(srgb, vec3(0.04045)));
}
`;

/** Set what LOOK_GLSL asks for. */
export function setLook(gl, uniforms, view, look) {
  gl.uniform3fv(uniforms.u_light, look.light);
  gl.uniform1f(uniforms.u_ambient, look.lit ? AMBIENT : 1);
  gl.uniform1i(uniforms.u_headlight, look.headlight ? 1 : 0);
  gl.uniform4fv(uniforms.u_section, look.section);
  gl.uniform3fv(uniforms.u_eye, view.eye);
}
