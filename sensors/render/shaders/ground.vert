#version 330 core
layout(location = 0) in vec3 position;  // W [m]
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;  // position distorted by a smooth field [m]

layout(std140, row_major) uniform View {
    mat4 view_projection;  // of points in W
    mat4 sky_projection;   // of directions in W
    vec3 camera;           // W [m]
    float stretch;         // length over width of the least elongated footprint of a pixel on the ground
};

const float detail_period = DETAIL_PERIOD;  // [m]
const vec2 map_origin = MAP_ORIGIN;  // W of the map's first texel's edge [m]
const vec2 map_size = MAP_EXTENT;  // [m]

out vec2 detail_uv;
out vec2 map_uv;
out float skylight;
out float sunlight;
out float fog;
flat out float texels;  // twice the squared texels of the detail per squared period, for its level
#ifdef MARKED
out vec3 place;  // W [m]
flat out vec3 eye;
#endif
#ifdef TRAFFIC
const int VEHICLES = 3;  // MAX_VEHICLES of sensors.world.traffic
uniform mat4 into_box[VEHICLES];  // from W into the box around each; its sides are at +-1
flat out mat4 box[VEHICLES];
#endif

void main()
{
    gl_Position = view_projection * vec4(position, 1.0);
    detail_uv = texcoord / detail_period;
    map_uv = (position.xy - map_origin) / map_size;
    float clear = exp(-length(camera - position) / HAZE_RANGE);
    skylight = (0.72 + 0.28 * normal.z) * clear;
    sunlight = max(dot(normal, SUN_DIRECTION), 0.0) * clear;
    fog = 1.0 - clear;
    texels = DETAIL_TEXELS / (stretch * stretch);
#ifdef MARKED
    place = position;
    eye = camera;
#endif
#ifdef TRAFFIC
    box = into_box;
#endif
}
