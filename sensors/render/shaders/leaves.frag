#version 330 core
// As thing.frag, but the texture has holes. Separate, as a shader that discards fragments cannot use early depth tests.
in vec2 uv;
in vec4 light;

uniform sampler2D surface;

out vec4 colour;

void main()
{
    vec4 leaf = texture(surface, uv);
    if (leaf.a < 0.4)
        discard;
    colour = vec4(mix(HAZE_COLOUR, leaf.rgb * light.rgb, light.a), 1.0);
}
