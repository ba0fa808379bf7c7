#version 330 core
layout(location = 0) in vec3 position;  // W [m]
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;  // position distorted by a smooth field [m]

uniform mat4 view_projection;
uniform vec3 camera;  // W [m]
uniform vec3 sun;
uniform vec3 sun_colour;
uniform vec3 sky_colour;
uniform float haze_range;
uniform float detail_period;  // [m]
uniform vec2 map_origin;      // W of the map's first texel's edge [m]
uniform vec2 map_size;        // [m]

out vec2 detail_uv;
out vec2 map_uv;
out vec3 sky_light;
out vec3 sun_light;
out float clear;  // share of the light transmitted by the haze
#ifdef MARKED
out vec3 place;  // W [m]
#endif

void main()
{
    gl_Position = view_projection * vec4(position, 1.0);
    detail_uv = texcoord / detail_period;
    map_uv = (position.xy - map_origin) / map_size;
    sky_light = sky_colour * (0.72 + 0.28 * normal.z);
    sun_light = sun_colour * max(dot(normal, sun), 0.0);
    clear = exp(-length(camera - position) / haze_range);
#ifdef MARKED
    place = position;
#endif
}
