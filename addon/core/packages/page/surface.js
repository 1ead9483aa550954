// Vertex buffers of a level, with normals for light and shade.

const MIN_SMOOTH_COSINE = Math.cos((40 * Math.PI) / 180); // between a face and the normal of a vertex; a sharper corner is shaded flat

/** Buffers for the graphics processor: positions, uvs and normals of its vertices (wedges, and one vertex per corner that is shaded flat),
 * and triangles. positions: (3 V) of the vertices; wedges: (W) their vertices; uvs: (2 W); corners: (3 T) wedges. */
export function buildSurface({ positions, wedges, uvs, corners }) {
  const faces = new Float32Array(corners.length), normals = new Float32Array(positions.length);
  for (let i = 0; i < corners.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map((corner) => 3 * wedges[corners[i + corner]]);
    const [ux, uy, uz] = [0, 1, 2].map((axis) => positions[b + axis] - positions[a + axis]);
    const [vx, vy, vz] = [0, 1, 2].map((axis) => positions[c + axis] - positions[a + axis]);
    const normal = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (let axis = 0; axis < 3; axis++) {
      for (const vertex of [a, b, c]) normals[vertex + axis] += normal[axis]; // weighted by area
      faces[i + axis] = normal[axis];
    }
  }
  normalize(faces);
  normalize(normals);
  const flat = [];
  for (let i = 0; i < corners.length; i++) {
    const face = i - (i % 3), vertex = 3 * wedges[corners[i]];
    let cosine = 0;
    for (let axis = 0; axis < 3; axis++) cosine += faces[face + axis] * normals[vertex + axis];
    if (cosine < MIN_SMOOTH_COSINE) flat.push(i);
  }
  const count = wedges.length + flat.length;
  const surface = { positions: new Float32Array(3 * count), uvs: new Float32Array(2 * count), normals: new Float32Array(3 * count) };
  const put = (target, wedge, source, start) => {
    for (let axis = 0; axis < 3; axis++) {
      surface.positions[3 * target + axis] = positions[3 * wedges[wedge] + axis];
      surface.normals[3 * target + axis] = source[start + axis];
    }
    surface.uvs[2 * target] = uvs[2 * wedge];
    surface.uvs[2 * target + 1] = uvs[2 * wedge + 1];
  };
  for (let wedge = 0; wedge < wedges.length; wedge++) put(wedge, wedge, normals, 3 * wedges[wedge]);
  const triangles = Uint32Array.from(corners);
  flat.forEach((corner, index) => {
    triangles[corner] = wedges.length + index;
    put(triangles[corner], corners[corner], faces, corner - (corner % 3));
  });
  return { ...surface, triangles };
}

function normalize(vectors) {
  for (let i = 0; i < vectors.length; i += 3) {
    const length = Math.hypot(vectors[i], vectors[i + 1], vectors[i + 2]) || 1;
    for (let axis = 0; axis < 3; axis++) vectors[i + axis] /= length;
  }
}
