#version 330 core
in vec2 uv;
in vec4 light;

uniform sampler2D surface;

out vec4 colour;

void main()
{
    colour = vec4(mix(HAZE_COLOUR, texture(surface, uv).rgb * light.rgb, light.a), 1.0);
}
