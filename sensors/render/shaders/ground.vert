#version 330 core
layout(location = 0) in vec3 position;  // W [m]
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;  // position bent by a smooth field [m]
layout(location = 3) in vec4 shade;     // r: variation of the soil

uniform mat4 view_projection;
uniform vec3 camera;  // W [m]
uniform vec3 sun;
uniform vec2 map_origin;  // W of the map's first texel's edge [m]
uniform vec2 map_size;    // [m]

out vec2 metres;
out vec2 map_uv;
out vec2 light;  // sky light, sun light
out float soil;
out vec3 to_camera;

void main()
{
    gl_Position = view_projection * vec4(position, 1.0);
    metres = texcoord;
    map_uv = (position.xy - map_origin) / map_size;
    light = vec2(0.72 + 0.28 * normal.z, max(dot(normal, sun), 0.0));
    soil = shade.r;
    to_camera = camera - position;
}
