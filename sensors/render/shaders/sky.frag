#version 330 core
in vec2 uv;

uniform sampler2D panorama;

out vec4 colour;

void main()
{
    colour = vec4(textureLod(panorama, uv, 0.0).rgb, 1.0);
}
