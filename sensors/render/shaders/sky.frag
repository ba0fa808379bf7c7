#version 330 core
in vec2 uv;

uniform sampler2D panorama;

out vec4 colour;

void main()
{
    colour = vec4(texture(panorama, uv).rgb, 1.0);
}
