#version 300 es
// Boxes of objects whose geometry is not here yet: 36 vertices an instance, without any vertex buffer.
layout(location = 0) in vec3 a_low; // relative to the eye
layout(location = 1) in vec3 a_high;
layout(location = 2) in vec3 a_color; // sRGB
uniform mat4 u_view_projection;
out vec3 v_color;
flat out vec3 v_normal;

void main() {
  int face = gl_VertexID / 6;
  int axis = face >> 1;
  bool high = (face & 1) == 1;
  int k = gl_VertexID % 6;
  // Two triangles a face, counter-clockwise from outside.
  int corner = k < 3 ? k : (k == 3 ? 2 : (k == 4 ? 1 : 3));
  bool s = (corner & 1) == 1;
  bool t = (corner & 2) == 2;
  if (!high) { bool swap = s; s = t; t = swap; }
  vec3 at;
  at[axis] = high ? 1.0 : 0.0;
  at[(axis + 1) % 3] = s ? 1.0 : 0.0;
  at[(axis + 2) % 3] = t ? 1.0 : 0.0;
  v_normal = vec3(0.0);
  v_normal[axis] = high ? 1.0 : -1.0;
  v_color = mix(a_color / 12.92, pow((a_color + 0.055) / 1.055, vec3(2.4)), step(0.04045, a_color));
  gl_Position = u_view_projection * vec4(mix(a_low, a_high, at), 1.0);
}
