#version 300 es
precision highp float;
in vec3 v_color;
flat in vec3 v_normal;
uniform vec3 u_sun_direction;
uniform vec3 u_sun;
uniform vec3 u_sky;
uniform vec3 u_ground;
uniform int u_mode; // 2: black, for pictures that count what impostors cover
out vec4 o_color;

void main() {
  vec3 light = u_ground + (u_sky - u_ground) * ((v_normal.y + 1.0) / 2.0) + u_sun * max(0.0, dot(v_normal, u_sun_direction));
  o_color = u_mode == 2 ? vec4(0.0, 0.0, 0.0, 1.0) : vec4(clamp(v_color * light, 0.0, 1.0), 1.0);
}
