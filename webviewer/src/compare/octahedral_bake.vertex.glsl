// All frames of an object's atlas in one draw: an instance a frame.
uniform vec3 u_centre;
uniform float u_radius;
uniform int u_side; // frames along an edge
uniform float u_inner; // share of a frame that the bounding sphere fills

SURFACE
FRAMES

void main() {
  ivec2 at = ivec2(gl_InstanceID % u_side, gl_InstanceID / u_side);
  vec3 d = frameDirection(2.0 * vec2(at) / float(u_side - 1) - 1.0);
  vec3 q = ((modelMatrix * vec4(position, 1.0)).xyz - u_centre) / u_radius;
  vec2 xy = u_inner * (q * frameAxes(d));
  surface(transpose(inverse(mat3(modelMatrix))) * normal);
  gl_Position = vec4(2.0 * (vec2(at) + 0.5 + 0.5 * xy) / float(u_side) - 1.0, -0.99 * dot(q, d), 1.0);
}
