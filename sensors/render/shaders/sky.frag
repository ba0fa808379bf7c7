#version 330 core
in vec3 direction;

uniform sampler2D panorama;
uniform vec2 elevation;  // of the panorama's lower edge, and the span of it [rad]

out vec4 colour;

const float TURN = 6.283185307;

void main()
{
    vec2 uv = vec2(atan(direction.y, direction.x) / TURN, (atan(direction.z, length(direction.xy)) - elevation.x) / elevation.y);
    colour = vec4(textureLod(panorama, uv, 0.0).rgb, 1.0);
}
