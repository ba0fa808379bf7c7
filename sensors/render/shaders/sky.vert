#version 330 core
layout(location = 0) in vec3 position;  // a direction in W
layout(location = 2) in vec2 texcoord;

layout(std140, row_major) uniform View {
    mat4 view_projection;  // of points in W
    mat4 sky_projection;   // of directions in W
    vec3 camera;           // W [m]
    float stretch;         // length over width of the least elongated footprint of a pixel on the ground
};

out vec2 uv;

void main()
{
    gl_Position = (sky_projection * vec4(position, 1.0)).xyww;  // on the far plane
    uv = texcoord;
}
