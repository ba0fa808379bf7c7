#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 shade;     // r: visible share of the sky
layout(location = 4) in mat4 instance;  // pose in W times a uniform scale; the last row is the colour

uniform mat4 view_projection;
uniform vec3 camera;  // W [m]

out vec2 uv;
out vec4 light;  // last element: share of it transmitted by the haze

void main()
{
    vec3 world = (instance * vec4(position, 1.0)).xyz;
    vec3 n = normalize(mat3(instance) * normal);
    gl_Position = view_projection * vec4(world, 1.0);
    uv = texcoord;
    float lit = max(0.85 * dot(n, SUN_DIRECTION) + 0.15, 0.0) * (0.35 + 0.65 * shade.r);
    vec3 tint = vec3(instance[0][3], instance[1][3], instance[2][3]);
    light.rgb = tint * (SKY_COLOUR * (0.62 + 0.38 * n.z) * shade.r + SUN_COLOUR * lit);
    light.a = exp(-length(camera - world) / HAZE_RANGE);
}
