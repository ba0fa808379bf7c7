#version 330 core
// Asphalt with worn lines, a kerb strip, gravel and grass, told apart by the distance from the road's edge.
in vec2 metres;
in vec2 map_uv;
in vec2 light;
in float soil;
in vec3 to_camera;

uniform sampler2D detail;  // r asphalt, g grass, b gravel, a patches; mean 0.5
uniform sampler2D road;    // r distance from the road's edge, g sunlight
uniform vec2 road_range;   // distance = x + y * r [m]
uniform float detail_period;
uniform float road_half_width;
uniform vec3 haze;
uniform float haze_range;
uniform vec3 sun_colour;
uniform vec3 sky_colour;

out vec4 colour;

// Second layer of the detail: turned by 38 degrees and drawn out by the golden ratio squared, so that the two
// periods have no common multiple.
const mat2 TURN = mat2(0.788, 0.616, -0.616, 0.788);
const float STRETCH = 0.381966;

// Two trilinear taps along the longer axis of the pixel's footprint.
vec4 along_footprint(vec2 p, vec2 major, float lod)
{
    return 0.5 * (textureLod(detail, p + 0.25 * major, lod) + textureLod(detail, p - 0.25 * major, lod));
}

// Share of a stripe of the given half width that the footprint around x covers.
float stripe(float x, float half_width, float footprint)
{
    float w = 0.5 * footprint;
    return max(min(x + w, half_width) - max(x - w, -half_width), 0.0) / footprint;
}

void main()
{
    vec2 p = metres / detail_period;
    vec2 dx = dFdx(p), dy = dFdy(p);
    float a = dot(dx, dx), b = dot(dy, dy);
    vec2 major = a > b ? dx : dy;
    float texels = float(textureSize(detail, 0).x);
    float lod = 0.5 * log2(max(max(min(a, b), 0.25 * max(a, b)), 1e-12) * texels * texels);
    vec4 fine = along_footprint(p, major, lod) - 0.5;
    vec4 broad = along_footprint(TURN * p * STRETCH, TURN * major * STRETCH, lod - 1.389) - 0.5;
    vec4 grain = fine + broad + 2.0 * fine * broad;

    vec2 here = texture(road, map_uv).rg;
    float d = road_range.x + road_range.y * here.r;
    float footprint = max(fwidth(d), 0.002);

    float across = d + road_half_width;
    float rolled = exp(-pow((abs(across) - 1.0) / 0.35, 2.0));  // where wheels polish
    vec3 asphalt = vec3(0.395, 0.395, 0.400) * (1.0 + 1.7 * grain.r + 0.35 * broad.a + 0.10 * (soil - 0.5) - 0.05 * rolled);
    float paint = stripe(d + 0.35, 0.07, footprint) * smoothstep(-0.16, 0.10, grain.r + 0.7 * grain.a + 0.05);
    asphalt = mix(asphalt, vec3(0.86, 0.86, 0.83) * (1.0 + 0.6 * grain.r), 0.92 * paint);

    vec3 gravel = mix(vec3(0.50, 0.43, 0.34), vec3(0.56, 0.52, 0.45), soil) * (1.0 + 1.7 * grain.b);
    float lush = clamp(0.5 + 1.5 * (soil - 0.5) + 1.6 * broad.a, 0.0, 1.0);
    vec3 grass = mix(vec3(0.47, 0.45, 0.22), vec3(0.25, 0.38, 0.13), lush) * (1.0 + 1.9 * grain.g);
    float bare = smoothstep(0.30, 0.02, d - 0.9 + 2.6 * grain.a + 1.0 * grain.g);  // beside the road
    bare = max(bare, smoothstep(0.26, 0.36, grain.a + 0.25 * grain.g + 0.25 * (0.5 - soil)));
    vec3 verge = mix(grass, gravel, bare);
    vec3 concrete = vec3(0.62, 0.61, 0.58) * (1.0 + 0.9 * grain.r);
    verge = mix(verge, concrete, stripe(d - 0.06, 0.06, footprint));

    vec3 albedo = mix(asphalt, verge, clamp(d / footprint + 0.5, 0.0, 1.0));
    vec3 lit = albedo * (sky_colour * light.x + sun_colour * light.y * here.g);
    float range = length(to_camera);
    colour = vec4(mix(haze, lit, exp(-range / haze_range)), 1.0);
}
