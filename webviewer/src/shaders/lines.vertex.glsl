#version 300 es
precision highp float;
layout(location = 0) in vec3 a_position; // relative to the anchor
uniform mat4 u_view_projection;
uniform vec3 u_camera; // relative to the anchor
void main() {
  gl_Position = u_view_projection * vec4(a_position - u_camera, 1.0);
}
