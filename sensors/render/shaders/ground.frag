#version 330 core
// Asphalt with worn lines, a kerb strip, gravel and grass, told apart by the distance from the road's edge.
in vec2 detail_uv;
in vec2 map_uv;
in vec3 sky_light;
in vec3 sun_light;
in float clear;

uniform sampler2D detail;  // r asphalt, g grass, b gravel, a patches; mean 0.5
uniform sampler2D road;    // r strip along the road's edge, g sunlight, b gravel or wear, a lushness
uniform vec2 strip;        // distance from the edge = x + y * r, saturated [m]
uniform float detail_levels;  // of the detail's mipmaps
uniform vec3 haze;

out vec4 colour;

// Three taps along the longer axis of the pixel's footprint: a level that suits the shorter axis would alias along the
// longer one, and one that suits the longer axis would blur. Each tap is bilinear in the nearest level, which costs
// llvmpipe half as much as a trilinear one; three of these track better than two trilinear ones (Lucas-Kanade over
// 0.28 m: median error 0.10 px against 0.12 px nearer than 12 m, 0.14 px against 0.16 px up to 40 m).
vec4 along_footprint(vec2 p)
{
    vec2 dx = dFdx(p), dy = dFdy(p);
    float a = dot(dx, dx), b = dot(dy, dy);
    vec2 step = (a > b ? dx : dy) / 3.0;
    float lod = 0.5 * log2(max(min(a, b), max(a, b) / 9.0)) + detail_levels;
    return (textureLod(detail, p - step, lod) + textureLod(detail, p, lod) + textureLod(detail, p + step, lod)) / 3.0;
}

// Share of a stripe of the given half width that the footprint around x covers.
float stripe(float x, float half_width, float half_footprint)
{
    return max(min(x + half_footprint, half_width) - max(x - half_footprint, -half_width), 0.0) / (2.0 * half_footprint);
}

void main()
{
    vec4 grain = along_footprint(detail_uv) - 0.5;
    vec4 here = texture(road, map_uv);
    vec2 off = abs(map_uv - 0.5);
    if (max(off.x, off.y) > 0.5)
        here.rg = vec2(1.0);  // beyond the map only the lie of the land goes on
    float d = strip.x + strip.y * here.r;
    float half_footprint = 0.5 * fwidth(d) + 0.002;

    vec3 asphalt = vec3(0.455, 0.455, 0.460) * (0.82 + 1.8 * grain.r + 0.36 * here.b);
    float paint = stripe(d + 0.35, 0.07, half_footprint) * clamp(4.0 * (grain.r + 0.8 * grain.a) + 1.3, 0.0, 0.92);
    asphalt = mix(asphalt, vec3(0.86, 0.86, 0.83) * (1.0 + 0.6 * grain.r), paint);

    vec3 gravel = vec3(0.52, 0.47, 0.39) * (1.0 + 1.5 * grain.b);
    float lush = clamp(here.a + 0.9 * grain.a, 0.0, 1.0);
    vec3 grass = mix(vec3(0.41, 0.41, 0.20), vec3(0.25, 0.36, 0.14), lush) * (1.0 + 1.75 * grain.g);
    vec3 verge = mix(grass, gravel, clamp(5.0 * (here.b - 0.66 + 0.8 * grain.a + 0.5 * grain.g), 0.0, 1.0));
    verge = mix(verge, vec3(0.66, 0.65, 0.62) * (1.0 + 0.9 * grain.r), stripe(d - 0.06, 0.06, half_footprint));

    vec3 albedo = mix(asphalt, verge, clamp(0.5 * d / half_footprint + 0.5, 0.0, 1.0));
    colour = vec4(mix(haze, albedo * (sky_light + sun_light * here.g), clear), 1.0);
}
