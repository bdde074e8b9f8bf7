// Figures with data-plot are read, and zoomed along their horizontal axis, with pointer, touch and keys. Without this script, and
// printed, they are the same pictures.
"use strict";
const SVG = "http://www.w3.org/2000/svg";
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];
const MOST_VALUES = 8;
const TOUCH = matchMedia("(pointer: coarse)").matches;
const HINT = {
  true: TOUCH ? "Touch the picture to read it; two fingers or + and − zoom, one finger moves, “all” resets."
    : "Point at the picture, or use the arrow keys; drag or + and − zoom, Escape or a double click resets.",
  false: TOUCH ? "Touch the picture to read it." : "Point at the picture, or use the arrow keys, to read it.",
};

function enliven(root) {
  for (const paper of root.querySelectorAll(".paper[data-plot]")) if (!paper.reset) plot(paper);
}

function made(name, attributes, parent) {
  const element = parent.appendChild(document.createElementNS(SVG, name));
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function plot(paper) {
  const { groups, offsets } = JSON.parse(paper.dataset.plot);
  const svg = paper.querySelector("svg"), hint = HINT[groups.some((one) => one.zoom)];
  for (const one of groups) ready(svg, one);
  const above = made("g", { "pointer-events": "none" }, svg);
  let at = groups[0]; // the group that is read
  let cursor = null, height = null, pressed = null; // the cursor as a part of the whole axis, and where it is in the drawing
  const fingers = new Map(); // each with the part of the axis that it holds, and where it is as a share of the width

  const tools = document.createElement("div"), says = document.createElement("output");
  tools.className = "tools";
  for (const [text, about, act] of [["+", "zoom in", () => zoom(0.5)], ["−", "zoom out", () => zoom(2)], ["all", "reset", reset]]) {
    if (hint === HINT[false]) break;
    const button = tools.appendChild(document.createElement("button"));
    button.type = "button";
    button.textContent = text;
    button.setAttribute("aria-label", about);
    button.addEventListener("click", act);
  }
  tools.append(says);
  paper.after(tools);
  paper.tabIndex = 0;
  paper.setAttribute("role", "group");
  paper.setAttribute("aria-label", `${svg.getAttribute("aria-label")}. ${hint}`);
  paper.reset = reset;

  const place = (part) => at.left + ((part - at.view[0]) / (at.view[1] - at.view[0])) * at.width; // on the drawing
  const panel = () => at.panels.find(({ box }) => height >= box[1] && height <= box[3]) ?? at.panels[0];
  function partAt(event, found = false) {
    const to = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const across = ({ left, right }) => to.x >= left - 2 && to.x <= right + 2;
    const over = (one) => across(one) && to.y >= one.panels[0].box[1] - 2 && to.y <= one.bottom + 2;
    if (found) at = groups.find(over) ?? at;
    height = to.y;
    const share = Math.min(1, Math.max(0, (to.x - at.left) / at.width)), part = at.view[0] + share * (at.view[1] - at.view[0]);
    return { part, at: share, inside: across(at) };
  }

  function draw() {
    const k = 1 / (at.view[1] - at.view[0]), shift = at.left - k * (at.left + at.view[0] * at.width), whole = k === 1;
    if (at.zoom) for (const move of at.moving) move(k, shift);
    for (const tick of at.ticks) tick.style.display = whole ? "" : "none";
    paper.classList.toggle("zoomed", groups.some(({ view }) => view[1] - view[0] < 1));
    above.replaceChildren();
    for (const one of groups) if (one.view[1] - one.view[0] < 1) drawTicks(one);
    if (pressed && pressed.moved) {
      const [a, b] = [place(pressed.part), place(pressed.now)].sort((p, q) => p - q);
      for (const { box } of at.panels) made("rect", { x: a, y: box[1], width: b - a, height: box[3] - box[1], fill: "#0072b2", "fill-opacity": 0.2 }, above);
    }
    if (cursor !== null && cursor >= at.view[0] && cursor <= at.view[1]) drawCursor();
    says.textContent = cursor === null ? hint : readout();
  }
  function drawTicks({ x, view, panels, left, width, bottom }) {
    for (const [part, text] of ticks(x, view, offsets)) {
      const to = left + ((part - view[0]) / (view[1] - view[0])) * width;
      for (const { box } of panels) made("path", { d: `M${to} ${box[1]}V${box[3]}`, stroke: "#b0b0b0", "stroke-opacity": 0.3, "stroke-width": 0.8 }, above);
      made("text", { x: to, y: bottom + 12, "text-anchor": "middle", "font-size": 9 }, above).textContent = text;
    }
  }
  function drawCursor() {
    const { box, rows, columns, cells } = panel(), [row, column] = cell(), look = { stroke: "#444", "stroke-width": 0.8 };
    if (!cells || at.lines.length) {
      for (const { box: [, top, , bottom] } of at.panels) made("path", { d: `M${place(cursor)} ${top}V${bottom}`, ...look }, above);
      return;
    }
    const [x0, x1] = columns.names[column] === undefined ? [0, 1] : [column, column + 1].map((k) => (k - columns.first) / columns.span);
    const [y0, y1] = rows.names[row] === undefined ? [0, 1] : [row, row + 1].map((k) => (k - rows.first) / rows.span).sort((p, q) => p - q);
    const [width, tall] = [at.width, box[3] - box[1]];
    made("rect", { x: at.left + x0 * width, y: box[1] + y0 * tall, width: (x1 - x0) * width, height: (y1 - y0) * tall, fill: "none", ...look, "stroke-width": 1.5 }, above);
  }

  function cell() { // row and column of the cursor in its panel
    const { box, rows, columns } = panel(), down = Math.min(1, Math.max(0, ((height ?? box[1]) - box[1]) / (box[3] - box[1])));
    return [Math.floor(down * rows.span + rows.first), Math.floor(cursor * columns.span + columns.first)];
  }
  function readout() {
    const one = panel(), { rows, columns, cells } = one, [row, column] = cell(), x = at.left + cursor * at.width;
    const name = height === null && !cells ? "" : rows.names[row] ?? "", bars = cells && cells.index.every((line) => line.length === 1);
    const line = cells?.index[cells.index.length === 1 ? 0 : row], text = cells?.texts[line?.[bars ? 0 : column]];
    const among = new Set(at.lines.map((l) => l.name)).size === at.lines.length ? at.lines : one.lines;
    const known = among.map((l) => [l.name, l.at(x), l.value]).filter(([, y]) => y !== null);
    if (known.length > MOST_VALUES) known.sort(([, a], [, b]) => Math.abs(a - height) - Math.abs(b - height)).splice(MOST_VALUES);
    const where = columns.names[column] ?? (bars ? "" : moment(at.x, cursor, offsets, 1 / at.width / 100));
    const values = [text, ...known.map(([n, y, value]) => `${n} ${value(y)}`)].filter(Boolean).join(", ");
    return [groups.length > 1 ? one.title || at.panels[0].title : "", where, name, values].filter(Boolean).join(": ");
  }

  function look(a, b) {
    const span = Math.min(1, Math.max(at.least, b - a)), start = Math.min(1 - span, Math.max(0, (a + b - span) / 2));
    at.view = span === 1 ? [0, 1] : [start, start + span];
    draw();
  }
  function zoom(by, about) {
    if (!at.zoom) return;
    const visible = cursor !== null && cursor >= at.view[0] && cursor <= at.view[1];
    const fixed = about ?? (visible ? cursor : (at.view[0] + at.view[1]) / 2);
    look(fixed + (at.view[0] - fixed) * by, fixed + (at.view[1] - fixed) * by);
  }
  function reset() {
    cursor = height = null;
    for (at of [...groups].reverse()) look(0, 1);
  }
  function snap(part) {
    cursor = at.stops.length ? at.stops[nearest(at.stops, part)] : part;
  }
  function step(by) {
    const { stops, view } = at, from = cursor ?? (by > 0 ? view[0] : view[1]), last = stops.length - 1;
    const k = nearest(stops, from) + (cursor === null && Number.isFinite(by) ? 0 : by), next = groups[groups.indexOf(at) + Math.sign(by)];
    const over = last < 0 ? cursor === (by > 0 ? 1 : 0) : k < 0 || k > last;
    if (over && next && Number.isFinite(by)) {
      [at, cursor] = [next, null];
      return step(by);
    }
    cursor = last < 0 ? Math.min(1, Math.max(0, from + (by * (view[1] - view[0])) / 100)) : stops[Math.min(last, Math.max(0, k))];
    const shift = Math.min(0, cursor - at.view[0]) + Math.max(0, cursor - at.view[1]);
    look(at.view[0] + shift, at.view[1] + shift);
  }
  function climb(by) { // to the next row, else panel; false where there is none
    const one = panel(), size = ({ box, rows }) => (box[3] - box[1]) / (Object.keys(rows.names).length ? Math.abs(rows.span) : 1);
    const to = (height ?? one.box[1] + size(one) / 2) + by * size(one), next = at.panels[at.panels.indexOf(one) + by];
    if (to > one.box[1] && to < one.box[3]) height = to;
    else if (next) height = by > 0 ? next.box[1] + size(next) / 2 : next.box[3] - size(next) / 2;
    else return false;
    if (cursor === null) snap(at.view[0]);
    draw();
  }

  // Under each finger stays what it holds of the axis: one moves what is zoomed, else reads; two zoom.
  function drag() {
    const [one, two] = fingers.values(), held = two ? (two.part - one.part) / (two.at - one.at) : at.view[1] - at.view[0];
    if (held > 0 && Number.isFinite(held)) look(one.part - one.at * held, one.part + (1 - one.at) * held);
  }
  function lift(event) {
    fingers.delete(event.pointerId);
    for (const one of fingers.values()) one.part = at.view[0] + one.at * (at.view[1] - at.view[0]);
  }

  svg.addEventListener("pointermove", (event) => {
    const { part, at: share, inside } = partAt(event, !pressed && !fingers.size), finger = fingers.get(event.pointerId);
    if (finger) {
      finger.at = share;
      if (at.zoom && (fingers.size > 1 || at.view[1] - at.view[0] < 1)) return drag();
      snap(part);
    } else if (pressed) {
      pressed.now = part;
      pressed.moved ||= at.zoom && Math.abs(event.clientX - pressed.x) > 5;
    } else if (inside) snap(part);
    else return;
    draw();
  });
  svg.addEventListener("pointerdown", (event) => {
    const { part, at: share, inside } = partAt(event, !fingers.size);
    if (event.button || !inside) return;
    svg.setPointerCapture(event.pointerId);
    if (event.pointerType !== "touch") pressed = { part, now: part, x: event.clientX, moved: false };
    else if (fingers.size < 2) fingers.set(event.pointerId, { part, at: share }), snap(part), draw();
  });
  svg.addEventListener("pointerup", (event) => {
    const was = pressed;
    lift(event);
    pressed = null;
    if (was && was.moved) look(Math.min(was.part, was.now), Math.max(was.part, was.now));
    else if (was) snap(was.part), draw();
  });
  svg.addEventListener("pointercancel", (event) => (lift(event), (pressed = null), draw()));
  svg.addEventListener("pointerleave", (event) => {
    if (event.pointerType !== "touch" && !pressed && document.activeElement !== paper) (cursor = null), draw();
  });
  svg.addEventListener("dblclick", reset);
  svg.addEventListener("wheel", (event) => {
    if (document.activeElement !== paper && !event.ctrlKey) return; // the page scrolls
    const { part } = partAt(event, true);
    if (!at.zoom) return;
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, part);
  }, { passive: false });
  paper.addEventListener("keydown", (event) => {
    const act = {
      ArrowRight: () => step(event.shiftKey ? 10 : 1), ArrowLeft: () => step(event.shiftKey ? -10 : -1),
      ArrowDown: () => climb(1), ArrowUp: () => climb(-1), Home: () => step(-Infinity), End: () => step(Infinity),
      "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), Escape: reset,
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    if (act() !== false) event.preventDefault();
  });
  draw();
}

// Panels above each other on one axis: where they are, the points of their lines, where the cursor stops, and what moves.
function ready(svg, one) {
  const [{ box, columns, cells }] = one.panels, names = Object.keys(columns.names);
  one.left = box[0];
  one.right = box[2];
  one.width = box[2] - box[0];
  one.bottom = one.panels[one.panels.length - 1].box[3];
  one.view = [0, 1]; // as parts of the whole axis
  for (const panel of one.panels) panel.lines = panel.lines.map((line) => read(svg, panel, line));
  one.lines = one.panels.flatMap((panel) => panel.lines);
  const sampled = one.lines.filter((line) => !line.steps).map((line) => line.x), longest = sampled.sort((a, b) => b.length - a.length)[0] ?? [];
  const points = longest.length > 1 ? longest : sampled.flat().sort((a, b) => a - b);
  one.stops = points.map((x) => (x - one.left) / one.width).filter((part) => part > -1e-4 && part < 1.0001);
  if (one.x.marks?.length) one.stops = one.x.marks.map(([v]) => partOf(one.x, v));
  if (names.length) one.stops = names.map((k) => (Number(k) + 0.5 - columns.first) / columns.span);
  else if (!one.stops.length && cells) one.stops = [0.5];
  one.least = Math.min(1, 10 / Math.max(longest.length, 2500));
  one.moving = one.zoom ? parts(svg, one.panels) : [];
  one.ticks = one.zoom ? one.panels.flatMap(({ id }) => [...svg.querySelectorAll(`[id$="-${id}"] [id*="-xtick_"]`)]) : [];
}

// What moves with the axis: the drawn parts that are clipped to one of the panels, each as a function of x -> k x + shift.
function parts(svg, panels) {
  const found = new Map(), own = new Map();
  const path = (element) => {
    const before = element.getAttribute("d") ?? ""; // of a line without points there is none
    const moved = (k, shift) => before.replace(/([ML])\s*(\S+)/g, (_, letter, x) => `${letter} ${(k * x + shift).toFixed(2)}`);
    found.set(element, (k, shift) => element.setAttribute("d", k === 1 ? before : moved(k, shift)));
  };
  const within = (clip) => {
    const rect = svg.querySelector(`${clip.slice(4, -1)} rect`), [x, y] = ["x", "y"].map((name) => Number(rect?.getAttribute(name)));
    return panels.some(({ box }) => Math.abs(box[0] - x) < 0.5 && Math.abs(box[1] - y) < 0.5);
  };
  for (const clipped of svg.querySelectorAll("[clip-path]")) {
    const clip = clipped.getAttribute("clip-path");
    if (!own.has(clip)) own.set(clip, within(clip));
    if (!own.get(clip)) continue;
    for (const element of [clipped, ...clipped.querySelectorAll("path, use, image")]) {
      const x = Number(element.getAttribute("x")), before = element.getAttribute("transform") || "";
      if (element.localName === "path") path(element);
      else if (element.localName === "use" && x) found.set(element, (k, shift) => element.setAttribute("x", k * x + shift));
      else if (element.localName === "use") path(svg.querySelector(element.getAttribute("xlink:href")));
      else if (element.localName === "image") found.set(element, (k, shift) => element.setAttribute("transform", `matrix(${k} 0 0 1 ${shift} 0) ${before}`));
    }
  }
  return [...found.values()];
}

// A line: the places of its points, its height at a place, null where it has none, and the value of a height. One that is
// marked by dots is read at these alone.
function read(svg, { box, y: { ends, log, unit } }, { id, name, dots, steps }) {
  const drawn = svg.querySelector(`[id$="-${id}"]`), x = [], heights = [], begins = new Set();
  const marks = dots ? [...(drawn?.querySelectorAll("use") ?? [])].map((use) => ["L", use.getAttribute("x"), use.getAttribute("y")]) : [];
  const path = drawn?.querySelector(":scope > path")?.getAttribute("d") ?? "";
  for (const [letter, across, down] of marks.length ? marks : [...path.matchAll(/([ML])\s*(\S+)\s+(\S+)/g)].map((m) => m.slice(1))) {
    if (letter === "M") begins.add(x.length);
    x.push(Number(across));
    heights.push(Number(down));
  }
  const reach = dots ? 0.3 * Math.min(20, ...x.slice(1).map((to, k) => to - x[k])) : 0.02;
  function at(to) {
    const k = dots ? nearest(x, to) : after(x, to + reach) - 1, next = after(x, to); // after a step
    if (Math.abs(x[k] - to) <= reach) return heights[k];
    if (dots || next === 0 || next === x.length || begins.has(next)) return null;
    return heights[next - 1] + ((to - x[next - 1]) / (x[next] - x[next - 1])) * (heights[next] - heights[next - 1]);
  }
  function value(height) {
    const v = along({ ends, log }, (box[3] - height) / (box[3] - box[1])), fine = 10 ** Math.ceil(Math.log10(Math.abs(ends[1] - ends[0]) / 2000));
    return `${log ? Number(v.toPrecision(3)) : Number((Math.round(v / fine) * fine).toPrecision(10))}${unit && unit !== "1" ? ` ${unit}` : ""}`;
  }
  return { name, steps, x, at, value };
}

// The first of rising values that is above a place, and the one nearest to it.
function after(values, at) {
  let low = 0, high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] > at) high = middle;
    else low = middle + 1;
  }
  return low;
}
function nearest(values, at) {
  const k = Math.min(after(values, at), values.length - 1);
  return k > 0 && Math.abs(values[k - 1] - at) <= Math.abs(values[k] - at) ? k - 1 : k;
}

// The value at a part of an axis, and back.
function along({ ends: [first, last], log }, part) {
  return log ? first * (last / first) ** part : first + part * (last - first);
}
function partOf({ ends: [first, last], log }, value) {
  return log ? Math.log(value / first) / Math.log(last / first) : (value - first) / (last - first);
}

// A place on an axis for people: to how well it is known, `fine`, as a part of the axis; on the wall clock to minutes, seconds or
// hundredths.
function moment(x, part, offsets, fine) {
  const { ends, log, name, unit, marks = [] } = x, t = along(x, part), least = Math.abs(ends[1] - ends[0]) * fine;
  if (!offsets) {
    const [, mark] = marks.find(([v]) => Math.abs(partOf(x, v) - part) < fine) ?? [];
    const number = log ? t.toPrecision(3) : t.toFixed(Math.min(9, Math.max(0, -Math.ceil(Math.log10(2 * least)))));
    return [name, mark ?? Number(number), unit].filter((text) => text !== "").join(" ");
  }
  const places = least > 1 ? 16 : least < 0.005 ? 22 : 19, round = least > 1 ? 60 : least < 0.005 ? 0.01 : 1;
  return wall(Math.round(local(t, offsets) / round) * round).slice(0, places);
}

// Seconds since 1970 on the wall clock of a zone, by its offsets, each with the time from which it holds.
function local(t, offsets) {
  return t + offsets.reduce((found, [from, offset]) => (t >= from ? offset : found), offsets[0][1]);
}

// Such seconds as text: "2026-03-01 14:20:05.00".
function wall(t) {
  return new Date(Math.round(t * 1000)).toISOString().slice(0, 22).replace("T", " ");
}

// Ticks within a view of an axis, as parts of the whole. Those of a clock stand where it shows whole minutes, hours or days; one
// that it leaves out in spring has none.
function ticks(x, view, offsets) {
  const [start, end] = view.map((part) => along(x, part)), span = end - start, found = [];
  const power = 10 ** Math.floor(Math.log10(span / 4)), decimal = [1, 2, 5, 10].map((v) => v * power).find((v) => span / v <= 5);
  if (!offsets) {
    const decades = x.log && end > 10 * start, first = decades ? 10 ** Math.ceil(Math.log10(start)) : Math.ceil(start / decimal) * decimal;
    for (let v = first; v <= end; v = decades ? 10 * v : v + decimal) found.push([partOf(x, v), String(Number(v.toPrecision(7)))]);
    return found;
  }
  const every = span < 5 ? decimal : STEPS.find((v) => span / v <= 4.5) || Math.ceil(span / 4 / 86400) * 86400;
  const [first, last] = [start, end].map((t) => local(t, offsets));
  for (let k = Math.ceil(first / every); k * every <= last; k += 1) {
    const v = k * every, fits = (t) => t >= start && Math.abs(local(t, offsets) - v) < Math.min(1, every) / 2;
    const t = offsets.map(([, offset]) => v - offset).find(fits);
    const [from, to] = every < 1 ? [14, 22] : every < 60 ? [11, 19] : every < 86400 ? [11, 16] : [5, 10];
    if (t !== undefined) found.push([partOf(x, t), wall(v).slice(from, to)]);
  }
  return found;
}

addEventListener("beforeprint", () => document.querySelectorAll(".paper.zoomed").forEach((paper) => paper.reset()));
enliven(document);
