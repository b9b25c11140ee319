// The lighting of farfield.bake.shade, with which impostors were baked.
in vec3 v_normal;
in vec4 v_color;
in vec2 v_uv;
in vec2 v_glow_uv;

uniform vec4 u_base;
uniform vec3 u_emissive;
uniform float u_cutoff; // 0: opaque
uniform sampler2D u_map;
uniform sampler2D u_glow;
uniform vec3 u_sun_direction;
uniform vec3 u_sun;
uniform vec3 u_sky;
uniform vec3 u_ground;
uniform int u_mode; // 2: black, for pictures that count what impostors cover; 3: faint, beside texels a pixel

out vec4 o_color;

void main() {
  vec4 base = u_base * v_color;
#ifdef TEXTURED
  base *= texture(u_map, v_uv); // an sRGB texture: decoded by the sampler
#endif
  if (u_cutoff > 0.0 && base.a < u_cutoff) discard;
  vec3 emissive = u_emissive;
#ifdef GLOWING
  emissive *= texture(u_glow, v_glow_uv).rgb; // sRGB as well
#endif
#ifdef UNLIT
  vec3 light = vec3(1.0);
#else
  vec3 n = normalize(v_normal);
#ifdef TWO_SIDED
  if (!gl_FrontFacing) n = -n;
#endif
  vec3 light = u_ground + (u_sky - u_ground) * ((n.y + 1.0) / 2.0) + u_sun * max(0.0, dot(n, u_sun_direction));
#endif
  vec3 color = clamp(base.rgb * light + emissive, 0.0, 1.0); // linear: the target encodes
#ifdef BLENDED
  float alpha = base.a;
#else
  float alpha = 1.0;
#endif
  if (u_mode == 3) color = vec3(0.04 + 0.25 * dot(color, vec3(0.2126, 0.7152, 0.0722)));
  o_color = u_mode == 2 ? vec4(0.0, 0.0, 0.0, 1.0) : vec4(color, alpha);
}
