#version 430 core
// Geometry relative to the camera: one row of `rows` a drawn primitive, see farfield.evaluation.proof.level.
struct Row { vec4 x, y, z; vec4 base, glow; ivec4 what; };
layout(std430, binding = 0) readonly buffer Rows { Row rows[]; };

layout(location = 0) in vec3 a_position;
layout(location = 1) in vec4 a_normal;
layout(location = 2) in vec4 a_uv;
layout(location = 3) in vec4 a_color;
layout(location = 4) in int a_row;

uniform mat3 u_camera;  // rows: right, up, forward
uniform vec4 u_window;  // clip = (x, y) u_window.xy + z u_window.zw
uniform float u_near;

out vec3 v_normal;
out vec4 v_uv;
out vec4 v_color;
out float v_distance;
flat out int v_row;

void main() {
    Row r = rows[a_row];
    vec4 p = vec4(a_position, 1.0);
    vec3 seen = u_camera * vec3(dot(r.x, p), dot(r.y, p), dot(r.z, p));
    vec3 a = vec3(r.x.x, r.y.x, r.z.x), b = vec3(r.x.y, r.y.y, r.z.y), c = vec3(r.x.z, r.y.z, r.z.z);
    float turn = r.what.y >> 3 != 0 ? -1.0 : 1.0;
    v_normal = turn * mat3(cross(b, c), cross(c, a), cross(a, b)) * a_normal.xyz;
    v_uv = a_uv;
    v_color = a_color;
    v_distance = seen.z;
    v_row = a_row;
    gl_Position = vec4(seen.xy * u_window.xy + seen.z * u_window.zw, seen.z - 2.0 * u_near, seen.z);
}
