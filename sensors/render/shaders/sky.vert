#version 330 core
layout(location = 0) in vec3 position;  // a direction in W
layout(location = 2) in vec2 texcoord;

uniform mat4 view_projection;  // of a camera at the origin: the sky is infinitely far away

out vec2 uv;

void main()
{
    gl_Position = (view_projection * vec4(position, 1.0)).xyww;  // on the far plane
    uv = texcoord;
}
