// Draws a textured mesh with WebGL 2: without light, as the texture is, or with a light at the viewer.

const MIPMAP_SECONDS = 0.25, MIPMAP_FACTOR = 4; // between two updates of mipmaps while tiles come; also relative to the time for an image
const MAX_TEXELS = 2 ** 26; // of a texture on the graphics processor; larger ones are halved
const MAX_ANISOTROPY = 4;
const GRAY = [0.216, 0.216, 0.216, 1], FLAT = [0.5, 0.5, 1, 1]; // what tiles show before they come: middle gray of sRGB, no relief
const COLOR_ROLES = ["base_color", "emission"]; // stored in sRGB
const UNITS = { base_color: 0, normal: 1 }; // texture units of the roles that are drawn

const VERTEX_SHADER = `#version 300 es
in vec3 position;
in vec2 uv;
in vec3 normal;
uniform mat4 clip;
uniform mat4 view;
out vec2 surfaceUv;
out vec3 surfaceNormal;
out vec3 surfacePosition;
void main() {
  surfaceUv = uv;
  surfaceNormal = mat3(view) * normal;
  surfacePosition = (view * vec4(position, 1.0)).xyz;
  gl_Position = clip * vec4(position, 1.0);
}`;

const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec2 surfaceUv;
in vec3 surfaceNormal;
in vec3 surfacePosition;
uniform sampler2D colorTexture;
uniform sampler2D normalTexture;
uniform vec3 baseColor;
uniform bool hasNormals;
uniform bool isLit;
out vec4 pixel;

const float AMBIENT = 0.25; // fraction of the color that shows without light

// Tangents from derivatives: vertices have none. v points down, the second axis of a normal map up.
vec3 mapNormal(vec3 normal) {
  vec3 px = dFdx(surfacePosition), py = dFdy(surfacePosition);
  vec2 tx = dFdx(surfaceUv), ty = dFdy(surfaceUv);
  vec3 a = cross(py, normal), b = cross(normal, px);
  vec3 tangent = a * tx.x + b * ty.x, bitangent = a * tx.y + b * ty.y;
  float scale = inversesqrt(max(max(dot(tangent, tangent), dot(bitangent, bitangent)), 1e-30));
  vec3 mapped = texture(normalTexture, surfaceUv).xyz * 2.0 - 1.0;
  return mapped.x * scale * tangent - mapped.y * scale * bitangent + mapped.z * normal;
}

void main() {
  vec3 color = texture(colorTexture, surfaceUv).rgb * baseColor;
  if (isLit) {
    vec3 normal = normalize(gl_FrontFacing ? surfaceNormal : -surfaceNormal);
    if (hasNormals) normal = normalize(mapNormal(normal));
    color *= AMBIENT + (1.0 - AMBIENT) * max(dot(normal, normalize(-surfacePosition)), 0.0);
  }
  pixel = vec4(mix(1.055 * pow(color, vec3(1.0 / 2.4)) - 0.055, 12.92 * color, lessThanEqual(color, vec3(0.0031308))), 1.0);
}`;

export class Renderer {
  /** Throws if the browser has no WebGL 2. lost: called when the browser has taken the graphics context and returned it; then all is to be set
   * again, from `start` on. */
  constructor(canvas, lost) {
    this.canvas = canvas;
    this.isLit = false;
    const options = { antialias: true, powerPreference: "high-performance" };
    this.gl = canvas.getContext("webgl2", options);
    if (!this.gl) throw new Error("This browser has no WebGL 2, or it is turned off. Use another browser, or turn on hardware acceleration.");
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.textures = [];
      this.#prepare();
      lost();
    });
    this.textures = [];
    this.#prepare();
  }

  #prepare() {
    const { gl } = this;
    this.anisotropy = gl.getExtension("EXT_texture_filter_anisotropic");
    this.program = buildProgram(gl);
    this.uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(this.program, i);
      this.uniforms[name] = gl.getUniformLocation(this.program, name);
    }
    this.outdated = new Set(); // textures whose mipmaps are older than they are
    this.white = this.#createTexture({ role: "base_color", width: 1, height: 1, tile_size: 1 }, [1, 1, 1, 1]);
    this.mesh = null;
  }

  /** Prepare to draw the package of `manifest`; nothing of it is received yet. */
  start(manifest) {
    for (const { texture } of this.textures) {
      this.gl.deleteTexture(texture);
      this.outdated.delete(texture);
    }
    Object.assign(this, { materials: manifest.materials, mesh: null, updated: -Infinity, pause: 0, fence: null });
    this.textures = manifest.textures.map((description) => this.#createTexture(description, description.role === "normal" ? FLAT : GRAY));
  }

  /** Whether textures are smaller than in the package, because of the limits of the graphics processor. */
  get isReduced() {
    return this.textures.some(({ shift }) => shift);
  }

  /** Draw this surface from now on, see `buildSurface`. counts: triangles of each material. */
  setSurface({ positions, uvs, normals, triangles }, counts) {
    const { gl } = this;
    if (this.mesh) {
      this.mesh.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
      gl.deleteVertexArray(this.mesh.array);
    }
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [["position", positions, 3], ["uv", uvs, 2], ["normal", normals, 3]].map(([name, values, size]) => {
      const buffer = gl.createBuffer(), location = gl.getAttribLocation(this.program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, gl.FLOAT, false, 0, 0);
      return buffer;
    });
    buffers.push(gl.createBuffer());
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[3]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    this.mesh = { array, buffers, counts };
  }

  /** Show `bitmap` as the part of a texture at a place, see `locateTile`, from now on. */
  setTile(index, { left, top, side }, bitmap) {
    const { gl } = this, { texture, format, shift, width, height } = this.textures[index];
    if (side === bitmap.width && !shift) {
      const size = [Math.min(side, width - left), Math.min(side, height - top)]; // without the padding
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, left, top, ...size, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    } else {
      const coarse = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, coarse);
      gl.texImage2D(gl.TEXTURE_2D, 0, format, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
      const frames = [[gl.READ_FRAMEBUFFER, coarse], [gl.DRAW_FRAMEBUFFER, texture]].map(([target, attached]) => {
        const frame = gl.createFramebuffer();
        gl.bindFramebuffer(target, frame);
        gl.framebufferTexture2D(target, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, attached, 0);
        return frame;
      });
      const [x, y, right, bottom] = [left, top, left + side, top + side].map((position) => position >> shift);
      gl.blitFramebuffer(0, 0, bitmap.width, bitmap.height, x, y, right, bottom, gl.COLOR_BUFFER_BIT, gl.LINEAR);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      frames.forEach((frame) => gl.deleteFramebuffer(frame));
      gl.deleteTexture(coarse);
    }
    this.outdated.add(texture);
  }

  /** Whether the graphics processor has not finished the last image: more images or tiles would only wait for it. */
  get isBusy() {
    const { gl } = this, now = performance.now() / 1000;
    if (!this.fence || gl.isContextLost()) return false;
    if (gl.getSyncParameter(this.fence, gl.SYNC_STATUS) !== gl.SIGNALED) return true;
    gl.deleteSync(this.fence);
    this.fence = null;
    this.pause = Math.max(MIPMAP_SECONDS, MIPMAP_FACTOR * (now - this.drawn));
    return false;
  }

  /** Draw an image seen by `camera`, an Orbit. Returns false if mipmaps are older than the textures: then draw again soon. isFinal: update
   * them in any case. */
  draw(camera, isFinal = false) {
    const { gl, canvas, uniforms } = this;
    this.#updateMipmaps(isFinal);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!this.mesh) return true;
    const { rows, clip } = camera.matrices(canvas.width / canvas.height);
    const view = [0, 1, 2, 3].flatMap((column) => [...rows.map((row) => row[column]), +(column === 3)]);
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(uniforms.clip, false, clip);
    gl.uniformMatrix4fv(uniforms.view, false, view);
    gl.uniform1i(uniforms.isLit, +this.isLit);
    gl.uniform1i(uniforms.colorTexture, UNITS.base_color);
    gl.uniform1i(uniforms.normalTexture, UNITS.normal);
    gl.bindVertexArray(this.mesh.array);
    let first = 0;
    this.mesh.counts.forEach((count, index) => {
      const material = this.materials[index];
      for (const [role, unit] of Object.entries(UNITS)) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, (this.textures[material.textures[role]] ?? this.white).texture);
      }
      gl.activeTexture(gl.TEXTURE0);
      gl.uniform1i(uniforms.hasNormals, +("normal" in material.textures));
      gl.uniform3fv(uniforms.baseColor, material.base_color.slice(0, 3));
      if (material.is_double_sided) gl.disable(gl.CULL_FACE);
      else gl.enable(gl.CULL_FACE);
      gl.drawElements(gl.TRIANGLES, 3 * count, gl.UNSIGNED_INT, 12 * first);
      first += count;
    });
    if (!this.fence) [this.fence, this.drawn] = [gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), performance.now() / 1000];
    return !this.outdated.size;
  }

  #updateMipmaps(isFinal) {
    const { gl } = this, now = performance.now() / 1000;
    if (!this.outdated.size || (!isFinal && now < this.updated + this.pause)) return;
    for (const texture of this.outdated) {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.generateMipmap(gl.TEXTURE_2D);
    }
    this.outdated.clear();
    this.updated = now;
  }

  #createTexture(description, color) {
    const { gl } = this, limit = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    let { width, height } = description, shift = 0;
    while (Math.max(width, height) > limit || width * height > MAX_TEXELS) {
      [width, height] = [Math.max(width >> 1, 1), Math.max(height >> 1, 1)];
      shift++;
    }
    const format = COLOR_ROLES.includes(description.role) ? gl.SRGB8_ALPHA8 : gl.RGBA8;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, Math.floor(Math.log2(Math.max(width, height))) + 1, format, width, height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    if (this.anisotropy) gl.texParameterf(gl.TEXTURE_2D, this.anisotropy.TEXTURE_MAX_ANISOTROPY_EXT, MAX_ANISOTROPY);
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    gl.clearColor(...color);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
    this.outdated.add(texture);
    return { texture, format, width, height, shift };
  }
}

function buildProgram(gl) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`The shaders do not compile: ${gl.getProgramInfoLog(program)}`);
  return program;
}
