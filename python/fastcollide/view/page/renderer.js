// Draws spheres in their box with WebGL2.
import * as shaders from "./shaders.js";

const EDGES = [0, 1, 2, 3, 4, 5, 6, 7, 0, 2, 1, 3, 4, 6, 5, 7, 0, 4, 1, 5, 2, 6, 3, 7]
  .flatMap((i) => [i & 1, (i >> 1) & 1, i >> 2]);
const MODES = { radius: 1, id: 2 };
export const THEMES = {
  light: { background: [0.953, 0.961, 0.973], surface: [0.905, 0.918, 0.938], ink: [0.2, 0.26, 0.36], edge: 0.45 },
  dark: { background: [0.067, 0.082, 0.106], surface: [0.105, 0.125, 0.158], ink: [0.75, 0.82, 0.92], edge: 0.4 },
};

export class Renderer {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: true, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser has no WebGL2, which draws the spheres.");
    this.canvas = canvas;
    this.gl = gl;
    this.count = 0;
    this.theme = "light";
    this.colorBy = "speed";
    this.range = [0, 1];
    this.selected = -1;
    this.lower = [0, 0, 0];
    this.upper = [1, 1, 1];
    this.hasFloor = true;
    this.spheres = program(gl, shaders.sphereVertex, shaders.sphereFragment);
    this.floor = program(gl, shaders.floorVertex, shaders.floorFragment);
    this.lines = program(gl, shaders.lineVertex, shaders.lineFragment);
    const corners = buffer(gl, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
    this.arrays = { position: buffer(gl), radius: buffer(gl), value: buffer(gl) };
    this.sphereLayout = layout(gl, () => {
      attribute(gl, 0, corners, 2, 0);
      attribute(gl, 1, this.arrays.position, 3, 1);
      attribute(gl, 2, this.arrays.radius, 1, 1);
      attribute(gl, 3, this.arrays.value, 1, 1);
    });
    this.floorLayout = layout(gl, () => attribute(gl, 0, corners, 2, 0));
    this.lineLayout = layout(gl, () => attribute(gl, 0, buffer(gl, new Float32Array(EDGES)), 3, 0));
    this.colors = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.colors);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    }
  }

  setColors(table) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.colors);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, table.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(table));
  }

  setBox(lower, upper, hasFloor) {
    this.lower = lower;
    this.upper = upper;
    this.hasFloor = hasFloor;
  }

  setSpheres({ positions, radii, values }) {
    const { gl } = this;
    this.count = positions.length / 3;
    upload(gl, this.arrays.position, positions);
    if (radii) {
      upload(gl, this.arrays.radius, radii);
      if (!values) upload(gl, this.arrays.value, radii); // as long as the others
    }
    if (values) upload(gl, this.arrays.value, values);
  }

  draw(camera) {
    const { gl, canvas } = this;
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * scale));
    const height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const theme = THEMES[this.theme];
    const { view, projection, distance, extent } = camera.matrices(width, height);
    const [x, y, z] = [0, 1, 2].map((row) => [view[row], view[row + 4], view[row + 8]]);
    const turned = (d) => new Float32Array([x, y, z].map((axis) => axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2]));

    gl.viewport(0, 0, width, height);
    gl.clearColor(...theme.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);

    if (this.hasFloor && camera.eye[2] > this.lower[2]) {
      const set = use(gl, this.floor, { view, projection, lower: this.lower, upper: this.upper });
      set("surface", theme.surface);
      set("ink", theme.ink);
      set("spacing", spacingFor(this.upper[0] - this.lower[0], this.upper[1] - this.lower[1]));
      gl.bindVertexArray(this.floorLayout);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }

    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    use(gl, this.lines, { view, projection, lower: this.lower, upper: this.upper })("ink", [...theme.ink, theme.edge]);
    gl.bindVertexArray(this.lineLayout);
    gl.drawArrays(gl.LINES, 0, EDGES.length / 3);
    gl.disable(gl.BLEND);

    if (this.count) {
      const set = use(gl, this.spheres, { view, projection });
      set("range", this.range);
      set("mode", MODES[this.colorBy] ?? 0);
      set("selected", this.selected);
      set("light", normalized(turned([-0.45, -0.6, 0.85])));
      set("up", turned([0, 0, 1]));
      set("background", theme.background);
      set("fog", [distance, distance + extent]);
      gl.bindTexture(gl.TEXTURE_2D, this.colors);
      gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
      gl.bindVertexArray(this.sphereLayout);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
      gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    }
    gl.bindVertexArray(null);
  }
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(made));
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); ++i) {
    const { name, type } = gl.getActiveUniform(made, i);
    uniforms[name] = { type, location: gl.getUniformLocation(made, name) };
  }
  return { made, uniforms };
}

// Takes a program into use; returns what sets one of its uniforms.
function use(gl, { made, uniforms }, values) {
  gl.useProgram(made);
  const set = (name, value) => {
    const { type, location } = uniforms[name];
    if (type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(location, false, value);
    else if (type === gl.FLOAT_VEC2) gl.uniform2fv(location, value);
    else if (type === gl.FLOAT_VEC3) gl.uniform3fv(location, value);
    else if (type === gl.FLOAT_VEC4) gl.uniform4fv(location, value);
    else if (type === gl.FLOAT) gl.uniform1f(location, value);
    else gl.uniform1i(location, value);
  };
  for (const [name, value] of Object.entries(values)) set(name, value);
  return set;
}

function buffer(gl, data = new Float32Array(1)) {
  const made = gl.createBuffer();
  upload(gl, made, data, gl.STATIC_DRAW);
  return made;
}

function upload(gl, target, data, usage = gl.STREAM_DRAW) {
  gl.bindBuffer(gl.ARRAY_BUFFER, target);
  gl.bufferData(gl.ARRAY_BUFFER, data, usage);
}

function layout(gl, describe) {
  const made = gl.createVertexArray();
  gl.bindVertexArray(made);
  describe();
  gl.bindVertexArray(null);
  return made;
}

function attribute(gl, location, from, size, divisor) {
  gl.bindBuffer(gl.ARRAY_BUFFER, from);
  gl.enableVertexAttribArray(location);
  gl.vertexAttribPointer(location, size, gl.FLOAT, false, 0, 0);
  gl.vertexAttribDivisor(location, divisor);
}

function normalized(vector) {
  const length = Math.hypot(...vector);
  return vector.map((component) => component / length);
}

// About twenty lines across: 1, 2 or 5 times a power of ten.
function spacingFor(width, depth) {
  const least = Math.max(width, depth) / 20;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => power * factor >= least * 0.999);
}
