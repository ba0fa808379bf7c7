#version 330 core
layout(location = 0) in vec3 position;  // W [m]
layout(location = 1) in vec3 normal;    // times a scale
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 tint;  // colour and visible share of the sky

layout(std140, row_major) uniform View {
    mat4 view_projection;  // of points in W
    mat4 sky_projection;   // of directions in W
    vec3 camera;           // W [m]
    float stretch;         // length over width of the least elongated footprint of a pixel on the ground
};

out vec2 uv;
out vec4 light;  // last element: share of it transmitted by the haze

void main()
{
    vec3 n = normalize(normal);
    gl_Position = view_projection * vec4(position, 1.0);
    uv = texcoord;
    float lit = max(0.85 * dot(n, SUN_DIRECTION) + 0.15, 0.0) * (0.35 + 0.65 * tint.a);
    light.rgb = tint.rgb * (SKY_COLOUR * (0.62 + 0.38 * n.z) * tint.a + SUN_COLOUR * lit);
    light.a = exp(-length(camera - position) / HAZE_RANGE);
}
