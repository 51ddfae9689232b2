"use strict";
// The page of a motion: one clock drives the picture, the time line and the charts.

const motion = JSON.parse(document.getElementById("motion").textContent);
const element = id => document.getElementById(id);

// Okabe and Ito's colours, darkened where white paper asks for it; dashes tell more joints apart.
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#aa4488", "#22303c", "#b07800", "#3a9ad0"];
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3]];
const LIMIT = "#a52a00", QUIET = "#556270", GRID = "#e3e8ec";
const PHASES = {
  transit: "#c4def0", approach: "#ffd6a8", retreat: "#e8cbe0", drop: "#b9e4d5", return: "#d3dae0",
};
const colorOf = joint => COLORS[joint % COLORS.length];
const dashOf = joint => DASHES[Math.floor(joint / COLORS.length) % DASHES.length];
const phaseAt = (phases, time) => phases.find(phase => time < phase.end) || phases[phases.length - 1];

function made(kind, parent, text) {
  const item = document.createElement(kind);
  if (text !== undefined) item.textContent = text;
  parent.appendChild(item);
  return item;
}

// The clock. After the end the arm rests for a while, then the motion starts again.
var player = (() => {
  const followers = [];
  let head = 0, playing = false, speed = 1, last = null;
  const time = () => Math.min(head, motion.duration);
  const tell = () => followers.forEach(follow => follow(time(), playing));
  const tick = now => {
    if (!playing) return;
    // A page that was hidden goes on where it was.
    if (last !== null) head += Math.min((now - last) / 1000, 0.25) * speed;
    last = now;
    if (head > motion.duration + motion.rest) head = 0;
    tell();
    requestAnimationFrame(tick);
  };
  const play = () => {
    if (playing) return;
    if (head >= motion.duration) head = 0;
    playing = true;
    last = null;
    tell();
    requestAnimationFrame(tick);
  };
  const pause = () => { playing = false; head = time(); tell(); };
  const seek = to => { head = Math.min(Math.max(to, 0), motion.duration); tell(); };
  const scrub = to => { playing = false; seek(to); };
  return {
    play, pause, seek, scrub, time,
    toggle: () => (playing ? pause() : play()),
    setSpeed: value => { speed = value; },
    follow: follower => followers.push(follower),
  };
})();

// The part of the motion that time line and charts show: all of it, the leg that plays, or some seconds that go along.
const shown = (() => {
  const followers = [], legs = motion.legs;
  let from = 0, to = motion.duration, mode = "all";
  const set = (begin, end) => {
    const span = Math.min(Math.max(end - begin, 0.05), motion.duration);
    const first = Math.min(Math.max(begin, 0), motion.duration - span);
    if (first === from && first + span === to) return;
    from = first;
    to = first + span;
    followers.forEach(follow => follow());
  };
  const along = (time, span) => set(time - 0.1 * span, time + 0.9 * span);
  const legAt = time => Math.max(0, legs.findIndex((leg, k) => time < leg.end || k === legs.length - 1));
  const follow = time => {
    if (mode === "leg") set(legs[legAt(time)].start, legs[legAt(time)].end);
    else if (time < from || time > to) along(time, to - from);
  };
  return {
    get from() { return from; },
    get to() { return to; },
    share: time => (time - from) / (to - from),
    time: share => from + Math.min(Math.max(share, 0), 1) * (to - from),
    choose: value => {
      mode = value;
      if (value === "all") set(0, motion.duration);
      else if (value === "leg") follow(player.time());
      else along(player.time(), Number(value));
    },
    // Nearer by a factor, with a time kept where it is.
    zoom: (time, factor) => {
      mode = element("zoom").value = "free";
      set(time - (time - from) * factor, time + (to - time) * factor);
    },
    leg: by => {
      const at = legAt(player.time()), again = by < 0 && player.time() > legs[at].start + 0.3;
      player.seek(legs[Math.min(Math.max(at + (again ? 0 : by), 0), legs.length - 1)].start);
    },
    follow,
    onChange: follower => followers.push(follower),
  };
})();

// The picture.
if (viewer) {
  viewer.animator.pause();
  player.follow(time => viewer.animator.seek(time));
}
player.follow(shown.follow);

// Controls and time line.
{
  const slider = element("time"), play = element("play"), clock = element("clock").children, zoom = element("zoom");
  const colorOfPhase = part => PHASES[part.name] || PHASES.return;
  const placed = [];
  const segments = (parent, parts, words, color) => parts.forEach(part => {
    const segment = made("div", parent);
    segment.title = `${words(part)}: ${part.start.toFixed(2)} to ${part.end.toFixed(2)} s`;
    if (color) segment.style.background = color(part);
    placed.push([segment, part, words(part)]);
  });
  // A name that does not fit becomes its last word, then none.
  const place = () => placed.forEach(([segment, part, name]) => {
    const [left, right] = [part.start, part.end].map(time => Math.min(Math.max(shown.share(time), 0), 1));
    segment.style.left = 100 * left + "%";
    segment.style.width = 100 * (right - left) + "%";
    segment.hidden = right <= left;
    segment.textContent = [name, name.split(" ").pop(), ""].find(words => {
      segment.textContent = words;
      return segment.scrollWidth <= segment.clientWidth;
    });
  });
  segments(element("fruits"), motion.legs, part => part.name || "return");
  motion.arms.forEach((arm, k) => {
    const row = made("div", element("phases"));
    row.className = "row";
    segments(row, arm.phases, part => (arm.name && part.fruit) || part.name, colorOfPhase);
    if (arm.name) made("b", element("phases"), arm.name).style.top = `calc(${k} * var(--tall))`;
  });
  element("phases").style.setProperty("--rows", motion.arms.length);
  element("timeline").classList.toggle("several", motion.arms.length > 1);
  // The whole motion, small, while a part of it is shown.
  const overview = element("overview"), frame = made("i", overview);
  motion.arms.slice(0, 1).forEach(arm => arm.phases.forEach(part => {
    const segment = made("div", overview);
    segment.style.left = 100 * part.start / motion.duration + "%";
    segment.style.width = 100 * (part.end - part.start) / motion.duration + "%";
    segment.style.background = colorOfPhase(part);
  }));
  const jump = event => {
    const box = overview.getBoundingClientRect();
    player.scrub(motion.duration * (event.clientX - box.left) / box.width);
  };
  overview.addEventListener("pointerdown", event => { overview.setPointerCapture(event.pointerId); jump(event); });
  overview.addEventListener("pointermove", event => { if (event.buttons) jump(event); });
  const look = () => {
    slider.min = shown.from;
    slider.max = shown.to;
    slider.value = player.time();
    overview.hidden = shown.to - shown.from > 0.999 * motion.duration;
    frame.style.left = 100 * shown.from / motion.duration + "%";
    frame.style.width = 100 * (shown.to - shown.from) / motion.duration + "%";
    place();
  };
  shown.onChange(look);
  window.addEventListener("resize", place);
  look();
  [["all", "all"], ...(motion.legs.length ? [["leg", "leg"]] : []), ...[20, 5, 2, 1].filter(span => span < 0.7 * motion.duration).map(
    span => [String(span), span + " s"])].forEach(([value, words]) => { made("option", zoom, words).value = value; });
  const free = made("option", zoom, "zoomed");
  free.value = "free";
  free.hidden = true;
  zoom.addEventListener("change", () => shown.choose(zoom.value));
  if (motion.legs.length > 2) shown.choose(zoom.value = "leg");
  else if (motion.arms.length > 1 && motion.duration > 8) shown.choose(zoom.value = "5");
  ["back", "next"].forEach((id, k) => {
    element(id).hidden = !motion.legs.length;
    element(id).addEventListener("click", () => shown.leg(2 * k - 1));
  });
  const kinds = new Set(motion.arms.flatMap(arm => arm.phases.map(phase => phase.name)));
  if (kinds.size > 1) kinds.forEach(name => {
    const key = made("span", element("key"));
    made("i", key).style.background = PHASES[name] || PHASES.return;
    made("span", key, name);
  });
  const joiners = { drop: " of ", retreat: " from " };
  const aboutFruit = ({ name, fruit }) => (fruit === null ? name : name + (joiners[name] || " to ") + fruit);
  slider.addEventListener("input", () => player.scrub(Number(slider.value)));
  play.addEventListener("click", player.toggle);
  element("speed").addEventListener("change", event => player.setSpeed(Number(event.target.value)));
  player.follow((time, playing) => {
    const words = motion.arms.filter(arm => arm.phases.length).map(arm => (arm.name ? arm.name + ": " : "")
      + aboutFruit(phaseAt(arm.phases, time))).join(", ");
    slider.value = time;
    slider.setAttribute("aria-valuetext", `${time.toFixed(2)} s ${words}`);
    play.textContent = playing ? "\u275a\u275a" : "\u25b6\ufe0e";
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    clock[0].textContent = `${time.toFixed(2)} / ${motion.duration.toFixed(2)} s`;
    clock[1].textContent = words;
  });
  document.addEventListener("keydown", event => {
    if (event.target.closest("select, button") && event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
    if (event.target.closest("select") || event.ctrlKey || event.altKey || event.metaKey) return;
    const step = (shown.to - shown.from) / (event.shiftKey ? 10 : 100);
    const actions = {
      " ": player.toggle,
      ArrowLeft: () => player.scrub(player.time() - step),
      ArrowRight: () => player.scrub(player.time() + step),
      PageUp: () => motion.legs.length && shown.leg(-1),
      PageDown: () => motion.legs.length && shown.leg(1),
      Home: () => player.seek(0),
      End: () => player.seek(motion.duration),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  });
}

// Charts. Each is drawn once for a width; only the cursor and the words below move with the clock.
const EDGE = { left: 52, right: 10, top: 6, bottom: 18 };

function steps(span, most) {
  const raw = span / most, power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map(factor => factor * power).find(step => step >= raw);
}

// Index of the last of some times that is not after one, and how far it is on the way to the next.
function placeOf(times, time) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  const span = times[high] - times[low];
  return [low, high, span > 0 ? Math.min(Math.max((time - times[low]) / span, 0), 1) : 0];
}

function chart(title, note, yOf, draw, tell) {
  const figure = made("figure", element("charts")), caption = made("figcaption", figure);
  made("b", caption, title);
  made("span", caption, " " + note);
  const plot = made("div", figure), canvas = made("canvas", plot), cursor = made("i", plot), now = made("p", figure);
  plot.className = "plot";
  now.className = "now";
  let width = 0, height = 0;
  const xOf = time => EDGE.left + (width - EDGE.left - EDGE.right) * shown.share(time);
  const timeAt = event => shown.time((event.clientX - plot.getBoundingClientRect().left - EDGE.left) / (width - EDGE.left - EDGE.right));
  const redraw = () => {
    const ratio = window.devicePixelRatio || 1;
    width = plot.clientWidth;
    height = plot.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d"), y = value => EDGE.top + (height - EDGE.top - EDGE.bottom) * yOf(value);
    pen.scale(ratio, ratio);
    pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    const area = { left: EDGE.left, right: width - EDGE.right, bottom: height - EDGE.bottom };
    // What follows is drawn inside of the frame only, up to `restore`.
    const clip = () => {
      pen.save();
      pen.beginPath();
      pen.rect(area.left, 0, area.right - area.left, height);
      pen.clip();
    };
    clip();
    pen.globalAlpha = 0.35;
    (motion.arms.length === 1 ? motion.arms[0].phases : []).forEach(phase => {
      pen.fillStyle = PHASES[phase.name] || PHASES.return;
      pen.fillRect(xOf(phase.start), EDGE.top, xOf(phase.end) - xOf(phase.start), area.bottom - EDGE.top);
    });
    pen.restore();
    pen.fillStyle = QUIET;
    pen.textAlign = "center";
    const span = shown.to - shown.from, step = steps(span, Math.max(2, width / 70));
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let k = Math.ceil(shown.from / step - 1e-9); k * step <= shown.to - 0.015 * span; k++) {
      const first = xOf(k * step) < EDGE.left + 12;
      pen.fillText((k * step).toFixed(digits) + (first ? " s" : ""), xOf(k * step) + (first ? 6 : 0), height - 4);
    }
    draw(pen, xOf, y, area, clip);
    pen.restore();
    move(player.time());
  };
  const move = time => {
    cursor.hidden = time < shown.from - 1e-9 || time > shown.to + 1e-9;
    cursor.style.transform = `translateX(${xOf(time) - 1}px)`;
    tell(time);
  };
  const scrub = event => player.scrub(timeAt(event));
  // A finger that goes up or down scrolls the page; one that goes along, or taps, moves the time; two of them zoom, as
  // the wheel does with Ctrl.
  let down = null;
  const fingers = new Map();
  const apart = () => Math.max(10, Math.abs([...fingers.values()].reduce((a, b) => a.clientX - b.clientX)));
  plot.addEventListener("wheel", event => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    shown.zoom(timeAt(event), Math.exp(0.005 * event.deltaY));
  }, { passive: false });
  plot.addEventListener("dblclick", () => shown.choose(element("zoom").value = "all"));
  plot.addEventListener("pointerdown", event => {
    fingers.set(event.pointerId, event);
    if (fingers.size > 1) { down = null; return; }
    down = [event.clientX, event.clientY, event.pointerType !== "touch"];
    plot.setPointerCapture(event.pointerId);
    if (down[2]) scrub(event);
  });
  plot.addEventListener("pointermove", event => {
    if (fingers.size === 2 && fingers.has(event.pointerId)) {
      const before = apart();
      fingers.set(event.pointerId, event);
      shown.zoom(timeAt(event), before / apart());
    }
    if (down === null) return;
    const along = Math.abs(event.clientX - down[0]);
    down[2] = down[2] || (along > 5 && along > Math.abs(event.clientY - down[1]));
    if (down[2]) scrub(event);
  });
  plot.addEventListener("pointerup", event => { fingers.delete(event.pointerId); if (down !== null) scrub(event); down = null; });
  plot.addEventListener("pointercancel", event => { fingers.delete(event.pointerId); down = null; });
  shown.onChange(redraw);
  new ResizeObserver(() => { if (plot.clientWidth !== width) redraw(); }).observe(plot);
  player.follow(move);
  return { now, redraw };
}

function line(pen, color, thick, dash) {
  pen.strokeStyle = color;
  pen.lineWidth = thick;
  pen.setLineDash(dash);
  pen.lineJoin = "round";
  pen.beginPath();
}

function rule(pen, area, y, color, dash, label) {
  line(pen, color, 1, dash);
  pen.moveTo(area.left, y);
  pen.lineTo(area.right, y);
  pen.stroke();
  pen.setLineDash([]);
  if (label === undefined) return;
  pen.fillStyle = color === GRID ? QUIET : color;
  pen.textAlign = "right";
  pen.fillText(label, area.left - 5, y + 4);
}

function clearanceChart(data) {
  const floor = 0.1, finite = [...data.distance, ...data.certain].filter(value => value !== null && value > floor);
  const least = Math.min(...finite, data.keep > floor ? data.keep : Infinity), most = Math.max(...finite, 10 * floor);
  const low = 10 ** Math.floor(Math.log10(Math.min(Math.max(least, floor), most / 10)));
  const high = most * 1.2, decades = Math.log10(high / low);
  const yOf = value => 1 - Math.min(Math.max(Math.log10(Math.max(value, low) / low) / decades, 0), 1);
  const unbounded = finite.length === 0, known_ = data.certain.map((value, k) => value ?? data.distance[k] ?? Infinity);
  // Where it is nearest: the sentence about it leads there, a mark shows it.
  const at = known_.reduce((best, value, k) => (value < known_[best] ? k : best), 0);
  const least_ = known_[at] < Infinity ? { time: data.time[at], certain: known_[at] } : {};
  if (least_.time !== undefined) {
    const button = element("least");
    button.textContent = `look: ${least_.time.toFixed(2)} s`;
    button.hidden = false;
    button.addEventListener("click", () => player.scrub(least_.time));
  }
  const words = length => (length === null ? "not bounded" : length < 99.95 ? length.toFixed(2) + " mm" : (length / 10).toFixed(1) + " cm");
  const draw = (pen, xOf, y, area, clip) => {
    for (let tick = low; tick <= high; tick *= 10) {
      rule(pen, area, y(tick), GRID, [], tick < 9.99 ? Number(tick.toPrecision(1)) + " mm" : tick < 999 ? Math.round(tick) / 10 + " cm" : Math.round(tick) / 1000 + " m");
    }
    clip();
    if (unbounded) {
      pen.textAlign = "center";
      pen.fillStyle = QUIET;
      pen.fillText("nothing to meet", (area.left + area.right) / 2, area.bottom / 2);
      return;
    }
    const { time, certain, distance } = data;
    // Where less is certain than is to be kept.
    const tooNear = k => distance[k] !== null && (certain[k] ?? -1) <= data.keep;
    pen.fillStyle = "#f6c4ad";
    for (let k = 0; k + 1 < time.length; k++) {
      if (!tooNear(k) && !tooNear(k + 1)) continue;
      let end = k + 1;
      while (end + 1 < time.length && (tooNear(end) || tooNear(end + 1))) end++;
      pen.fillRect(xOf(time[k]), EDGE.top, Math.max(xOf(time[end]) - xOf(time[k]), 1), area.bottom - EDGE.top);
      k = end - 1;
    }
    const path = values => {
      let drawing = false;
      values.forEach((value, k) => {
        const known = value ?? (distance[k] === null ? high : null);
        if (known === null) { drawing = false; return; }
        if (drawing) pen.lineTo(xOf(time[k]), y(known)); else pen.moveTo(xOf(time[k]), y(known));
        drawing = true;
      });
    };
    line(pen, "#8aa0b2", 1, []);
    path(distance);
    pen.stroke();
    line(pen, COLORS[0], 1.8, []);
    path(certain);
    pen.stroke();
    if (least_.time !== undefined) {
      const [x, top] = [xOf(least_.time), y(Math.max(least_.certain, low))];
      pen.fillStyle = COLORS[1];
      pen.beginPath();
      [[0, -2], [-5, -11], [5, -11]].forEach(([dx, dy]) => pen.lineTo(x + dx, top + dy));
      pen.fill();
    }
    if (data.keep > 0) {
      rule(pen, area, y(data.keep), LIMIT, [5, 3]);
      pen.textAlign = "left";
      pen.fillStyle = LIMIT;
      pen.fillText(`to keep: ${Number(data.keep.toPrecision(3))} mm`, area.left + 5, y(data.keep) - 4);
    }
  };
  const tell = time => {
    if (unbounded) return;
    const [k, next, part] = placeOf(data.time, time), near = data.pairs[data.nearest[part < 0.5 ? k : next]];
    const between = values => (values[k] === null || values[next] === null ? values[part < 0.5 ? k : next] : values[k] + part * (values[next] - values[k]));
    const away = between(data.distance), known = between(data.certain);
    said.textContent = near === undefined ? "nothing to meet"
      : `${near[0]} – ${near[1]}: ${words(away)} (${known === null ? "nothing certain" : `certain: ${words(known)}`})`;
  };
  let said = { textContent: "" };
  const made_ = chart("Clearance", "certain at all times", yOf, draw, tell);
  made_.now.classList.add("pair");
  said = made("span", made_.now);
  made_.redraw();
}

function sharesChart(data) {
  const peak = Math.max(1000, ...data.shares.map(values => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0))) * 1.06;
  const yOf = value => 0.5 - 0.5 * value / peak;
  const draw = (pen, xOf, y, area, clip) => {
    [-500, 500].forEach(value => rule(pen, area, y(value), GRID, []));
    rule(pen, area, y(0), "#a9b4bf", [], undefined);
    pen.fillStyle = QUIET;
    pen.textAlign = "right";
    pen.fillText("0", area.left - 5, y(0) + 4);
    [-1000, 1000].forEach(value => rule(pen, area, y(value), LIMIT, [5, 3], value / 10 + " %"));
    clip();
    data.shares.forEach((values, joint) => {
      line(pen, colorOf(joint), 1.6, dashOf(joint));
      values.forEach((value, k) => (k ? pen.lineTo(xOf(data.time[k]), y(value)) : pen.moveTo(xOf(data.time[k]), y(value))));
      pen.stroke();
    });
    pen.setLineDash([]);
  };
  const said = [];
  const tell = time => {
    const [k, next, part] = placeOf(data.time, time);
    said.forEach((word, joint) => {
      const share = data.shares[joint][k] + part * (data.shares[joint][next] - data.shares[joint][k]);
      const unit = data.units[joint], digits = unit.startsWith("m") ? 3 : 0;
      const value = data.limit[joint] === null ? "" : " " + (data.zero[joint] + share / 1000 * data.limit[joint]).toFixed(digits) + " " + unit;
      word.textContent = `${motion.joints[joint]} ${Math.round(share / 10) || 0} %`;
      word.parentNode.title = motion.joints[joint] + value;
    });
  };
  const note = data.title === "Position" ? "in its range, ±100 % at its ends" : "as a share of its limit";
  const figure = chart(data.title, note, yOf, draw, tell);
  motion.joints.forEach((_, joint) => {
    const item = made("span", figure.now), swatch = made("canvas", item), pen = swatch.getContext("2d");
    swatch.width = 52;
    swatch.height = 16;
    line(pen, colorOf(joint), 4, dashOf(joint).map(length => 2 * length));
    pen.moveTo(0, 8);
    pen.lineTo(52, 8);
    pen.stroke();
    said.push(made("span", item));
  });
  figure.redraw();
}

if (motion.clearance) clearanceChart(motion.clearance);
motion.charts.forEach(sharesChart);
player.seek(0);
if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) player.play();
