// Directions of a hemi-octahedral atlas: the upper half of an octahedron unfolded into a square, turned by 45 degrees.
vec3 frameDirection(vec2 e) { // in [-1,1]
  vec2 xz = 0.5 * vec2(e.x + e.y, e.x - e.y);
  return normalize(vec3(xz.x, 1.0 - abs(xz.x) - abs(xz.y), xz.y));
}

vec2 frameSquare(vec3 d) {
  d.y = max(d.y, 0.0);
  d /= abs(d.x) + abs(d.y) + abs(d.z);
  return vec2(d.x + d.z, d.x - d.z);
}

// Columns: right and up of the picture seen from direction d.
mat2x3 frameAxes(vec3 d) {
  vec3 right = normalize(cross(abs(d.y) > 0.999 ? vec3(0.0, 0.0, -1.0) : vec3(0.0, 1.0, 0.0), d));
  return mat2x3(right, cross(d, right));
}
