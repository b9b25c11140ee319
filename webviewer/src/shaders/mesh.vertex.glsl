// Level geometry. three.js declares position, normal and the matrices.
SURFACE

void main() {
  // normalMatrix leads to camera axes; the lighting wants world axes.
  surface(transpose(mat3(viewMatrix)) * (normalMatrix * normal));
  // modelViewMatrix was multiplied in float64 on the CPU: far coordinates do not shake.
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}
