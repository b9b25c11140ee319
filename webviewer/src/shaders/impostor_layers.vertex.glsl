#version 300 es
// One vertex of a layer's polygon. Everything that is one value a layer lies in u_rows, four texels a layer:
// (eye - anchor, plane), (1/near, 1/far, page, number), (x, y, width, height in the page), (impostor id + 1, -, -, -).
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp isampler2D;

layout(location = 0) in vec3 a_position; // relative to the impostor's eye
layout(location = 1) in vec2 a_uv; // texels of level 0
layout(location = 2) in uint a_row;

uniform sampler2D u_rows;
uniform isampler2D u_slots; // page -> layer of the texture array, -1: not resident
uniform mat4 u_view_projection; // without translation
uniform vec3 u_camera; // relative to the anchor

out vec3 v_point; // relative to the impostor's eye
out vec2 v_uv;
flat out vec3 v_offset; // impostor's eye - camera
flat out vec3 v_range; // plane, 1/near, 1/far
flat out ivec4 v_rect;
flat out ivec3 v_ids; // layer of the texture array, number of the layer, impostor id + 1

void main() {
  ivec2 at = ivec2(4 * int(a_row % 256u), int(a_row / 256u));
  vec4 eye_plane = texelFetch(u_rows, at, 0);
  vec4 range = texelFetch(u_rows, at + ivec2(1, 0), 0);
  v_rect = ivec4(texelFetch(u_rows, at + ivec2(2, 0), 0));
  int page = int(range.z);
  int slot = texelFetch(u_slots, ivec2(page % 1024, page / 1024), 0).r;
  v_ids = ivec3(slot, int(range.w), int(texelFetch(u_rows, at + ivec2(3, 0), 0).x));
  v_range = vec3(eye_plane.w, range.xy);
  v_offset = eye_plane.xyz - u_camera;
  v_point = a_position;
  v_uv = a_uv;
  gl_Position = slot < 0 ? vec4(2.0, 2.0, 2.0, 1.0) : u_view_projection * vec4(a_position + v_offset, 1.0);
}
