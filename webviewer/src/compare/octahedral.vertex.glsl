#version 300 es
// A square before each object that faces the eye and covers its bounding sphere.
precision highp float;
precision highp sampler2D;
layout(location = 0) in float a_object;
uniform sampler2D u_table; // two texels an object: centre relative to the origin and radius; tile's texel, layer
uniform mat4 u_view_projection; // without translation
uniform vec3 u_eye; // relative to the origin
uniform float u_side;
uniform float u_focal; // pixels
uniform float u_frame; // texels
flat out vec4 v_sphere; // centre relative to the eye, radius
flat out vec3 v_tile;
flat out vec2 v_grid; // where the view lies between frames, 0 to side - 1
flat out float v_level;
out vec3 v_ray; // eye to the square

FRAMES

void main() {
  int o = int(a_object);
  int width = textureSize(u_table, 0).x;
  vec4 sphere = texelFetch(u_table, ivec2(2 * o % width, 2 * o / width), 0);
  v_tile = texelFetch(u_table, ivec2((2 * o + 1) % width, (2 * o + 1) / width), 0).xyz;
  v_sphere = vec4(sphere.xyz - u_eye, sphere.w);
  float distance = length(v_sphere.xyz);
  vec3 d = -v_sphere.xyz / distance;
  v_grid = (0.5 * frameSquare(d) + 0.5) * (u_side - 1.0);
  v_level = max(0.0, log2(u_frame * distance / (2.0 * sphere.w * u_focal)));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  float covers = sphere.w / sqrt(max(1e-6, 1.0 - pow(sphere.w / distance, 2.0)));
  v_ray = v_sphere.xyz + covers * (frameAxes(d) * corner);
  gl_Position = u_view_projection * vec4(v_ray, 1.0);
}
