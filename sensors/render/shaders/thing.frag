#version 330 core
in vec2 uv;
in vec3 light;
in float clear;

uniform sampler2D surface;
uniform vec3 haze;

out vec4 colour;

void main()
{
    colour = vec4(mix(haze, texture(surface, uv).rgb * light, clear), 1.0);
}
