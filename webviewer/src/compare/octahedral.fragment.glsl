#version 300 es
// Blends the three frames nearest to the view, each seen on its own plane through the object's centre.
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray u_atlas; // colour times coverage, coverage
uniform float u_side;
uniform float u_frame;
uniform float u_inner;
flat in vec4 v_sphere;
flat in vec3 v_tile;
flat in vec2 v_grid;
flat in float v_level;
in vec3 v_ray;
out vec4 o_color;

FRAMES

vec4 seen(vec2 at) {
  at = clamp(at, 0.0, u_side - 1.0);
  vec3 d = frameDirection(2.0 * at / (u_side - 1.0) - 1.0);
  vec3 q = (v_ray * (dot(v_sphere.xyz, d) / dot(v_ray, d)) - v_sphere.xyz) / v_sphere.w;
  vec2 xy = q * frameAxes(d);
  if (max(abs(xy.x), abs(xy.y)) > 1.0) return vec4(0.0);
  vec2 texel = v_tile.xy + u_frame * (at + 0.5 + 0.5 * u_inner * xy);
  return textureLod(u_atlas, vec3(texel / vec2(textureSize(u_atlas, 0).xy), v_tile.z), v_level);
}

void main() {
  vec2 base = min(floor(v_grid), u_side - 2.0);
  vec2 f = v_grid - base;
  bool upper = f.x + f.y > 1.0;
  vec4 color = (upper ? f.x + f.y - 1.0 : 1.0 - f.x - f.y) * seen(base + (upper ? 1.0 : 0.0));
  color += (upper ? 1.0 - f.y : f.x) * seen(base + vec2(1.0, 0.0));
  color += (upper ? 1.0 - f.x : f.y) * seen(base + vec2(0.0, 1.0));
  if (color.a < 1.0 / 255.0) discard;
  o_color = vec4(color.rgb / color.a, color.a); // linear; alpha becomes coverage
}
