// Draws a textured mesh with WebGL 2: without light, as the texture is, or with all maps of its materials in the light of a studio.

import { FRAGMENT_SHADER, LIGHTS } from "./shading.js";

const MIPMAP_SECONDS = 0.25, MIPMAP_FACTOR = 4; // between two updates of mipmaps while tiles come; also relative to the time for an image
const MAX_TEXELS = 2 ** 26; // of a texture on the graphics processor; larger ones are halved
const MAX_ANISOTROPY = 4;
const GRAY = [0.216, 0.216, 0.216, 1], FLAT = [0.5, 0.5, 1, 1], BLACK = [0, 0, 0, 1], WHITE = [1, 1, 1, 1];
const INITIAL = { base_color: GRAY, normal: FLAT, metallic: BLACK, emission: BLACK }; // what tiles show before they come; others are white
const COLOR_ROLES = ["base_color", "emission"]; // stored in sRGB
const ROLES = ["base_color", "alpha", "normal", "roughness", "metallic", "occlusion", "emission"]; // by texture unit

const MODES = ["opaque", "mask", "blend"], TRANSLUCENT = 3; // numbers of `alphaMode` in the shader

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
    this.white = this.#createTexture({ role: "normal", width: 1, height: 1, tile_size: 1 }, WHITE);
    this.mesh = null;
  }

  /** Prepare to draw the package of `manifest`; nothing of it is received yet. */
  start(manifest) {
    for (const { texture } of this.textures) {
      this.gl.deleteTexture(texture);
      this.outdated.delete(texture);
    }
    Object.assign(this, { materials: manifest.materials, mesh: null, updated: -Infinity, pause: 0, fence: null });
    this.textures = manifest.textures.map((description) => this.#createTexture(description, INITIAL[description.role] ?? WHITE));
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
    const { gl } = this, { texture, format, channels, shift, width, height } = this.textures[index];
    if (side === bitmap.width && !shift) {
      const size = [Math.min(side, width - left), Math.min(side, height - top)]; // without the padding
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, left, top, ...size, channels, gl.UNSIGNED_BYTE, bitmap);
    } else {
      const coarse = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, coarse);
      gl.texImage2D(gl.TEXTURE_2D, 0, format, channels, gl.UNSIGNED_BYTE, bitmap);
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
    ROLES.forEach((role, unit) => gl.uniform1i(uniforms[`${role}Map`], unit));
    gl.uniform4fv(uniforms["lights[0]"], LIGHTS.flat());
    gl.bindVertexArray(this.mesh.array);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const parts = this.mesh.counts.map((count, index, counts) => {
      return { count, first: counts.slice(0, index).reduce((sum, value) => sum + value, 0), material: this.materials[index] };
    });
    for (const part of parts) this.#drawPart(part, MODES.indexOf(part.material.shading.alpha_mode), part.material.is_double_sided ? [0] : [gl.BACK]);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (const part of parts) {
      if (part.material.shading.alpha_mode !== "blend") continue;
      this.#drawPart(part, TRANSLUCENT, part.material.is_double_sided ? [gl.FRONT, gl.BACK] : [gl.BACK]);
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    if (!this.fence) [this.fence, this.drawn] = [gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), performance.now() / 1000];
    return !this.outdated.size;
  }

  /** Draw triangles of a material. mode: see `alphaMode` of the shader. passes: the faces to leave out in each, 0 for none. */
  #drawPart({ count, first, material }, mode, passes) {
    const { gl, uniforms } = this, { shading } = material;
    ROLES.forEach((role, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, (this.textures[material.textures[role]] ?? this.white).texture);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(uniforms.hasNormals, +("normal" in material.textures));
    gl.uniform1i(uniforms.isLit, +(this.isLit && !shading.is_unlit));
    gl.uniform1i(uniforms.alphaMode, mode);
    gl.uniform4fv(uniforms.baseColor, material.base_color);
    gl.uniform4f(uniforms.factors, shading.roughness, shading.metallic, shading.normal_scale, shading.alpha_cutoff);
    gl.uniform3fv(uniforms.emission, this.isLit ? shading.emission : [0, 0, 0]);
    if (shading.alpha_mode === "mask") gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    for (const hidden of passes) {
      if (hidden) gl.enable(gl.CULL_FACE);
      else gl.disable(gl.CULL_FACE);
      if (hidden) gl.cullFace(hidden);
      gl.drawElements(gl.TRIANGLES, 3 * count, gl.UNSIGNED_INT, 12 * first);
    }
    gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
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
    const isColor = COLOR_ROLES.includes(description.role), isVector = isColor || description.role === "normal";
    const format = isColor ? gl.SRGB8_ALPHA8 : isVector ? gl.RGBA8 : gl.R8, channels = isVector ? gl.RGBA : gl.RED;
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
    return { texture, format, channels, width, height, shift };
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
