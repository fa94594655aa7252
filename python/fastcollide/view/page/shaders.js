// GLSL of the spheres, the floor and the edges of the box.

// A sphere is drawn as a square that faces the eye and just covers what the eye sees of it; each fragment finds where
// its ray meets the sphere, so outline, normal and depth are those of the sphere itself.
export const sphereVertex = `#version 300 es
layout(location = 0) in vec2 corner;
layout(location = 1) in vec3 position;
layout(location = 2) in float radius;
layout(location = 3) in float value;
uniform mat4 view, projection;
uniform vec2 range;
uniform int mode;  // what the colour shows: 0 value, 1 radius, 2 number
uniform int selected;
flat out vec4 sphere;  // in view space; w: radius
flat out float shade;
flat out float isSelected;
out vec3 place;  // on the square, in view space

void main() {
  vec3 center = (view * vec4(position, 1.0)).xyz;
  float distance2 = dot(center, center), radius2 = radius * radius;
  sphere = vec4(center, radius);
  float shown = mode == 0 ? value : mode == 1 ? radius : float(gl_InstanceID);
  shade = clamp((shown - range.x) / (range.y - range.x), 0.0, 1.0);
  isSelected = gl_InstanceID == selected ? 1.0 : 0.0;
  if (distance2 <= radius2 * 1.0001) {  // the eye is inside
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
  vec3 toward = center * inversesqrt(distance2);
  vec3 right = normalize(cross(toward, abs(toward.y) < 0.9 ? vec3(0, 1, 0) : vec3(1, 0, 0)));
  vec3 up = cross(right, toward);
  // Where the cone around the sphere cuts the plane through its centre, and a little more for the soft edge.
  float reach = radius * sqrt(distance2 / (distance2 - radius2)) * 1.02;
  place = center + (corner.x * right + corner.y * up) * reach;
  gl_Position = projection * vec4(place, 1.0);
}`;

export const sphereFragment = `#version 300 es
precision highp float;
uniform mat4 projection;
uniform sampler2D colors;
uniform vec3 light, up, background;  // directions in view space
uniform vec2 fog;  // distances where it begins and where only it is left
flat in vec4 sphere;
flat in float shade;
flat in float isSelected;
in vec3 place;
out vec4 color;

void main() {
  vec3 ray = normalize(place);
  float along = dot(ray, sphere.xyz);
  vec3 miss = sphere.xyz - along * ray;  // from the ray's nearest point to the centre: well rounded even far away
  float gap = length(miss), radius = sphere.w;
  float cover = clamp((radius - gap) / max(fwidth(gap), 1e-9) + 0.5, 0.0, 1.0);
  if (cover <= 0.0) discard;
  float depth = along - sqrt(max(radius * radius - gap * gap, 0.0));
  vec3 point = depth * ray;
  vec3 normal = normalize(point - sphere.xyz);
  vec4 clip = projection * vec4(point, 1.0);
  gl_FragDepth = clamp(0.5 * clip.z / clip.w + 0.5, 0.0, 1.0);

  vec3 base = pow(texture(colors, vec2((shade * 255.0 + 0.5) / 256.0, 0.5)).rgb, vec3(2.2));
  float sun = max(dot(normal, light), 0.0);
  float sky = 0.5 + 0.5 * dot(normal, up);
  float facing = max(-dot(normal, ray), 0.0);
  vec3 lit = base * (0.95 * sun + mix(0.20, 0.68, sky)) * mix(0.70, 1.0, facing);
  lit += vec3(0.16) * pow(max(dot(reflect(ray, normal), light), 0.0), 28.0);
  float rim = isSelected * smoothstep(0.62, 0.50, facing);
  lit = mix(lit, vec3(1.0), rim);
  float haze = 0.55 * smoothstep(fog.x, fog.y, along) * (1.0 - isSelected);
  color = vec4(mix(pow(lit, vec3(1.0 / 2.2)), background, haze), cover);
}`;

export const floorVertex = `#version 300 es
layout(location = 0) in vec2 corner;
uniform mat4 view, projection;
uniform vec3 lower, upper;
out vec2 place;

void main() {
  place = mix(lower.xy, upper.xy, corner * 0.5 + 0.5);
  gl_Position = projection * (view * vec4(place, lower.z, 1.0));
}`;

export const floorFragment = `#version 300 es
precision highp float;
uniform vec3 surface, ink;
uniform float spacing;  // of its lines [m]
in vec2 place;
out vec4 color;

void main() {
  vec2 cell = place / spacing, width = fwidth(cell);
  vec2 line = abs(fract(cell - 0.5) - 0.5) / max(width, 1e-6);
  float strength = (1.0 - clamp(min(line.x, line.y), 0.0, 1.0)) * clamp(1.0 - 2.0 * max(width.x, width.y), 0.0, 1.0);
  color = vec4(mix(surface, ink, 0.10 * strength), 1.0);
}`;

export const lineVertex = `#version 300 es
layout(location = 0) in vec3 corner;  // 0 or 1 along each axis
uniform mat4 view, projection;
uniform vec3 lower, upper;

void main() {
  gl_Position = projection * (view * vec4(mix(lower, upper, corner), 1.0));
}`;

export const lineFragment = `#version 300 es
precision highp float;
uniform vec4 ink;
out vec4 color;

void main() {
  color = ink;
}`;
