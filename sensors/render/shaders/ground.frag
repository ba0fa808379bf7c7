#version 330 core
// Asphalt with worn lines, a kerb strip, gravel and grass, selected by the distance from the road's edge.
in vec2 detail_uv;
in vec2 map_uv;
in vec3 sky_light;
in vec3 sun_light;
in float clear;

uniform sampler2D detail;  // r asphalt, g grass, b gravel, a patches; mean 0.5
uniform sampler2D road;    // r strip along the road's edge, g sunlight, b gravel or wear, a lushness
uniform vec2 strip;        // distance from the edge = x + y * r, saturated [m]
uniform vec3 haze;

out vec4 colour;

// Three samples along the longer axis of the pixel's footprint. The mipmap level for the shorter axis would alias along
// the longer one, and the level for the longer axis would blur; the texture's bias lowers the latter as far as the
// footprints in view are long enough. Each sample is bilinear in the nearest level, which costs llvmpipe half as much as
// a trilinear one. Three of these track better than two trilinear ones (Lucas-Kanade over 0.28 m: median error 0.10 px
// against 0.12 px nearer than 12 m, 0.14 px against 0.16 px up to 40 m). An explicit level costs 25 % more.
vec4 along_footprint(vec2 p)
{
    vec2 dx = dFdx(p), dy = dFdy(p);
    vec2 step = (dot(dx, dx) > dot(dy, dy) ? dx : dy) / 3.0;
    return (texture(detail, p - step) + texture(detail, p) + texture(detail, p + step)) / 3.0;
}

// Share of a stripe of the given half width that the footprint around x covers.
float stripe(float x, float half_width, float half_footprint)
{
    return max(min(x + half_footprint, half_width) - max(x - half_footprint, -half_width), 0.0) / (2.0 * half_footprint);
}

#ifdef MARKED
in vec3 place;  // W [m]
uniform vec3 sun;
#endif

#ifdef TRAFFIC
const int VEHICLES = 3;  // MAX_VEHICLES of sensors.world.traffic
uniform mat4 into_box[VEHICLES];  // from W into the box around each; its sides are at +-1

// Unshadowed share of the light of the sun (x) and of the sky (y) beside vehicles.
vec2 past_vehicles()
{
    vec2 left = vec2(1.0);
    for (int k = 0; k < VEHICLES; ++k) {
        vec3 q = (into_box[k] * vec4(place, 1.0)).xyz;
        vec3 ray = mat3(into_box[k]) * sun;
        vec3 one = (-1.0 - q) / ray, other = (1.0 - q) / ray;
        vec3 into = min(one, other), out_of = max(one, other);
        float hidden = min(min(out_of.x, out_of.y), out_of.z) - max(max(into.x, into.y), max(into.z, 0.0));  // [m]
        left.x *= 1.0 - smoothstep(0.0, 0.6, hidden);
        vec2 per_metre = vec2(length(vec3(into_box[k][0].x, into_box[k][1].x, into_box[k][2].x)),
                              length(vec3(into_box[k][0].y, into_box[k][1].y, into_box[k][2].y)));
        vec2 outside = max(abs(q.xy) - 1.0, 0.0) / per_metre;  // [m]
        left.y *= 1.0 - 0.7 * exp(-2.5 * dot(outside, outside));
    }
    return left;
}
#endif

#ifdef HOLES
uniform sampler2D holes;  // the nearest pothole: x, y of its middle in W, radius, depth [m]; on the road map

// Replaces albedo and light in a pothole and on its broken edge.
void dig(inout vec3 albedo, inout vec3 light, vec4 grain, float lit)
{
    vec4 hole = textureLod(holes, map_uv, 0.0);
    float turn = 6.2832 * fract(7.31 * hole.x + 3.77 * hole.y);  // outlines differ
    vec2 q = (place.xy - hole.xy) / hole.z;
    vec2 outwards = q / max(length(q), 0.1);
    q *= 1.0 + 0.3 * dot(outwards, vec2(cos(turn), sin(turn)));
    float ragged = 1.1 * grain.a + 0.5 * grain.r;
    float r = length(q) + ragged;
    float footprint = abs(dot(outwards, dFdx(place.xy))) + abs(dot(outwards, dFdy(place.xy)));
    float blur = max(footprint / hole.z, 0.05);

    float inside = clamp((1.0 - r) / blur + 0.5, 0.0, 1.0);
    float rim = clamp((1.3 - r) / 0.3, 0.0, 1.0) * (1.0 - inside);
    float wall = smoothstep(0.55, 0.95, r);
    vec2 slope = q * (3.5 * wall * hole.w / hole.z + 1.2 * grain.b);
    float facing = max(dot(normalize(vec3(-slope, 1.0)), sun), 0.0) / sun.z;
    float towards_sun = length(q + sun.xy / sun.z * hole.w * 1.3 / hole.z) + ragged;
    float sunny = clamp((1.0 - towards_sun) / max(blur, 0.12) + 0.5, 0.0, 1.0);
    vec3 rubble = vec3(0.40, 0.36, 0.30) * (0.8 + 2.4 * grain.b + 0.8 * grain.r);
    vec3 below = sky_light * (0.75 - 0.25 * wall) + sun_light * lit * facing * sunny;
    albedo = mix(albedo * (1.0 + rim * (0.15 - 2.2 * abs(grain.a))), rubble, inside);
    light = mix(light, below, inside);
}
#endif

#ifdef LOOKS
uniform sampler2D looks;  // r wet, g muddy, b icy; on the road map
uniform vec3 camera;      // W [m]
uniform vec3 sun_colour;

const vec3 ZENITH = vec3(0.36, 0.52, 0.78);

// Colour of wet, muddy or icy ground, and the reflection of a film of water or of ice.
vec3 weathered(vec3 albedo, vec3 light, vec4 grain, vec4 here, float d)
{
    vec3 look = texture(looks, clamp(map_uv, 0.0, 1.0)).rgb;  // zero at the edges of the map
    float off_road = clamp(2.0 * d, 0.0, 1.0);
    vec3 share = clamp(2.5 * (look - 0.5) + (look - look * look) * 6.0 * grain.a + 0.5, 0.0, 1.0);  // ragged edges
    share.gb *= 1.0 - 0.45 * off_road;

    float puddle = share.r * smoothstep(0.02, 0.12, grain.a + 0.35 * (here.b - 0.55)) * (1.0 - off_road);
    albedo *= 1.0 - share.r * mix(0.45, 0.25, off_road) - 0.15 * puddle;
    float clods = clamp(share.g * (1.15 + 1.2 * grain.a), 0.0, 1.0);
    vec3 mud = vec3(0.27, 0.20, 0.13) * (0.95 + 1.3 * grain.b + 0.9 * grain.a + 0.25 * (here.b - 0.5));
    albedo = mix(albedo, mud, clods);
    float frost = share.b * clamp(0.62 + 1.9 * grain.a + 0.6 * grain.g, 0.25, 0.95);
    vec3 ice = vec3(0.70, 0.77, 0.84) * (1.0 + 0.5 * grain.r + 0.35 * grain.a);
    albedo = mix(albedo * (1.0 - 0.25 * share.b), ice, frost);

    float film = (1.0 - off_road) * max(max(share.r * (0.35 + 0.65 * puddle), 0.75 * share.b), 0.30 * clods);
    float polish = max(puddle, 0.8 * share.b);
    vec3 normal = vec3((1.0 - polish) * 0.35 * grain.rb, 1.0);
    vec3 view = normalize(camera - place);
    vec3 ray = reflect(-view, normal);
    float grazing = clamp(1.0 - dot(view, normal), 0.0, 1.0);
    float mirrored = 0.02 + 0.98 * grazing * grazing * grazing * grazing * grazing;  // Schlick's formula, water
    float glint = max(dot(ray, sun), 0.0);
    glint *= glint, glint *= glint, glint *= glint, glint *= glint, glint *= glint;
    vec3 sky = mix(haze, ZENITH, clamp(2.0 * ray.z, 0.0, 1.0)) + (0.4 + 2.0 * polish) * glint * sun_colour;
    return mix(albedo * light, sky * (0.55 + 0.45 * here.g), film * mirrored);
}
#endif

#ifdef LINES
uniform sampler2D lines;   // r from the nearest line between lanes, g into the line from its end; of the road map
uniform float line_range;  // greatest distance of both [m]

// Share of the footprint that such a line covers.
float lane_line()
{
    vec2 at = line_range * (2.0 * texture(lines, clamp(map_uv, 0.0, 1.0)).rg - 1.0);  // none at the edges of the map
    float within = clamp(at.y / (fwidth(at.y) + 0.02) + 0.5, 0.0, 1.0);
    return within * stripe(at.x, 0.06, 0.5 * fwidth(at.x) + 0.002);
}
#endif

void main()
{
    vec4 grain = along_footprint(detail_uv) - 0.5;
    vec4 here = texture(road, map_uv);
    vec2 off = abs(map_uv - 0.5);
    if (max(off.x, off.y) > 0.5)
        here.rg = vec2(1.0);  // beyond the map: no shadows
    float d = strip.x + strip.y * here.r;
    float half_footprint = 0.5 * fwidth(d) + 0.002;

    vec3 asphalt = vec3(0.455, 0.455, 0.460) * (0.82 + 1.8 * grain.r + 0.36 * here.b);
    float paint = stripe(d + 0.35, 0.07, half_footprint) * clamp(4.0 * (grain.r + 0.8 * grain.a) + 1.3, 0.0, 0.92);
#ifdef LINES
    paint = max(paint, lane_line() * clamp(4.0 * (grain.r + 0.8 * grain.a) + 1.3, 0.0, 0.92));
#endif
    asphalt = mix(asphalt, vec3(0.86, 0.86, 0.83) * (1.0 + 0.6 * grain.r), paint);

    vec3 gravel = vec3(0.52, 0.47, 0.39) * (1.0 + 1.5 * grain.b);
    float lush = clamp(here.a + 0.9 * grain.a, 0.0, 1.0);
    vec3 grass = mix(vec3(0.41, 0.41, 0.20), vec3(0.25, 0.36, 0.14), lush) * (1.0 + 1.75 * grain.g);
    vec3 verge = mix(grass, gravel, clamp(5.0 * (here.b - 0.66 + 0.8 * grain.a + 0.5 * grain.g), 0.0, 1.0));
    verge = mix(verge, vec3(0.66, 0.65, 0.62) * (1.0 + 0.9 * grain.r), stripe(d - 0.06, 0.06, half_footprint));

    vec3 albedo = mix(asphalt, verge, clamp(0.5 * d / half_footprint + 0.5, 0.0, 1.0));
#ifdef TRAFFIC
    vec2 left = past_vehicles();
    here.g *= left.x;
    vec3 light = sky_light * left.y + sun_light * here.g;
#else
    vec3 light = sky_light + sun_light * here.g;
#endif
#ifdef HOLES
    dig(albedo, light, grain, here.g);
#endif
#ifdef LOOKS
    vec3 shaded = weathered(albedo, light, grain, here, d);
#else
    vec3 shaded = albedo * light;
#endif
    colour = vec4(mix(haze, shaded, clear), 1.0);
}
