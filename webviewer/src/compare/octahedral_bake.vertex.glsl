// All frames of an object's atlas in one draw: an instance a frame.
uniform vec3 u_centre;
uniform float u_radius;
uniform int u_side; // frames along an edge
uniform float u_inner; // share of a frame that the bounding sphere fills
uniform mat3 u_uv_transform;
out vec3 v_normal;
out vec4 v_color;
out vec2 v_uv;
out vec2 v_glow_uv;
#ifdef GLOW_APART
in vec2 uv1;
#endif

FRAMES

void main() {
  ivec2 at = ivec2(gl_InstanceID % u_side, gl_InstanceID / u_side);
  vec3 d = frameDirection(2.0 * vec2(at) / float(u_side - 1) - 1.0);
  vec3 q = ((modelMatrix * vec4(position, 1.0)).xyz - u_centre) / u_radius;
  vec2 xy = u_inner * (q * frameAxes(d));
  v_normal = transpose(inverse(mat3(modelMatrix))) * normal;
#if defined(USE_COLOR_ALPHA)
  v_color = color;
#elif defined(USE_COLOR)
  v_color = vec4(color, 1.0);
#else
  v_color = vec4(1.0);
#endif
#ifdef TEXTURED
  v_uv = (u_uv_transform * vec3(uv, 1.0)).xy;
#else
  v_uv = vec2(0.0);
#endif
#if defined(GLOW_APART)
  v_glow_uv = uv1;
#elif defined(GLOWING)
  v_glow_uv = uv;
#else
  v_glow_uv = vec2(0.0);
#endif
  gl_Position = vec4(2.0 * (vec2(at) + 0.5 + 0.5 * xy) / float(u_side) - 1.0, -0.99 * dot(q, d), 1.0);
}
