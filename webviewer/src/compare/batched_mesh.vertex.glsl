// mesh.vertex.glsl for THREE.BatchedMesh: the object's matrix and colour come from tables.
#include <batching_pars_vertex>
out vec3 v_normal;
out vec4 v_color;
out vec2 v_uv;
out vec2 v_glow_uv;
#ifdef GLOW_APART
in vec2 uv1;
#endif

uniform mat3 u_uv_transform;

void main() {
  float entry = getIndirectIndex(gl_DrawID);
  mat4 matrix = getBatchingMatrix(entry);
  v_normal = transpose(inverse(mat3(matrix))) * normal;
#if defined(USE_COLOR_ALPHA)
  v_color = color;
#elif defined(USE_COLOR)
  v_color = vec4(color, 1.0);
#else
  v_color = vec4(1.0);
#endif
#ifdef USE_BATCHING_COLOR
  v_color *= vec4(getBatchingColor(entry).rgb, 1.0);
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
  gl_Position = projectionMatrix * (viewMatrix * (matrix * vec4(position, 1.0)));
}
