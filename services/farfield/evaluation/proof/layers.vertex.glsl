#version 430 core
// A corner of a layer's polygon, relative to the impostor's eye: docs/formats/placementdb.md section 4.
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec2 a_uv;
layout(location = 2) in int a_layer;

uniform vec3 u_eye;  // of the impostor, relative to the camera
uniform mat3 u_camera;
uniform vec4 u_window;
uniform float u_near;

out vec3 v_point;
out vec2 v_uv;
flat out int v_layer;

void main() {
    vec3 seen = u_camera * (a_position + u_eye);
    v_point = a_position;
    v_uv = a_uv;
    v_layer = a_layer;
    gl_Position = vec4(seen.xy * u_window.xy + seen.z * u_window.zw, seen.z - 2.0 * u_near, seen.z);
}
