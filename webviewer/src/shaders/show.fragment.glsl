#version 300 es
// The averaged picture, encoded as the canvas shows it.
precision highp float;
uniform sampler2D u_picture; // sRGB: decoded by the sampler
out vec4 o_color;

void main() {
  vec3 c = texelFetch(u_picture, ivec2(gl_FragCoord.xy), 0).rgb;
  o_color = vec4(mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308))), 1.0);
}
