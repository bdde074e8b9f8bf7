// Figures with data-plot are read and zoomed along their time with pointer, touch and keys. Without this script, and printed,
// they are the same pictures.
"use strict";
const SVG = "http://www.w3.org/2000/svg";
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];
const HINT = matchMedia("(pointer: coarse)").matches
  ? "Touch the picture to read it; two fingers or + and − zoom, one finger moves, “all” resets."
  : "Point at the picture, or use the arrow keys; drag or + and − zoom, Escape or a double click resets.";

function enliven(root) {
  for (const paper of root.querySelectorAll(".paper[data-plot]")) if (!paper.reset) plot(paper);
}

function made(name, attributes, parent) {
  const element = parent.appendChild(document.createElementNS(SVG, name));
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function plot(paper) {
  const { time, offsets, unit, panels } = JSON.parse(paper.dataset.plot);
  const svg = paper.querySelector("svg"), figure = paper.closest("figure");
  const [left, , right] = panels[0].box, width = right - left, bottom = panels[panels.length - 1].box[3];
  const moving = parts(svg), lines = panels.flatMap((panel) => panel.lines.map((id) => read(svg, panel, id)));
  const points = lines.reduce((most, line) => (line.x.length > most.length ? line.x : most), []);
  const least = Math.min(1, 10 / Math.max(points.length, 2500));
  const above = made("g", { "pointer-events": "none" }, svg);
  let view = [0, 1], cursor = null, row = "", pressed = null; // view and cursor as parts of the whole time
  const fingers = new Map(); // each with the part of the time that it holds, and where it is as a share of the width

  const tools = document.createElement("div"), says = document.createElement("output");
  tools.className = "tools";
  for (const [text, about, act] of [["+", "zoom in", () => zoom(0.5)], ["−", "zoom out", () => zoom(2)], ["all", "reset", reset]]) {
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
  paper.setAttribute("aria-label", `${svg.getAttribute("aria-label")}. ${HINT}`);
  paper.reset = reset;

  const when = (part) => time[0] + part * (time[1] - time[0]);
  const place = (part) => left + ((part - view[0]) / (view[1] - view[0])) * width; // on the drawing
  const partOf = (x) => (x - left) / width; // of a place before zooming
  function partAt(event) {
    const to = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    row = "";
    for (const { box, rows } of panels) {
      const k = Math.floor(((to.y - box[1]) / (box[3] - box[1])) * rows.span + rows.first);
      if (to.y >= box[1] && to.y <= box[3] && rows.names[k] !== undefined) row = rows.names[k];
    }
    const at = Math.min(1, Math.max(0, (to.x - left) / width)), part = view[0] + at * (view[1] - view[0]);
    return { part, at, inside: to.x >= left - 2 && to.x <= right + 2 };
  }

  function draw() {
    const k = 1 / (view[1] - view[0]), shift = left - k * (left + view[0] * width), whole = k === 1;
    for (const move of moving) move(k, shift);
    for (const tick of svg.querySelectorAll('[id*="-xtick_"]')) tick.style.display = whole ? "" : "none";
    paper.classList.toggle("zoomed", !whole);
    above.replaceChildren();
    if (!whole) {
      for (const [part, text] of ticks(time, view, unit, offsets)) {
        const x = place(part);
        for (const { box } of panels) made("path", { d: `M${x} ${box[1]}V${box[3]}`, stroke: "#b0b0b0", "stroke-opacity": 0.3, "stroke-width": 0.8 }, above);
        made("text", { x, y: bottom + 12, "text-anchor": "middle", "font-size": 9 }, above).textContent = text;
      }
    }
    if (pressed && pressed.moved) {
      const [a, b] = [place(pressed.part), place(pressed.now)].sort((p, q) => p - q);
      for (const { box } of panels) made("rect", { x: a, y: box[1], width: b - a, height: box[3] - box[1], fill: "#0072b2", "fill-opacity": 0.2 }, above);
    }
    if (cursor !== null && cursor >= view[0] && cursor <= view[1]) {
      const x = place(cursor);
      for (const { box } of panels) made("path", { d: `M${x} ${box[1]}V${box[3]}`, stroke: "#444", "stroke-width": 0.8 }, above);
    }
    says.textContent = cursor === null ? HINT : readout();
  }

  function readout() {
    const at = left + cursor * width, fine = Math.abs(time[1] - time[0]) / width / 100;
    const values = lines.flatMap((line) => {
      const k = nearest(line.x, at);
      return Math.abs(line.x[k] - at) < 0.02 ? [`${line.name} ${line.value(k)}`] : [];
    });
    return [moment(when(cursor), unit, offsets, fine), row, values.join(", ")].filter(Boolean).join(": ");
  }

  function look(a, b) {
    const span = Math.min(1, Math.max(least, b - a)), start = Math.min(1 - span, Math.max(0, (a + b - span) / 2));
    view = span === 1 ? [0, 1] : [start, start + span];
    draw();
  }
  function zoom(by, about) {
    const visible = cursor !== null && cursor >= view[0] && cursor <= view[1];
    const fixed = about ?? (visible ? cursor : (view[0] + view[1]) / 2);
    look(fixed + (view[0] - fixed) * by, fixed + (view[1] - fixed) * by);
  }
  function reset() {
    view = [0, 1];
    cursor = null;
    draw();
  }
  function snap(part) {
    cursor = points.length ? partOf(points[nearest(points, left + part * width)]) : part;
  }
  function step(by) {
    const from = cursor ?? (by > 0 ? view[0] : view[1]);
    row = "";
    if (points.length) {
      const k = nearest(points, left + from * width) + (cursor === null && Number.isFinite(by) ? 0 : by);
      cursor = partOf(points[Math.min(points.length - 1, Math.max(0, k))]);
    } else cursor = Math.min(1, Math.max(0, from + (by * (view[1] - view[0])) / 100));
    const over = Math.min(0, cursor - view[0]) + Math.max(0, cursor - view[1]);
    look(view[0] + over, view[1] + over);
  }

  // Under each finger stays the time that it holds: one moves what is zoomed, else reads; two zoom.
  function drag() {
    const [one, two] = fingers.values(), held = two ? (two.part - one.part) / (two.at - one.at) : view[1] - view[0];
    if (held > 0 && Number.isFinite(held)) look(one.part - one.at * held, one.part + (1 - one.at) * held);
  }
  function lift(event) {
    fingers.delete(event.pointerId);
    for (const one of fingers.values()) one.part = view[0] + one.at * (view[1] - view[0]);
  }

  svg.addEventListener("pointermove", (event) => {
    const { part, at, inside } = partAt(event), finger = fingers.get(event.pointerId);
    if (finger) {
      finger.at = at;
      if (fingers.size > 1 || view[1] - view[0] < 1) return drag();
      snap(part);
    } else if (pressed) {
      pressed.now = part;
      pressed.moved ||= Math.abs(event.clientX - pressed.x) > 5;
    } else if (inside) snap(part);
    else return;
    draw();
  });
  svg.addEventListener("pointerdown", (event) => {
    const { part, at, inside } = partAt(event);
    if (event.button || !inside) return;
    svg.setPointerCapture(event.pointerId);
    if (event.pointerType !== "touch") pressed = { part, now: part, x: event.clientX, moved: false };
    else if (fingers.size < 2) fingers.set(event.pointerId, { part, at }), snap(part), draw();
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
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, partAt(event).part);
  }, { passive: false });
  paper.addEventListener("keydown", (event) => {
    const act = {
      ArrowRight: () => step(event.shiftKey ? 10 : 1), ArrowLeft: () => step(event.shiftKey ? -10 : -1),
      Home: () => step(-Infinity), End: () => step(Infinity),
      "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), Escape: reset,
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  });
  draw();
}

// What moves with the time: the drawn parts that are clipped to a panel, each as a function of x -> k x + shift.
function parts(svg) {
  const found = new Map();
  const path = (element) => {
    const before = element.getAttribute("d") ?? ""; // of a line without points there is none
    const moved = (k, shift) => before.replace(/([ML])\s*(\S+)/g, (_, letter, x) => `${letter} ${(k * x + shift).toFixed(2)}`);
    found.set(element, (k, shift) => element.setAttribute("d", k === 1 ? before : moved(k, shift)));
  };
  for (const clipped of svg.querySelectorAll("[clip-path]")) {
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

// The points of a line, with their values by the scale of its panel.
function read(svg, { box, y, unit }, id) {
  const path = svg.querySelector(`[id$="-${id}"] path`), x = [], height = [];
  for (const point of (path?.getAttribute("d") ?? "").matchAll(/[ML]\s*(\S+)\s+(\S+)/g)) {
    x.push(Number(point[1]));
    height.push(Number(point[2]));
  }
  const fine = 10 ** Math.floor(Math.log10(Math.abs(y[1] - y[0]) / 2000));
  const value = (k) => {
    const v = y[0] + ((box[3] - height[k]) / (box[3] - box[1])) * (y[1] - y[0]);
    return `${Number((Math.round(v / fine) * fine).toPrecision(10))}${unit && unit !== "1" ? ` ${unit}` : ""}`;
  };
  return { name: id, x, value };
}

function nearest(values, at) {
  let low = 0, high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] < at) low = middle;
    else high = middle;
  }
  return Math.abs(values[low] - at) <= Math.abs(values[high] - at) ? low : high;
}

// A time for people: to how well it is known, `fine` (s, or of the unit); on the wall clock to minutes, seconds or hundredths.
function moment(t, unit, offsets, fine) {
  if (unit) return `${Number(t.toFixed(Math.min(9, Math.max(0, -Math.floor(Math.log10(fine))))))} ${unit}`;
  const places = fine > 1 ? 16 : fine < 0.005 ? 22 : 19, round = fine > 1 ? 60 : fine < 0.005 ? 0.01 : 1;
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

// Ticks of a clock stand where the clock shows whole minutes, hours or days; one that it leaves out in spring has none.
function ticks(time, view, unit, offsets) {
  const whole = time[1] - time[0], start = time[0] + view[0] * whole, span = (view[1] - view[0]) * whole;
  const power = 10 ** Math.floor(Math.log10(span / 4)), decimal = [1, 2, 5, 10].map((v) => v * power).find((v) => span / v <= 5);
  const days = Math.ceil(span / 4 / 86400) * 86400;
  const every = unit || span < 5 ? decimal : STEPS.find((v) => span / v <= 4.5) || days;
  const [first, last] = [start, start + span].map((t) => local(t, offsets)), found = [];
  for (let k = Math.ceil(first / every); k * every <= last; k += 1) {
    const v = k * every, fits = (t) => t >= start && Math.abs(local(t, offsets) - v) < Math.min(1, every) / 2;
    const t = offsets.map(([, offset]) => v - offset).find(fits), text = unit ? String(Number(v.toPrecision(7))) : wall(v);
    const [from, to] = every < 1 ? [14, 22] : every < 60 ? [11, 19] : every < 86400 ? [11, 16] : [5, 10];
    if (t !== undefined) found.push([(t - time[0]) / whole, unit ? text : text.slice(from, to)]);
  }
  return found;
}

addEventListener("beforeprint", () => document.querySelectorAll(".paper.zoomed").forEach((paper) => paper.reset()));
enliven(document);
