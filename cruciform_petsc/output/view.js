// SPDX-License-Identifier: MIT
// Turns, colours and plays the cloth of report.html. Its data are those of view.py, in
// #view-data; nothing is loaded. Lengths in mm; z is up; parallel projection, so that a length
// across the line of sight is the same everywhere in the picture.
"use strict";
(() => {
  const root = document.getElementById("view");
  const part = (name) => root.querySelector("." + name);
  const canvas = root.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
  if (!gl) {
    part("status").textContent = "This browser has no WebGL 2, so the view in space is not shown.";
    return;
  }
  const data = JSON.parse(document.getElementById("view-data").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

  // Counts from 0 to 65534 stand for numbers from low to high; 65535 stands for none.
  const decode = (text, low, high) => {
    const steps = low.map((l, k) => (high[k] - l) / 65534);
    return Float32Array.from(new Uint16Array(bytes(text)), (count, i) => {
      const k = i % low.length;
      return count === 65535 ? NaN : low[k] + count * steps[k];
    });
  };
  const cells = (text) => new Uint32Array(bytes(text));

  const count = data.points_per_step;
  const points = decode(data.points, data.low, data.high);
  const triangles = cells(data.triangles);
  const yarns = cells(data.yarns);
  const fields = data.fields.map((f) => ({ ...f, values: decode(f.values, [f.low], [f.high]) }));
  const tools = data.tools.map((t) => ({ ...t, shown: true, size: cells(t.triangles).length }));

  // -- WebGL ---------------------------------------------------------------------------------
  const vertexCode = `#version 300 es
    in vec3 place, normal; in float value;
    uniform mat3 turn; uniform vec3 shift, right, up, towards, focus;
    uniform vec2 scale; uniform float depth, nearer;
    out vec3 lab, across; out float share;
    void main() {
      lab = turn * place + shift; across = normal; share = value;
      vec3 d = lab - focus;
      gl_Position = vec4(dot(d, right) * scale.x, dot(d, up) * scale.y,
                         -(dot(d, towards) + nearer) * depth, 1.0);
    }`;
  // kind: 0 cloth in the colours of a field, 1 yarns, 2 a tool, which is lit facet by facet.
  const fragmentCode = `#version 300 es
    precision highp float;
    in vec3 lab, across; in float share;
    uniform int kind; uniform vec3 right, up, towards, low, high; uniform sampler2D colours;
    out vec4 colour;
    void main() {
      if (kind == 1) { colour = vec4(0.0, 0.0, 0.0, 0.4); return; }
      if (kind == 2 && (any(lessThan(lab, low)) || any(greaterThan(lab, high)))) discard;
      vec3 n = normalize(kind == 2 ? cross(dFdx(lab), dFdy(lab)) : across);
      if (dot(n, towards) < 0.0) n = -n;
      vec3 lamp = normalize(towards + 0.9 * up - 0.8 * right);
      float light = 0.62 + 0.42 * max(dot(n, lamp), 0.0);
      vec3 own = vec3(0.69, 0.71, 0.74);
      if (kind == 0) own = share < -0.5 ? vec3(0.75) : texture(colours, vec2(share, 0.5)).rgb;
      colour = vec4(min(own * light, 1.0), kind == 2 ? 0.32 : 1.0);
    }`;
  const program = gl.createProgram();
  for (const [kind, code] of [[gl.VERTEX_SHADER, vertexCode], [gl.FRAGMENT_SHADER, fragmentCode]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, code);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  ["place", "normal", "value"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    part("status").textContent = "The view in space cannot be drawn by this browser.";
    return;
  }
  gl.useProgram(program);
  const uniform = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(program, i);
    uniform[name] = gl.getUniformLocation(program, name);
  }
  const buffer = (target, array) => {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, array, gl.STATIC_DRAW);
    return made;
  };
  const attribute = (i, made, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.enableVertexAttribArray(i);
    gl.vertexAttribPointer(i, size, gl.FLOAT, false, 0, 0);
  };
  const cloth = { place: gl.createBuffer(), normal: gl.createBuffer(), value: gl.createBuffer() };
  cloth.triangles = buffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
  cloth.yarns = buffer(gl.ELEMENT_ARRAY_BUFFER, yarns);
  for (const tool of tools) {
    tool.place = buffer(gl.ARRAY_BUFFER, decode(tool.points, tool.low, tool.high));
    tool.cells = buffer(gl.ELEMENT_ARRAY_BUFFER, cells(tool.triangles));
  }
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
    gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  }
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.clearColor(1, 1, 1, 1);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);

  // -- what is shown -------------------------------------------------------------------------
  const middle = data.low.map((l, k) => 0.5 * (l + data.high[k]));
  const radius = 0.5 * Math.hypot(...data.low.map((l, k) => data.high[k] - l));
  const room = 0.2 * radius; // around the cloth, in which tools are shown
  const start = () => ({ azimuth: data.azimuth, elevation: data.elevation, zoom: 1, focus: [...middle] });
  let camera = start();
  let step = data.captions.length - 1;
  let field = fields[0];
  let waiting = false;

  const normals = (place) => {
    const normal = new Float32Array(place.length);
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => 3 * triangles[t + k]);
      const u = [0, 1, 2].map((k) => place[b + k] - place[a + k]);
      const v = [0, 1, 2].map((k) => place[c + k] - place[a + k]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      for (const at of [a, b, c]) for (let k = 0; k < 3; k++) normal[at + k] += n[k];
    }
    return normal;
  };
  const load = () => {
    const place = points.subarray(3 * count * step, 3 * count * (step + 1));
    const [low, high] = field.limits;
    const share = field.values.subarray(count * step, count * (step + 1)).map((v) =>
      Number.isNaN(v) ? -10 : Math.min(Math.max((v - low) / (high - low), 0), 1));
    for (const [made, array] of [[cloth.place, place], [cloth.normal, normals(place)], [cloth.value, share]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, made);
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.DYNAMIC_DRAW);
    }
    part("step").value = step;
    part("caption").textContent = data.captions[step];
    ask();
  };
  const colour = () => {
    const table = new Uint8Array(bytes(field.colours));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, table.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, table);
    const stops = Array.from({ length: 17 }, (_, i) => {
      const at = 3 * Math.round((i / 16) * (table.length / 3 - 1));
      return `rgb(${table.slice(at, at + 3).join(",")})`;
    });
    part("bar").style.background = `linear-gradient(to right, ${stops.join(",")})`;
    const [low, high] = field.limits;
    part("what").textContent = field.label;
    part("least").textContent = (field.beyond[0] ? "≤ " : "") + text(low);
    part("most").textContent = (field.beyond[1] ? "≥ " : "") + text(high);
  };
  const text = (value) => String(Number(value.toPrecision(3))).replace("-", "\u2212");

  const axes = () => {
    const [a, e] = [camera.azimuth, camera.elevation];
    const [ca, sa, ce, se] = [Math.cos(a), Math.sin(a), Math.cos(e), Math.sin(e)];
    return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], towards: [ce * ca, ce * sa, se] };
  };
  const perMm = () => (camera.zoom * Math.min(canvas.clientWidth, 1.35 * canvas.clientHeight)) / (2 * radius);
  const draw = () => {
    waiting = false;
    const ratio = window.devicePixelRatio || 1;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
      canvas.width = Math.round(wide * ratio);
      canvas.height = Math.round(high * ratio);
    }
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    for (const [name, value] of Object.entries({ ...axes(), focus: camera.focus })) {
      gl.uniform3fv(uniform[name], value);
    }
    gl.uniform3fv(uniform.low, data.low.map((l) => l - room));
    gl.uniform3fv(uniform.high, data.high.map((h) => h + room));
    gl.uniform2f(uniform.scale, (2 * perMm()) / wide, (2 * perMm()) / high);
    gl.uniform1f(uniform.depth, 1 / (4 * radius + 4 * room));
    gl.uniformMatrix3fv(uniform.turn, false, [1, 0, 0, 0, 1, 0, 0, 0, 1]);
    gl.uniform3f(uniform.shift, 0, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    attribute(0, cloth.place, 3);
    attribute(1, cloth.normal, 3);
    attribute(2, cloth.value, 1);
    // Cloth that a tool has been pressed into by less than the net is coarse stays visible.
    gl.uniform1f(uniform.nearer, data.nearer);
    gl.uniform1i(uniform.kind, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, cloth.triangles);
    gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
    gl.enable(gl.BLEND);
    if (part("yarns").checked) {
      gl.uniform1f(uniform.nearer, 1.2 * data.nearer);
      gl.uniform1i(uniform.kind, 1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, cloth.yarns);
      gl.drawElements(gl.LINES, yarns.length, gl.UNSIGNED_INT, 0);
    }
    gl.disableVertexAttribArray(1);
    gl.disableVertexAttribArray(2);
    gl.depthMask(false);
    gl.uniform1f(uniform.nearer, 0);
    gl.uniform1i(uniform.kind, 2);
    for (const tool of tools) {
      const pose = tool.poses[step];
      if (!tool.shown || !pose) continue;
      gl.uniformMatrix3fv(uniform.turn, false, pose.slice(0, 9));
      gl.uniform3fv(uniform.shift, pose.slice(9));
      attribute(0, tool.place, 3);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, tool.cells);
      gl.drawElements(gl.TRIANGLES, tool.size, gl.UNSIGNED_INT, 0);
    }
    gl.depthMask(true);
    const longest = 0.2 * (wide / perMm());
    const power = 10 ** Math.floor(Math.log10(longest));
    const length = power * Math.max(...[1, 2, 5].filter((f) => f * power <= longest));
    part("ruler").style.width = `${length * perMm()}px`;
    part("ruler").textContent = `${text(length)} mm`;
  };
  const ask = () => {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  };

  // -- what the reader does ------------------------------------------------------------------
  const turn = (x, y) => {
    camera.azimuth -= x;
    camera.elevation = Math.min(Math.max(camera.elevation + y, -Math.PI / 2), Math.PI / 2);
    ask();
  };
  const move = (x, y) => {
    const { right, up } = axes();
    camera.focus = camera.focus.map((f, k) => f - (x * right[k] - y * up[k]) / perMm());
    ask();
  };
  const zoom = (factor) => {
    camera.zoom = Math.min(Math.max(camera.zoom * factor, 0.3), 40);
    ask();
  };
  const held = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  const release = (event) => held.delete(event.pointerId);
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return tell(event);
    const now = [event.clientX, event.clientY];
    const [x, y] = [now[0] - before[0], now[1] - before[1]];
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      zoom(apart(now) / apart(before));
      move(0.5 * x, 0.5 * y);
    } else if (event.shiftKey || event.buttons & 2) move(x, y);
    else turn(0.01 * x, 0.01 * y);
    held.set(event.pointerId, now);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
      ArrowUp: () => turn(0, -0.1), ArrowDown: () => turn(0, 0.1),
      "+": () => zoom(1.15), "-": () => zoom(1 / 1.15),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  // The value at the crossover below the pointer that is nearest to the reader.
  const tell = (event) => {
    const { right, up, towards } = axes();
    const x = event.offsetX - 0.5 * canvas.clientWidth;
    const y = 0.5 * canvas.clientHeight - event.offsetY;
    let [best, front] = [-1, -Infinity];
    for (let i = 0; i < count; i++) {
      const d = [0, 1, 2].map((k) => points[3 * (count * step + i) + k] - camera.focus[k]);
      const along = (v) => d[0] * v[0] + d[1] * v[1] + d[2] * v[2];
      if (Math.hypot(along(right) * perMm() - x, along(up) * perMm() - y) < 9 && along(towards) > front) {
        [best, front] = [i, along(towards)];
      }
    }
    const value = best < 0 ? NaN : field.values[count * step + best];
    part("status").textContent = Number.isNaN(value) ? data.hint : `${field.label}: ${text(value)}`;
  };

  fields.forEach((f, i) => part("field").add(new Option(f.label, i)));
  part("field").addEventListener("change", (event) => {
    field = fields[event.target.value];
    colour();
    load();
  });
  part("step").max = data.captions.length - 1;
  part("step").addEventListener("input", (event) => {
    step = Number(event.target.value);
    load();
  });
  let playing = 0;
  part("play").addEventListener("click", () => {
    clearInterval(playing);
    playing = playing ? 0 : setInterval(() => {
      step = (step + 1) % data.captions.length;
      load();
    }, 600);
    part("play").textContent = playing ? "Stop" : "Play";
  });
  part("back").addEventListener("click", () => {
    camera = start();
    ask();
  });
  part("yarns").addEventListener("change", ask);
  for (const tool of tools) {
    const label = document.createElement("label");
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
    box.addEventListener("change", () => {
      tool.shown = box.checked;
      ask();
    });
    label.append(box, ` ${tool.name}`);
    part("tools").append(label);
  }
  part("status").textContent = data.hint;
  part("shown").hidden = false;
  new ResizeObserver(ask).observe(canvas);
  colour();
  load();
})();
