// mesh.vertex.glsl for THREE.BatchedMesh: the object's matrix and colour come from tables.
#include <batching_pars_vertex>
SURFACE

void main() {
  float entry = getIndirectIndex(gl_DrawID);
  mat4 matrix = getBatchingMatrix(entry);
  surface(transpose(inverse(mat3(matrix))) * normal);
#ifdef USE_BATCHING_COLOR
  v_color *= vec4(getBatchingColor(entry).rgb, 1.0);
#endif
  gl_Position = projectionMatrix * (viewMatrix * (matrix * vec4(position, 1.0)));
}
