// The light of the page: metallic and rough surfaces as in glTF, in a studio without any image.

/** The lights of the studio, as seen from the object: unit direction (y is up) and sharpness of each, then its color and 0. A light with the
 * sharpness s shines from a direction d with its color times exp(s (d . direction - 1)): a spherical Gaussian, whose reflections in rough
 * and matte surfaces have closed forms. */
export const LIGHTS = [
  ...[[-0.08, 0.76, 0.65, 24], [9, 8.8, 8.4, 0]],
  ...[[0.88, 0.31, -0.36, 12], [2.6, 2.7, 2.9, 0]],
  ...[[-0.68, 0.41, -0.61, 24], [6, 6.1, 6.4, 0]],
];

export const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec2 surfaceUv;
in vec3 surfaceNormal;
in vec3 surfacePosition;
uniform mat4 view;
uniform sampler2D base_colorMap, alphaMap, normalMap, roughnessMap, metallicMap, occlusionMap, emissionMap;
uniform vec4 lights[${LIGHTS.length}];
uniform vec4 baseColor;
uniform vec4 factors;
uniform vec3 emission;
uniform bool hasNormals;
uniform bool isLit;
uniform int alphaMode; // 0 opaque, 1 mask; of what is blended, 2 the opaque parts, which hide others, 3 the rest
out vec4 pixel;

const vec3 SKY = vec3(0.6, 0.62, 0.66), GROUND = vec3(0.24, 0.23, 0.22);
const float HORIZON = 0.25; // height of the transition from ground to sky, for a mirror
const float OPAQUE = 0.99;
const float MIN_ALPHA = 0.002; // squared roughness of the smoothest surface

// Tangents from derivatives: vertices have none. v points down, the second axis of a normal map up.
vec3 mapNormal(vec3 normal) {
  vec3 px = dFdx(surfacePosition), py = dFdy(surfacePosition);
  vec2 tx = dFdx(surfaceUv), ty = dFdy(surfaceUv);
  vec3 a = cross(py, normal), b = cross(normal, px);
  vec3 tangent = a * tx.x + b * ty.x, bitangent = a * tx.y + b * ty.y;
  float scale = inversesqrt(max(max(dot(tangent, tangent), dot(bitangent, bitangent)), 1e-30));
  vec3 mapped = texture(normalMap, surfaceUv).xyz * 2.0 - 1.0;
  mapped.xy *= factors.z;
  return mapped.x * scale * tangent - mapped.y * scale * bitangent + mapped.z * normal;
}

vec3 blendGround(float height, float width) {
  return mix(GROUND, SKY, smoothstep(-width, width, height));
}

// The light that a white matte surface reflects.
vec3 diffuseLight(vec3 normal) {
  vec3 light = mix(GROUND, SKY, 0.5 + 0.5 * normal.y);
  for (int i = 0; i < ${LIGHTS.length}; i += 2) {
    float sharpness = lights[i].w, cosine = dot(normal, lights[i].xyz);
    light += lights[i + 1].rgb * (2.0 / sharpness) * 0.5 * (cosine + sqrt(cosine * cosine + 0.5 / sharpness));
  }
  return light;
}

// The light from around a direction, as a lobe of GGX sees it. alpha: squared roughness.
vec3 specularLight(vec3 direction, float alpha, float facing) {
  vec3 light = blendGround(direction.y, HORIZON + alpha);
  float lobe = 0.5 / (alpha * alpha * max(facing, 0.1));
  for (int i = 0; i < ${LIGHTS.length}; i += 2) {
    float sharpness = lights[i].w, width = sharpness * lobe / (sharpness + lobe);
    light += lights[i + 1].rgb * (width / sharpness) * exp(width * (dot(direction, lights[i].xyz) - 1.0));
  }
  return light;
}

// Directional albedo of GGX for reflections of 1 and of edges, an approximation by Karis.
vec2 reflectance(float roughness, float facing) {
  vec4 r = roughness * vec4(-1.0, -0.0275, -0.572, 0.022) + vec4(1.0, 0.0425, 1.04, -0.04);
  float a = min(r.x * r.x, exp2(-9.28 * facing)) * r.x + r.y;
  return vec2(-1.04, 1.04) * a + r.zw;
}

// surface: the normal without the normal map.
vec3 shade(vec3 color, vec3 normal, vec3 surface) {
  vec3 toViewer = normalize(-surfacePosition);
  float facing = clamp(abs(dot(normal, toViewer)), 0.001, 1.0), occlusion = texture(occlusionMap, surfaceUv).r;
  float roughness = factors.x * texture(roughnessMap, surfaceUv).r, metallic = factors.y * texture(metallicMap, surfaceUv).r;
  vec3 dx = dFdx(normal), dy = dFdy(normal); // normals that differ within a pixel are as a rougher surface
  float alpha = sqrt(clamp(pow(roughness, 4.0) + min(0.5 * (dot(dx, dx) + dot(dy, dy)), 0.18), MIN_ALPHA * MIN_ALPHA, 1.0));
  roughness = sqrt(alpha);
  vec3 f0 = mix(vec3(0.04), color, metallic);
  vec2 parts = reflectance(roughness, facing);
  vec3 reflected = (f0 * parts.x + parts.y) * (1.0 + f0 * (1.0 / (parts.x + parts.y) - 1.0));
  mat3 toWorld = transpose(mat3(view));
  vec3 matte = (1.0 - metallic) * color * (1.0 - reflected) * diffuseLight(toWorld * normal);
  vec3 direction = reflect(-toViewer, normal);
  float horizon = clamp(1.0 + 1.2 * dot(direction, surface), 0.0, 1.0); // the surface hides what would shine from behind it
  return occlusion * (matte + reflected * horizon * horizon * specularLight(toWorld * direction, alpha, facing));
}

// Khronos PBR Neutral: colors stay as they are up to bright highlights.
vec3 toneMap(vec3 color) {
  const float START = 0.76, DESATURATION = 0.15;
  float low = min(color.r, min(color.g, color.b));
  color -= low < 0.08 ? low - 6.25 * low * low : 0.04;
  float peak = max(color.r, max(color.g, color.b)), room = 1.0 - START;
  if (peak < START) return color;
  float mapped = 1.0 - room * room / (peak + room - START);
  return mix(color * (mapped / peak), vec3(mapped), 1.0 - 1.0 / (DESATURATION * (peak - mapped) + 1.0));
}

void main() {
  vec3 color = texture(base_colorMap, surfaceUv).rgb * baseColor.rgb;
  vec3 normal = normalize(gl_FrontFacing ? surfaceNormal : -surfaceNormal);
  vec3 surface = normal;
  if (hasNormals) normal = normalize(mapNormal(normal));
  float alpha = alphaMode == 0 ? 1.0 : texture(alphaMap, surfaceUv).r * baseColor.a;
  if (alphaMode == 1) alpha = clamp((alpha - factors.w) / max(fwidth(alpha), 1e-4) + 0.5, 0.0, 1.0);
  vec3 light = texture(emissionMap, surfaceUv).rgb * emission;
  if (isLit) color = toneMap(shade(color, normal, surface) + light);
  if (alpha == 0.0 || (alphaMode == 2 && alpha < OPAQUE) || (alphaMode == 3 && alpha >= OPAQUE)) discard;
  color = mix(1.055 * pow(max(color, 0.0), vec3(1.0 / 2.4)) - 0.055, 12.92 * color, lessThanEqual(color, vec3(0.0031308)));
  pixel = vec4(color * alpha, alpha);
}`;
