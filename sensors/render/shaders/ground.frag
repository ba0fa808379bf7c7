#version 330 core
#extension GL_ARB_shader_bit_encoding : require
// Asphalt with worn lines, a kerb strip, gravel and grass, selected by the distance from the road's edge.
in vec2 detail_uv;
in vec2 map_uv;
in float skylight;  // share of the light that the ground receives and the haze transmits
in float sunlight;
in float fog;       // share of the haze's own colour
flat in float texels;

// Constants stand in the code, others come from ground.vert: llvmpipe takes 30 instructions to load one from a uniform.
uniform sampler2D detail;  // r asphalt, g grass, b gravel, a patches; mean 0.5; all levels side by side
uniform sampler2D road;    // r strip along the road's edge, g sunlight, b gravel or wear, a lushness; likewise
const vec4 detail_sheet = DETAIL_SHEET;  // size of the largest level and margin around each, as shares of the texture
const vec4 road_sheet = ROAD_SHEET;
const float road_texels = ROAD_TEXELS;  // twice the squared texels of the road per squared period of the detail
const vec2 strip = EDGE_STRIP;  // distance from the edge = x + y * r, saturated [m]
const vec3 haze = HAZE_COLOUR;
const vec3 sky_colour = SKY_COLOUR;
const vec3 sun_colour = SUN_COLOUR;
const vec3 sun = SUN_DIRECTION;

out vec4 colour;

// Origin and size of the mipmap level whose texels are nearest to a footprint, given twice its square in texels.
// llvmpipe computes a level three times as fast from the exponent of a float as in a texture with mipmaps.
vec4 level(vec4 sheet, float footprint, int last)
{
    int n = clamp((floatBitsToInt(footprint) - 0x3F800000) >> 24, 0, last);
    float size = intBitsToFloat(0x3F800000 - (n << 23));  // 2^-n
    return vec4(2.0 * sheet.x * (1.0 - size) + float(2 * n + 1) * sheet.z, sheet.w, size * sheet.xy);
}

// Share of a footprint around x that a stripe of the given half width covers; per_metre is 1 over the footprint.
float stripe(float x, float half_width, float footprint, float per_metre)
{
    float right = min(x + 0.5 * footprint, half_width), left = max(x - 0.5 * footprint, -half_width);
    return max(right - left, 0.0) * per_metre;
}

#ifdef MARKED
in vec3 place;  // W [m]
flat in vec3 eye;
#endif

#ifdef TRAFFIC
const int VEHICLES = 3;  // MAX_VEHICLES of sensors.world.traffic
flat in mat4 box[VEHICLES];  // into_box

// Unshadowed share of the light of the sun (x) and of the sky (y) beside vehicles.
vec2 past_vehicles()
{
    vec2 left = vec2(1.0);
    for (int k = 0; k < VEHICLES; ++k) {
        vec3 q = (box[k] * vec4(place, 1.0)).xyz;
        vec3 ray = mat3(box[k]) * sun;
        vec3 one = (-1.0 - q) / ray, other = (1.0 - q) / ray;
        vec3 into = min(one, other), out_of = max(one, other);
        float hidden = min(min(out_of.x, out_of.y), out_of.z) - max(max(into.x, into.y), max(into.z, 0.0));  // [m]
        left.x *= 1.0 - smoothstep(0.0, 0.6, hidden);
        vec2 per_metre = vec2(length(vec3(box[k][0].x, box[k][1].x, box[k][2].x)),
                              length(vec3(box[k][0].y, box[k][1].y, box[k][2].y)));
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
    vec3 below = sky_colour * (skylight * (0.75 - 0.25 * wall)) + sun_colour * (sunlight * lit * facing * sunny);
    albedo = mix(albedo * (1.0 + rim * (0.15 - 2.2 * abs(grain.a))), rubble, inside);
    light = mix(light, below, inside);
}
#endif

#ifdef LOOKS
uniform sampler2D looks;  // r wet, g muddy, b icy; on the road map

const vec3 ZENITH = vec3(0.36, 0.52, 0.78);

// Colour of wet, muddy or icy ground, and the reflection of a film of water or of ice.
vec3 weathered(vec3 albedo, vec3 light, vec4 grain, vec4 here, float d)
{
    vec3 look = texture(looks, map_uv).rgb;  // zero at the edges of the map
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
    vec3 view = normalize(eye - place);
    vec3 ray = reflect(-view, normal);
    float grazing = clamp(1.0 - dot(view, normal), 0.0, 1.0);
    float mirrored = 0.02 + 0.98 * grazing * grazing * grazing * grazing * grazing;  // Schlick's formula, water
    float glint = max(dot(ray, sun), 0.0);
    glint *= glint, glint *= glint, glint *= glint, glint *= glint, glint *= glint;
    vec3 sky = mix(haze, ZENITH, clamp(2.0 * ray.z, 0.0, 1.0)) + (0.4 + 2.0 * polish) * glint * sun_colour;
    return mix(albedo * light, (1.0 - fog) * sky * (0.55 + 0.45 * here.g), film * mirrored);
}
#endif

#ifdef LINES
uniform sampler2D lines;   // r from the nearest line between lanes, g into the line from its end; of the road map
const float line_range = LINE_RANGE;  // greatest distance of both [m]

// Share of the footprint that such a line covers.
float lane_line()
{
    vec2 at = line_range * (2.0 * texture(lines, map_uv).rg - 1.0);  // none at the edges of the map
    float within = clamp(at.y / (fwidth(at.y) + 0.02) + 0.5, 0.0, 1.0);
    float footprint = fwidth(at.x) + 0.004;
    return within * stripe(at.x, 0.06, footprint, 1.0 / footprint);
}
#endif

void main()
{
    // Two samples along the longer axis of the pixel's footprint. The level for the shorter axis would alias along the
    // longer one, and the level for the longer axis would blur; the stretch lowers the latter as far as the footprints in
    // view are long enough. Each sample is bilinear in the nearest level. Lucas-Kanade over 0.28 m: median error 0.17 px
    // nearer than 12 m, 0.42 px to 40 m; one sample has 0.28 px and 0.51 px.
    vec2 dx = dFdx(detail_uv), dy = dFdy(detail_uv);
    vec2 squares = vec2(dot(dx, dx), dot(dy, dy));
    vec2 quarter = 0.25 * (squares.x > squares.y ? dx : dy);
    float longer = max(squares.x, squares.y);
    vec4 at = level(detail_sheet, longer * texels, DETAIL_LAST);
    vec4 grain = texture(detail, at.xy + fract(detail_uv - quarter) * at.zw)
        + texture(detail, at.xy + fract(detail_uv + quarter) * at.zw);
    grain = 0.5 * grain - 0.5;
    at = level(road_sheet, longer * road_texels, ROAD_LAST);
    vec4 here = texture(road, at.xy + fract(map_uv) * at.zw);
    vec2 off = abs(map_uv - 0.5);
    here.rg = max(here.rg, vec2(float(max(off.x, off.y) > 0.5)));  // beyond the map: 1, no shadows
    float d = strip.x + strip.y * here.r;
    float across = fwidth(d) + 0.004, per_metre = 1.0 / across;

    float paint = stripe(d + 0.35, 0.07, across, per_metre);
#ifdef LINES
    paint = max(paint, lane_line());
#endif
    paint *= clamp(4.0 * (grain.r + 0.8 * grain.a) + 1.3, 0.0, 0.92);
    float kerb = stripe(d - 0.06, 0.06, across, per_metre);
    float off_road = clamp(d * per_metre + 0.5, 0.0, 1.0), on_road = 1.0 - off_road, verge = off_road - off_road * kerb;
    float gravel = verge * clamp(5.0 * (here.b - 0.66 + 0.8 * grain.a + 0.5 * grain.g), 0.0, 1.0);
    float grass = (verge - gravel) * (1.0 + 1.75 * grain.g);
    float lush = grass * clamp(here.a + 0.9 * grain.a, 0.0, 1.0);
    vec3 albedo = vec3((on_road - on_road * paint) * (0.374 + 0.82 * grain.r + 0.164 * here.b)
        + on_road * paint * (0.86 + 0.516 * grain.r) + off_road * kerb * (0.65 + 0.585 * grain.r))
        + vec3(0.52, 0.47, 0.39) * (gravel * (1.0 + 1.5 * grain.b))
        + vec3(0.41, 0.41, 0.20) * (grass - lush)
        + vec3(0.25, 0.36, 0.14) * lush;
#ifdef TRAFFIC
    vec2 left = past_vehicles();
    here.g *= left.x;
    float open = skylight * left.y;
#else
    float open = skylight;
#endif
    vec3 light = sky_colour * open + sun_colour * (sunlight * here.g);
#ifdef HOLES
    dig(albedo, light, grain, here.g);
#endif
#ifdef LOOKS
    vec3 shaded = weathered(albedo, light, grain, here, d);
#else
    vec3 shaded = albedo * light;
#endif
    colour = vec4(shaded + haze * fog, 1.0);
}
