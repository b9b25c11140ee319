// What mesh.fragment.glsl takes of a vertex, however it is placed. three.js declares uv and color.
out vec3 v_normal;
out vec4 v_color;
out vec2 v_uv;
out vec2 v_glow_uv;
#ifdef GLOW_APART
in vec2 uv1;
#endif

uniform mat3 u_uv_transform;

void surface(vec3 normal) {
  v_normal = normal;
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
}
