#version 430 core
// The lighting that the manifest states (docs/formats/placementdb.md); linear light, the reader encodes.
struct Row { vec4 x, y, z; vec4 base, glow; ivec4 what; };
layout(std430, binding = 0) readonly buffer Rows { Row rows[]; };

in vec3 v_normal;
in vec4 v_uv;
in vec4 v_color;
in float v_distance;
flat in int v_row;

uniform sampler2D u_texture;
uniform sampler2D u_glow;
uniform mat4x3 u_light;  // columns: direction to the sun, sun, sky, ground
uniform vec2 u_depth;  // depth = u_depth.x log2(distance) + u_depth.y

layout(location = 0) out vec4 o_color;
layout(location = 1) out ivec2 o_what;

void main() {
    Row r = rows[v_row];
    int flags = r.what.y;  // 1 double-sided, 2 masked, 4 unlit, 8 mirrored
    bool back = gl_FrontFacing == ((flags & 8) != 0);
    if (back && (flags & 1) == 0) discard;
    vec4 base = r.base * v_color;
    if ((r.what.z & 1) != 0) base *= texture(u_texture, v_uv.xy);
    if ((flags & 2) != 0 && base.a < r.glow.a) discard;
    vec3 glow = r.glow.rgb;
    if ((r.what.z & 2) != 0) glow *= texture(u_glow, v_uv.zw).rgb;
    vec3 n = normalize(v_normal);
    if (back) n = -n;
    vec3 light = u_light[3] + (u_light[2] - u_light[3]) * ((n.y + 1.0) / 2.0) + u_light[1] * max(0.0, dot(n, u_light[0]));
    if ((flags & 4) != 0) light = vec3(1.0);
    o_color = vec4(clamp(base.rgb * light + glow, 0.0, 1.0), 1.0);
    o_what = ivec2(r.what.x + 1, 0);
    gl_FragDepth = clamp(u_depth.x * log2(v_distance) + u_depth.y, 0.0, 1.0);
}
