#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 shade;     // r: share of the sky that is seen
layout(location = 4) in mat4 instance;  // pose in W times a uniform scale; the last element is the brightness

uniform mat4 view_projection;
uniform vec3 camera;  // W [m]
uniform vec3 sun;
uniform vec3 sun_colour;
uniform vec3 sky_colour;
uniform vec3 tint;
uniform float haze_range;

out vec2 uv;
out vec3 light;
out float clear;  // share of the light that the haze lets through

void main()
{
    vec3 world = (instance * vec4(position, 1.0)).xyz;
    vec3 n = normalize(mat3(instance) * normal);
    gl_Position = view_projection * vec4(world, 1.0);
    uv = texcoord;
    float lit = max(0.85 * dot(n, sun) + 0.15, 0.0) * (0.35 + 0.65 * shade.r);
    light = tint * instance[3][3] * (sky_colour * (0.62 + 0.38 * n.z) * shade.r + sun_colour * lit);
    clear = exp(-length(camera - world) / haze_range);
}
