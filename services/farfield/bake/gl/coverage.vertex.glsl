#version 430 core
// One quad a block of texels, pulled from the table of blocks; see farfield.bake.gl.blocks for its columns.
layout(std430, binding = 0) readonly buffer Whole { int whole[]; };

uniform vec2 sheet;  // its size in texels

flat out int block;

const ivec2 CORNER[6] = ivec2[6](ivec2(0, 0), ivec2(1, 0), ivec2(1, 1), ivec2(0, 0), ivec2(1, 1), ivec2(0, 1));

void main() {
    block = gl_VertexID / 6;
    int at = block * 27;
    ivec2 texel = ivec2(whole[at], whole[at + 1]) + CORNER[gl_VertexID % 6] * ivec2(whole[at + 2], whole[at + 3]);
    gl_Position = vec4(2.0 * vec2(texel) / sheet - 1.0, 0.0, 1.0);
}
