#version 330 core
layout(location = 0) in vec3 position;  // a triangle over the whole view

uniform mat4 unprojection;  // from clip coordinates on the far plane to directions in W

out vec3 direction;

void main()
{
    gl_Position = vec4(position.xy, 1.0, 1.0);
    direction = (unprojection * vec4(position.xy, 1.0, 1.0)).xyz;
}
