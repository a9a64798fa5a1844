"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const POINTS = 600, LIT = 0.15; // points of a curve; share of the window for which a status bit stays lit

async function compile() {
  const bytes = Uint8Array.from(atob(data.wasm), (c) => c.charCodeAt(0));
  const module = await WebAssembly.compile(bytes);
  const functions = { fmin: Math.min, fmax: Math.max };
  const needed = WebAssembly.Module.imports(module).map(({ name }) => [name, functions[name] || Math[name]]);
  return (await WebAssembly.instantiate(module, { env: Object.fromEntries(needed) })).exports;
}

function views(c) { // the numbers that the observer and the page exchange, by name
  const all = {};
  let at = c.cells();
  for (const [name, size] of Object.entries(data.cells)) {
    all[name] = new Float64Array(c.memory.buffer, at, size);
    at += 8 * size;
  }
  return all;
}

function normal() {
  return Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());
}

const shortest = (difference, period) => period ? difference - period * Math.round(difference / period) : difference;
const text = (value) => String(Number(Number(value).toPrecision(4)));

function ticks(low, high, log) { // values with labels; on a log axis low and high are exponents
  const powers = (factors) => { // of ten, times each of the factors
    const values = [];
    for (let k = Math.floor(low); k <= high; ++k) { factors.forEach((each) => values.push(each * Math.pow(10, k))); }
    return values.filter((v) => Math.log10(v) >= low - 1e-9 && Math.log10(v) <= high + 1e-9);
  };
  if (log) {
    const decades = powers([1]), values = decades.length > 1 ? decades : powers([1, 2, 5]), skip = Math.ceil(values.length / 4);
    if (values.length < 2) { return ticks(Math.pow(10, low), Math.pow(10, high), false); }
    return values.filter((v, k) => k % skip === 0).map((v) => [v, v < 1e-3 || v >= 1e5 ? v.toExponential(0) : text(v)]);
  }
  const power = Math.pow(10, Math.floor(Math.log10((high - low) / 2)));
  const step = power * [5, 2, 1].find((each) => each * power <= (high - low) / 2);
  const exponent = Math.floor(Math.log10(step) + 1e-9), most = Math.max(Math.abs(low), Math.abs(high));
  const label = (v) => most >= 1e6 || most < 1e-3
    ? v.toExponential(v ? Math.max(0, Math.floor(Math.log10(Math.abs(v)) + 1e-9) - exponent) : 0) : v.toFixed(Math.max(0, -exponent));
  const values = [];
  for (let k = Math.ceil(low / step); k * step <= high; ++k) { values.push([k * step, label(k * step)]); }
  return values;
}

class Plot { // a canvas with curves over the last window of time
  constructor(parent, title, names, log) {
    this.canvas = parent.appendChild(document.createElement("canvas"));
    Object.assign(this, { title, names, log, level: null });
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", title);
    this.clear();
  }
  clear() { this.t = []; this.values = this.names.map(() => []); }
  add(t, values) {
    this.t.push(t);
    values.forEach((value, k) => this.values[k].push(value));
    if (this.t.length > POINTS) { this.t.shift(); this.values.forEach((each) => each.shift()); }
  }
  draw() {
    const { canvas, log } = this, ratio = window.devicePixelRatio || 1, style = getComputedStyle(document.body);
    const width = canvas.clientWidth, height = canvas.clientHeight, left = 58, bottom = 16, top = 18;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const g = canvas.getContext("2d");
    g.scale(ratio, ratio);
    g.font = "11px system-ui, sans-serif";
    const scale = (v) => log ? Math.log10(Math.max(Math.abs(v), 1e-30)) : v;
    let low = Infinity, high = -Infinity;
    for (const v of [...this.values.flat(), ...(this.level ? [this.level] : [])]) {
      if (Number.isFinite(v)) { low = Math.min(low, scale(v)); high = Math.max(high, scale(v)); }
    }
    if (log) { low = Math.max(low, high - 6); } // six decades
    if (!(low <= high)) { low = 0; high = 1; }
    const least = log ? 0.1 : 1e-3 * Math.max(Math.abs(low), Math.abs(high)) || 1; // span of a constant signal
    const room = Math.max((high - low) * 0.06, (least - high + low) / 2);
    low -= room; high += room;
    const first = this.t[0] || 0, last = Math.max(this.t[this.t.length - 1] || 1, first + 1e-9);
    const x = (t) => left + (t - first) / (last - first) * (width - left - 8);
    const y = (v) => top + (high - v) / (high - low) * (height - top - bottom);
    const ink = style.getPropertyValue("--quiet");
    g.fillStyle = ink; g.strokeStyle = style.getPropertyValue("--line"); g.textAlign = "right";
    for (const [value, label] of ticks(low, high, log)) {
      const v = scale(value);
      g.beginPath(); g.moveTo(left, y(v)); g.lineTo(width - 8, y(v)); g.stroke();
      g.fillText(label, left - 5, y(v) + 4);
    }
    g.textAlign = "left"; g.fillText(this.title, left, 12);
    g.textAlign = "right"; g.fillText(text(last) + " " + data.time, width - 8, height - 4);
    const curve = (values, colour, dots) => {
      g.strokeStyle = g.fillStyle = colour; g.lineWidth = 1.5; g.beginPath();
      let open = false;
      values.forEach((v, k) => {
        if (!Number.isFinite(v)) { open = false; return; }
        if (dots) { g.fillRect(x(this.t[k]) - 1, y(scale(v)) - 1, 2, 2); return; }
        g[open ? "lineTo" : "moveTo"](x(this.t[k]), Math.min(y(scale(v)), height - bottom)); open = true;
      });
      g.stroke();
    };
    this.names.forEach((name, k) => curve(this.values[k], style.getPropertyValue("--" + name), name === "measured"));
    if (this.level) {
      g.setLineDash([4, 3]); g.strokeStyle = style.getPropertyValue("--good"); g.lineWidth = 1.2;
      g.beginPath(); g.moveTo(left, y(scale(this.level))); g.lineTo(width - 8, y(scale(this.level))); g.stroke();
      g.setLineDash([]);
    }
  }
}

function slider(parent, { name, low, high, value, unit, meaning }, change) {
  const label = parent.appendChild(document.createElement("label"));
  const shown = document.createElement("output"), input = document.createElement("input");
  label.title = meaning || "";
  label.append(name + (unit ? " (" + unit + ")" : ""), shown, input);
  // a positive range of more than a decade is passed through by factors
  const log = low > 0 && high / low > 10, into = log ? Math.log : (v) => v, out = log ? Math.exp : (v) => v;
  Object.assign(input, { type: "range", min: 0, max: 1, step: "any" });
  const show = (v) => { shown.textContent = text(v); input.value = (into(v) - into(low)) / (into(high) - into(low) || 1); };
  input.addEventListener("input", () => {
    const v = out(into(low) + input.value * (into(high) - into(low)));
    shown.textContent = text(v);
    change(v);
  });
  show(value);
  return show;
}

function faults(add) { // what a button does to the samples, or to the plant
  const held = new Set();
  const button = (name, meaning, press) => {
    const each = add.appendChild(document.createElement("button"));
    each.textContent = name; each.title = meaning;
    each.addEventListener("click", () => press(each));
  };
  for (const [name, meaning] of [["no samples", "outputs are missing (NaN)"],
    ["stuck", "outputs repeat the last sample"], ["spikes", "every tenth sample is off by its range"]]) {
    button(name, meaning, (each) => {
      const on = !held.has(name);
      each.setAttribute("aria-pressed", on);
      held[on ? "add" : "delete"](name);
    });
  }
  return { held, button };
}

async function main() {
  const c = await compile(), m = views(c), window_ = data.duration;
  const differing = c.check();
  document.documentElement.dataset.selftest = differing ? "sample " + differing + " differs" : "passed";
  element("state").textContent = differing
    ? "The self-test failed at sample " + differing + " of " + data.vectors + ": this browser computes other bits."
    : "Self-test: " + data.vectors + " of " + data.vectors + " samples bit for bit as Python computes them. The plant "
      + "is integrated in this page; the observer is the C below, compiled to " + data.bytes + " bytes.";
  const plots = data.states.map((s) => new Plot(element("plots"),
    s.name + (s.unit ? " (" + s.unit + ")" : "") + (s.meaning ? ": " + s.meaning : ""),
    ["truth", "estimate", ...(s.output === null ? [] : ["measured"])], false));
  const errors = data.states.map((s) => new Plot(element("plots"), "|error| of " + s.name, ["estimate"], true));
  data.states.forEach((s, i) => { errors[i].level = s.bound; });
  if (data.states.some((s) => s.bound)) { element("proved").textContent = ", with the proved bound (dashed)"; }
  const bits = data.bits.map((bit) => {
    const each = element("bits").appendChild(document.createElement("div"));
    each.className = "bit";
    each.textContent = bit.name;
    each.appendChild(document.createElement("span")).textContent = bit.text;
    return { each, until: -1 };
  });
  let k = 0, running = true, speed = 1, noise = 1, off = 1, last = [], y = [], jumps = 0, file = null;
  let every = 1, owed = 0, before = null, clock = 0; // the clock in the unit of time
  const { held, button } = faults(element("faults"));
  const varying = data.given.includes(null), wanted = [...data.given, ...data.samples.map((output) => output.name)]
    .filter((each) => each !== null && !data.ages.includes(each));
  const now = () => clock;
  element("columns").textContent = wanted.join(", ")
    + (varying ? " and t, or dt since the row before, in " + data.time : ", and a row for each " + data.dt + " " + data.time);

  function begin() {
    const gains = k ? Array.from(m.gains) : null;
    k = 0; clock = 0; jumps = 0; file = null; last = []; y = [];
    c.begin();
    if (gains) { m.gains.set(gains); c.tune(); }
    data.start.forEach((x, i) => {
      m.x[i] = m.estimate[i] + off * (x - m.estimate[i]);
    });
    [...plots, ...errors].forEach((plot) => plot.clear());
    bits.forEach((bit) => { bit.until = -1; });
    every = Math.max(1, Math.round(window_ / data.dt / POINTS));
  }

  function call(given, samples) { // one period: what the firmware does
    m.given.set(given); m.samples.set(samples);
    const status = c.step() >>> 0;
    bits.forEach((bit, j) => { if (status & (1 << j)) { bit.until = now() + LIT * window_; } });
    data.states.forEach((s) => { if (s.output !== null && Number.isFinite(samples[s.output])) { y[s.output] = samples[s.output]; } });
  }

  function advance() {
    if (k) { c.move(now() - data.dt, data.dt, data.parts); }
    while (jumps < data.jumps.length && data.jumps[jumps].time <= now() + data.dt / 1e6) {
      m.x[data.jumps[jumps].state] = data.jumps[jumps].value; ++jumps;
    }
    c.look(now());
    const samples = data.samples.map((output, j) => {
      if (output.age) { return 0; }
      if (k % output.every || held.has("no samples")) { return NaN; }
      if (held.has("stuck") && last[j] !== undefined) { return last[j]; }
      let v = m.y[j] + noise * output.noise * normal();
      if (held.has("spikes") && Math.random() < 0.1) { v += (Math.random() < 0.5 ? -1 : 1) * output.span; }
      if (output.period) { v -= output.period * Math.floor((v - output.low) / output.period); }
      return last[j] = v;
    });
    call(data.given.map((name, j) => name === null ? data.dt : m.u[j]), samples);
    if (k % every === 0) { record(true); }
    clock = ++k * data.dt;
  }

  function record(known) {
    data.states.forEach((s, i) => {
      const truth = known ? m.x[i] : NaN, measured = s.output === null ? [] : [y[s.output] ?? NaN];
      const error = shortest(m.estimate[i] - truth, s.period);
      plots[i].add(now(), [known && s.period ? m.estimate[i] - error : truth, m.estimate[i], ...measured]);
      errors[i].add(now(), [Math.abs(error)]);
    });
  }

  function replay(name, content) { // the observer on a log, a row for each call
    const lines = content.trim().split(/\r?\n/), mark = lines[0].match(/[;\t]/)?.[0] ?? ","; // "," may be decimal
    const rows = lines.map((row) => row.split(mark).map((cell) => cell.trim().replace(/^"(.*)"$/, "$1")));
    const head = rows.shift() || [], missing = wanted.filter((each) => !head.includes(each));
    if (varying && !head.includes("dt") && !head.includes("t")) { missing.push("t or dt"); }
    if (missing.length) {
      element("state").textContent = name + " has no column " + missing.join(", ") + "; it has " + head.join(", ")
        + ". Name the columns as the model names its outputs and inputs.";
      return;
    }
    const odd = rows.findIndex((row) => row.length !== head.length);
    if (odd >= 0) {
      element("state").textContent = name + ": row " + (odd + 1) + " has " + rows[odd].length + " cells, and the header "
        + head.length + "; separate them by one mark, and write numbers without it.";
      return;
    }
    begin();
    running = false; element("run").textContent = "Run"; file = name;
    every = Math.max(1, Math.ceil(rows.length / POINTS));
    const number = (row, each) => {
      const cell = row[head.indexOf(each)];
      return each === null ? elapsed : data.ages.includes(each) && !head.includes(each) ? 0 : cell ? Number(cell.replace(",", ".")) : NaN;
    };
    let elapsed = data.dt, earlier = varying ? number(rows[0] || [], "t") : 0;
    for (const row of rows) {
      if (varying) {
        const t = number(row, "t");
        elapsed = head.includes("dt") ? number(row, "dt") : t - earlier;
        earlier = t;
      }
      clock += k ? Math.max(elapsed, 0) || 0 : 0;
      call(data.given.map((each) => number(row, each)), data.samples.map((output) => number(row, output.name)));
      if (k % every === 0) { record(false); }
      ++k;
    }
    element("state").textContent = name + ": " + rows.length + " rows, one call "
      + (varying ? "each, over " + text(clock) : "each " + data.dt) + " " + data.time + ".";
    document.documentElement.dataset.replayed = rows.length + " " + Array.from(m.estimate).map(text).join(" ");
  }

  button("a jump", "a state of the plant moves by a tenth of its range", () => {
    const i = Math.floor(Math.random() * data.jumping.length), { state, size } = data.jumping[i] || {};
    if (state !== undefined) { m.x[state] += (Math.random() < 0.5 ? -1 : 1) * size; }
  });
  slider(element("general"), { name: "speed", low: 0.1, high: 10, value: 1, unit: "", meaning: "windows in 20 s" },
    (v) => { speed = v; });
  slider(element("general"), { name: "noise", low: 0, high: 5, value: 1, meaning: "over that of the trial" },
    (v) => { noise = v; });
  slider(element("general"), { name: "initial error", low: 0, high: 2, value: 1, meaning: "over that of the trial" },
    (v) => { off = v; begin(); });
  c.begin();
  const showing = data.gains.map((each, i) => slider(element("gains"), each, (v) => {
    m.gains[i] = v; c.tune();
    showing.forEach((show, j) => { if (j !== i) { show(m.gains[j]); } });
  }));
  data.plant.forEach((each, i) => {
    m.p[i] = each.value;
    slider(element("parameters"), each, (v) => { m.p[i] = v; });
  });
  for (const id of ["gains", "parameters"]) { element(id).hidden = !data[id === "gains" ? id : "plant"].length; }
  element("run").addEventListener("click", () => {
    if (file) { begin(); }
    running = !running;
    element("run").textContent = running ? "Pause" : "Run";
  });
  element("again").addEventListener("click", begin);
  const dropped = (list) => { if (list.length) { list[0].text().then((content) => replay(list[0].name, content)); } };
  element("file").addEventListener("change", (event) => dropped(event.target.files));
  element("drop").addEventListener("dragover", (event) => event.preventDefault());
  element("drop").addEventListener("drop", (event) => { event.preventDefault(); dropped(event.dataTransfer.files); });
  begin();
  window.hgogen = { advance, replay, ticks, cells: m, calls: () => k };

  function frame(time) {
    if (running) {
      owed += before === null ? 0 : Math.min(time - before, 100) / 2e4 * speed * window_ / data.dt;
      const until = performance.now() + 12;
      for (; owed >= 1 && performance.now() < until; --owed) { advance(); }
      owed = Math.min(owed, 1e5);
    }
    before = time;
    [...plots, ...errors].forEach((plot) => plot.draw());
    bits.forEach((bit) => bit.each.classList.toggle("on", bit.until >= now()));
    requestAnimationFrame(frame);
  }
  requestAnimationFrame(frame);
}

if (location.search === "?live") { // in a frame, of which a fragment would move the page around it too
  scrollTo(0, element("observer-live").offsetTop);
}
if (data.wasm) {
  main().catch((error) => { element("state").textContent = "The observer cannot run here: " + error; });
}
