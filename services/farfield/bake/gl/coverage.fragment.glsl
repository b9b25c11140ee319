#version 430 core
// Does the piece touch this texel, and how deep is its source there: farfield.bake.coverage, operation by operation.
layout(std430, binding = 0) readonly buffer Whole { int whole[]; };
layout(std430, binding = 1) readonly buffer Real { float real[]; };

flat in int block;

layout(location = 0) out uint piece;

void main() {
    int at = block * 27;
    int i = int(gl_FragCoord.x) - whole[at];
    int j = int(gl_FragCoord.y) - whole[at + 1];
    for (int e = 0; e < 3; e++) {
        int k = at + 5 + 4 * e;
        int l = whole[k] * j - whole[k + 1] * i;
        if (l < whole[k + 2] || l > whole[k + 3]) discard;
    }
    int cx = 256 * i + 128, cy = 256 * j + 128;
    int rf = block * 8;
    float v[3] = float[3](real[rf], real[rf + 1], real[rf + 2]);
    ivec2 q[3];
    for (int c = 0; c < 3; c++) q[c] = ivec2(whole[at + 20 + 2 * c], whole[at + 21 + 2 * c]);
    bool inside = true;
    for (int e = 0; e < 3; e++) {
        ivec2 d = q[(e + 1) % 3] - q[e];
        inside = inside && d.x * j - d.y * i >= whole[at + 17 + e];
    }
    precise float best;
    if (inside) {
        best = (real[rf + 6] * float(cx - q[0].x) + real[rf + 7] * float(cy - q[0].y)) + v[0];
        best = max(min(best, max(v[0], max(v[1], v[2]))), min(v[0], min(v[1], v[2])));
    } else {
        best = 0.0;
        precise float nearest = 3.0e38;
        for (int e = 0; e < 3; e++) {
            int f = (e + 1) % 3;
            precise float ex = float(q[f].x - q[e].x), ey = float(q[f].y - q[e].y);
            precise float px = float(cx - q[e].x), py = float(cy - q[e].y);
            precise float t = min(max((px * ex + py * ey) * real[rf + 3 + e], 0.0), 1.0);
            precise float rx = px - t * ex, ry = py - t * ey;
            precise float d = rx * rx + ry * ry;
            if (d < nearest) {
                nearest = d;
                best = v[e] + t * (v[f] - v[e]);
            }
        }
    }
    uint key = uint(min(max(best, 0.0), 1.0) * 1048576.0);
    if (!inside) key += whole[at + 26] != 0 ? 4194304u : 2097152u;
    gl_FragDepth = float(key) / 8388608.0;  // 2**23: every step is a different depth, also in 24 bits
    piece = uint(whole[at + 4]);
}
