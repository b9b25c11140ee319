#version 300 es
// A pixel of a layer: the texels under four points of it. Colour is their mean by what they cover, in linear light;
// depth that of the nearest. Texels that the pixel does not touch have no part in it.
//
// With SAMPLE_MASK the points are the pixel's samples, each covered or not: two layers that meet within a pixel share its
// samples out between them, and nothing shines through. Without it alpha becomes coverage, of as many samples, but the same ones for
// both layers: a quarter of the background may show along such a line.
precision highp float;
precision highp int;
precision highp sampler2DArray;

in vec3 v_point;
in vec2 v_uv;
flat in vec3 v_offset;
flat in vec3 v_range;
flat in ivec4 v_rect;
flat in ivec3 v_ids;

uniform sampler2DArray u_pages; // sRGB: colour is decoded by the sampler, alpha is not
uniform vec3 u_forward;
uniform vec2 u_depth; // depth = x + y / distance along forward
uniform int u_mode; // 0 picture, 1 tinted by layer, 2 impostor id as colour, 3 texels a pixel
uniform vec3 u_tints[4];
uniform vec3 u_heat[7]; // classes of texels a pixel: below 1/2, 1, 2, 4, 8, 16, and more

out vec4 o_color;

// Where graphics cards have the four samples of a pixel, in order.
const vec2 POINT[4] = vec2[4](vec2(-0.125, -0.375), vec2(0.375, -0.125), vec2(-0.375, 0.125), vec2(0.125, 0.375));

void main() {
  vec2 dx = dFdx(v_uv), dy = dFdy(v_uv);
  // Each point stands for half the pixel's width: a coarser level where that spans more than a texel.
  int level = clamp(int(0.5 * log2(max(max(dot(dx, dx), dot(dy, dy)), 1e-12)) - 0.5), 0, 3);
  ivec2 low = v_rect.xy, high = v_rect.xy + v_rect.zw - 1;
  int covered = 0, nearest = 0, mask = 0;
  vec3 color = vec3(0.0);
  for (int k = 0; k < 4; k++) {
    ivec2 texel = clamp(ivec2(floor(v_uv + POINT[k].x * dx + POINT[k].y * dy)), low, high) >> level;
    vec4 found = texelFetch(u_pages, ivec3(texel, v_ids.x), level);
    int a = int(found.a * 255.0 + 0.5);
    if (a == 0) continue;
    int quarters = ((a - 1) & 3) + 1;
#ifdef SAMPLE_MASK
    if (((k * 3) & 3) >= quarters) continue; // as many of the samples in a texel as its share
    mask |= 1 << k;
    quarters = 4;
#endif
    covered += quarters;
    color += float(quarters) * found.rgb;
    nearest = max(nearest, (a - 1) >> 2);
  }
  if (covered == 0) discard;

  float inverse = v_range.z + float(nearest) / 62.0 * (v_range.y - v_range.z);
  float scale = v_range.x * inverse; // surface point = point of the plane / scale; 0: infinitely far
  // (point / scale + offset) . forward, without dividing by a scale of 0
  float distance_scaled = dot(v_point + scale * v_offset, u_forward);
  gl_FragDepth = distance_scaled > 0.0 ? clamp(u_depth.x + u_depth.y * scale / distance_scaled, 0.0, 1.0) : 0.0;

#ifdef SAMPLE_MASK
  gl_SampleMask[0] = u_mode == 2 ? -1 : mask;
#endif
  if (u_mode == 2) {
    if (covered < 8) discard;
    o_color = vec4(vec3(v_ids.z & 255, (v_ids.z >> 8) & 255, v_ids.z >> 16) / 255.0, 1.0);
    return;
  }
  color /= float(covered);
  if (u_mode == 3) {
    float texels = abs(dx.x * dy.y - dx.y * dy.x); // that lie in the pixel, at full detail
    color = u_heat[clamp(int(floor(log2(max(texels, 1e-6)))) + 2, 0, 6)];
  }
  if (u_mode == 1) color = mix(color, u_tints[v_ids.y & 3], 0.62);
#ifdef SAMPLE_MASK
  o_color = vec4(color, 1.0);
#else
  o_color = vec4(color, float(covered) / 16.0); // alpha becomes coverage
#endif
}
