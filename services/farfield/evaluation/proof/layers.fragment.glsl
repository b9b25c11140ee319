#version 430 core
// A texel of a layer as docs/formats/placementdb.md says: colour, share, and the distance of the surface it stands for.
struct Layer { vec4 range; ivec4 rect; };  // plane, 1/near, 1/far, -
layout(std430, binding = 1) readonly buffer Layers { Layer layers[]; };

in vec3 v_point;
in vec2 v_uv;
flat in int v_layer;

uniform sampler2D u_page;
uniform ivec3 u_levels[4];  // x, y of each level in the page's image; -
uniform int u_whole;  // 1: every set texel of level 0 in full, to see what is covered
uniform vec3 u_eye;
uniform vec3 u_forward;
uniform vec2 u_depth;

layout(location = 0) out vec4 o_color;
layout(location = 1) out ivec2 o_what;

vec3 linear(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045)));
}

void main() {
    Layer l = layers[v_layer];
    vec2 dx = dFdx(v_uv), dy = dFdy(v_uv);
    int level = clamp(int(floor(0.5 * log2(max(max(dot(dx, dx), dot(dy, dy)), 1e-12)) + 0.5)), 0, 3);
    if (u_whole != 0) level = 0;
    ivec2 texel = clamp(ivec2(floor(v_uv)), l.rect.xy, l.rect.xy + l.rect.zw - 1);
    vec4 found = texelFetch(u_page, u_levels[level].xy + (texel >> level), 0);
    int a = int(found.a * 255.0 + 0.5);
    if (a == 0) discard;
    int quarters = ((a - 1) & 3) + 1, part = (int(gl_FragCoord.x) & 1) + 2 * (int(gl_FragCoord.y) & 1);
    if (u_whole == 0 && part >= quarters) discard;
    float inverse = l.range.z + float((a - 1) >> 2) / 62.0 * (l.range.y - l.range.z);
    float scale = l.range.x * inverse;
    float ahead = dot(v_point + scale * u_eye, u_forward);
    gl_FragDepth = ahead <= 0.0 ? 0.0 : scale <= 0.0 ? 1.0 : clamp(u_depth.x * log2(ahead / scale) + u_depth.y, 0.0, 1.0);
    o_color = vec4(linear(found.rgb), 1.0);
    o_what = ivec2(-1 - v_layer, texel.x | texel.y << 16);
}
