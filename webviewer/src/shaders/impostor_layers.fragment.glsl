#version 300 es
// A texel of a layer: colour filtered within its own level and rectangle, coverage and depth of the nearest texel.
precision highp float;
precision highp int;
precision highp sampler2DArray;

in vec3 v_point;
in vec2 v_uv;
flat in vec3 v_offset;
flat in vec3 v_range;
flat in ivec4 v_rect;
flat in ivec3 v_ids;

uniform sampler2DArray u_pages;
uniform vec3 u_forward;
uniform vec2 u_depth; // depth = x + y / distance along forward
uniform int u_mode; // 0 picture, 1 tinted by layer, 2 impostor id as colour
uniform vec3 u_tints[4];

out vec4 o_color;

vec3 color_at(int level) {
  // Clamped half a texel inside the rectangle's own texels: the tile beside it must not shine in.
  vec2 low = vec2(v_rect.xy >> level) + 0.5;
  vec2 high = vec2((v_rect.xy + v_rect.zw - 1) >> level) + 0.5;
  vec2 at = clamp(v_uv / float(1 << level), low, high) / vec2(textureSize(u_pages, level).xy);
  return textureLod(u_pages, vec3(at, float(v_ids.x)), float(level)).rgb;
}

void main() {
  vec2 dx = dFdx(v_uv), dy = dFdy(v_uv);
  float lod = clamp(0.5 * log2(max(max(dot(dx, dx), dot(dy, dy)), 1e-12)), 0.0, 3.0);
  int nearest = int(lod + 0.5);
  ivec2 texel = clamp(ivec2(floor(v_uv)), v_rect.xy, v_rect.xy + v_rect.zw - 1) >> nearest;
  float a = floor(texelFetch(u_pages, ivec3(texel, v_ids.x), nearest).a * 255.0 + 0.5);
  if (a < 0.5) discard;

  float inverse = v_range.z + (a - 1.0) / 254.0 * (v_range.y - v_range.z);
  float scale = v_range.x * inverse; // surface point = point of the plane / scale; 0: infinitely far
  // (point / scale + offset) . forward, without dividing by a scale of 0
  float distance_scaled = dot(v_point + scale * v_offset, u_forward);
  gl_FragDepth = distance_scaled > 0.0 ? clamp(u_depth.x + u_depth.y * scale / distance_scaled, 0.0, 1.0) : 0.0;

  if (u_mode == 2) {
    o_color = vec4(vec3(v_ids.z & 255, (v_ids.z >> 8) & 255, v_ids.z >> 16) / 255.0, 1.0);
    return;
  }
  int base = int(lod);
  vec3 color = mix(color_at(base), color_at(min(base + 1, 3)), lod - float(base));
  if (u_mode == 1) color = mix(color, u_tints[v_ids.y & 3], 0.62);
  o_color = vec4(color, 1.0);
}
