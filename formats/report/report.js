// One cursor over every time plot and the map, values under the pointer, zoom by dragging (double click: back).
// All is read from the drawings: data-axes, data-at and the paths. Without it the page is the same, but still.
// It stays below 6 kB on the page, where comments and indents are left out. Text is set as text, never as markup.
(() => {
const make = (tag, cls, into) => {
  const e = document.createElementNS(document.querySelector("svg").namespaceURI, tag);
  e.setAttribute("class", cls);
  into.append(e);
  return e;
};
const set = (e, values) => Object.entries(values).forEach(([k, v]) => e.setAttribute(k, v));
const draw = (e, d) => d ? set(e, {d}) : e.removeAttribute("d");
const seen = c => getComputedStyle(c.e).display != "none";
const named = e => {
  const title = e.querySelector("title");
  title.remove();
  return {e, name: title.textContent};
};
// An axis: value <-> px of the drawing as it was written; `view` is the stretch of those px that is shown now.
const axis = ([low, high, start, end, log]) => {
  const f = log ? Math.log : v => v, k = (end - start) / (f(high) - f(low));
  const x = {
    start, end, log, view: [start, end],
    px: v => start + (f(v) - f(low)) * k,
    value: p => log ? low * Math.exp((p - start) / k) : low + (p - start) / k,
    zoom: () => (end - start) / (x.view[1] - x.view[0]),
    shown: p => start + (p - x.view[0]) * x.zoom(),
    drawn: p => x.view[0] + (p - start) / x.zoom(),
  };
  return x;
};
const tip = document.createElement("div");
tip.id = "tip";
tip.hidden = true;
document.body.append(tip);
const figs = [...document.querySelectorAll(".fig[data-axes]")].map(svg => {
  const n = svg.dataset.axes.split(" "), all = s => [...svg.querySelectorAll(s)];
  return {
    svg, x: axis(n.slice(0, 5).map(Number)), y: axis(n.slice(5, 10).map(Number)), kind: n[10], lanes: n[11],
    ticks: all(".xt,.yt").map(g => [g, [...g.children]]), words: all(".l").map(e => e.textContent),
    inner: svg.querySelector("[clip-path]>g"), curves: all(".curve:not(.wide)").map(named),
    here: all(".here").map(e => {
      const [t0, t1, ...d] = e.dataset.at.split(" ").map(Number), at = [];
      for (let i = 0, x = 0, y = 0; i < d.length; i += 2) at.push([x += d[i], y += d[i + 1]]);
      return {...named(e), at, last: at.length - 1, t0, dt: (t1 - t0) / (at.length - 1)};
    }),
    line: make("path", "cursor", svg), box: make("rect", "zoombox", svg),
  };
});
const mix = (a, b, u) => a.map((v, i) => v + ((b || a)[i] - v) * u);
const points = c => c.points ||= c.e.getAttribute("d").split("M").slice(1).map(s => {
  const n = s.match(/-?\d+/g), out = [];
  for (let i = 0, x = 0, y = 0; i + 1 < n.length; i += 2) out.push([(x += +n[i]) / 10, (y += +n[i + 1]) / 10]);
  return out;
});
const height = (c, p) => {
  for (const s of points(c)) {
    const i = s.findIndex(q => q[0] >= p), a = s[i - 1], b = s[i];
    if (a) return mix(a, b, (p - a[0]) / (b[0] - a[0]))[1];
  }
};
const place = (h, t) => {
  const u = (t - h.t0) / h.dt, i = Math.floor(u);
  return u >= 0 && u <= h.last ? mix(h.at[i], h.at[i + 1], u - i) : null;
};
const upright = (f, p) => draw(f.line, p >= f.x.start && p <= f.x.end && `M${p} ${f.y.end}V${f.y.start}`);
const cursor = t => figs.forEach(f => {
  upright(f, f.kind == "time" ? f.x.shown(f.x.px(t)) : NaN);
  f.here.forEach(h => {
    const p = place(h, t);
    draw(h.e, p && `M${p[0] * 10} ${p[1] * 10}h0`);
  });
});
const hide = () => {
  tip.hidden = true;
  cursor(NaN);
};
const figure = v => (v && Math.abs(v) < 1e-3 ? v.toExponential(1) : +v.toPrecision(3) + "").replace("-", "−");
const say = (e, lines) => {
  tip.replaceChildren(...lines.map(([words, c]) => {
    const line = document.createElement("div");
    if (c) line.className = c.e.getAttribute("class").match(/k\d+/);
    line.append(c ? c.name + "  " + words : words);
    return line;
  }));
  tip.hidden = false;
  const [w, h] = [tip.offsetWidth, tip.offsetHeight];
  tip.style.left = Math.max(4, e.clientX + 16 + w > innerWidth ? e.clientX - w - 12 : e.clientX + 16) + "px";
  tip.style.top = Math.max(4, Math.min(e.clientY + 14, innerHeight - h - 4)) + "px";
};
const onMap = (f, e, p) => {
  let t = NaN, best = 1 / 0;
  const tracks = f.here.filter(seen);
  tracks.forEach(h => h.at.forEach((q, i) => {
    const far = Math.hypot(q[0] - p[0], q[1] - p[1]);
    if (far < best) [best, t] = [far, h.t0 + i * h.dt];
  }));
  if (t != t) return;
  cursor(t);
  const at = tracks.map(h => [place(h, t), h]).filter(r => r[0]);
  say(e, [[`${t.toFixed(1)} s: x, y [m]`], ...at.map(([q, h]) => [figure(f.x.value(q[0])) + ", " + figure(f.y.value(q[1])), h])]);
};
const onPlot = (f, e, p) => {
  const v = f.x.value(p[0]), time = f.kind == "time";
  time ? cursor(v) : upright(f, f.x.shown(p[0]));
  const at = f.curves.filter(seen).map(c => [height(c, p[0]), c]).filter(r => r[0] != null);
  const [y, x] = f.words;
  say(e, [[`${time ? v.toFixed(1) + " s" : x + " " + figure(v)}: ${y}`], ...at.map(([q, c]) => [figure(f.y.value(q)), c])]);
};
const labels = (x, most) => {
  const [a, b] = x.view.map(x.value), raw = 10 ** Math.floor(Math.log10((b - a) / most)), out = [];
  const s = raw * [1, 2, 5, 10].find(m => b - a <= m * raw * most);
  for (let k = Math.ceil(a / s); k * s <= b; k++)
    out.push([x.shown(x.px(k * s)), (k * s).toFixed(Math.max(0, -Math.floor(Math.log10(s) + 1e-9))).replace("-", "−")]);
  return out;
};
const redraw = f => {
  const {x, y} = f, [kx, ky] = [x.zoom(), y.zoom()];
  set(f.inner, {transform: `translate(${x.shown(0)} ${y.shown(0)})scale(${kx} ${ky})`});
  f.ticks.forEach(([g, old], i) => {
    if ((i ? ky : kx) == 1) return g.replaceChildren(...old);
    g.replaceChildren();
    labels(i ? y : x, 6).forEach(([p, words]) => {
      draw(make("path", "gridlines", g), i ? `M${x.start} ${p}H${x.end}` : `M${p} ${y.end}V${y.start}`);
      const text = make("text", i ? "e" : "m", g);
      set(text, i ? {x: x.start - 5, y: p + 3.6} : {x: p, y: y.start + 14});
      text.append(words);
    });
  });
};
const zoom = (f, a, b) => {
  const sort = i => [a[i], b[i]].sort((p, q) => p - q);
  let x = sort(0), y = sort(1).reverse();
  if (f.kind == "map") {
    const k = Math.max((x[1] - x[0]) / (f.x.end - f.x.start), (y[0] - y[1]) / (f.y.start - f.y.end)) / 2;
    [x, y] = [[x, f.x], [y, f.y]].map(([p, c]) => [-k, k].map(s => (p[0] + p[1]) / 2 + s * (c.end - c.start)));
  }
  if (!f.lanes && y[0] - y[1] > 20) f.y.view = y;
  const span = x.map(f.x.value);
  figs.forEach(g => {
    if (g == f || f.kind == "time" && g.kind == "time") {
      g.x.view = span.map(g.x.px);
      redraw(g);
    }
  });
};
const back = f => figs.forEach(g => {
  if (g == f || f.kind == "time" && g.kind == "time") {
    [g.x, g.y].forEach(x => x.view = [x.start, x.end]);
    redraw(g);
  }
});
figs.forEach(f => {
  const {x, y, svg} = f, on = (what, act) => svg.addEventListener(what, e => {
    const r = svg.getBoundingClientRect(), k = svg.viewBox.baseVal.width / r.width;
    act(e, (e.clientX - r.left) * k, (e.clientY - r.top) * k);
  });
  let from;
  on("pointermove", (e, p, q) => {
    if (from) set(f.box, {x: Math.min(from[0], p), y: Math.min(from[1], q), width: Math.abs(from[0] - p), height: Math.abs(from[1] - q)});
    const inside = p >= x.start && p <= x.end && q >= y.end && q <= y.start;
    inside ? (f.kind == "map" ? onMap : onPlot)(f, e, [x.drawn(p), y.drawn(q)]) : hide();
  });
  on("pointerdown", (e, p, q) => {
    if (e.button || e.pointerType == "touch") return;
    from = [p, q];
    svg.setPointerCapture(e.pointerId);
    e.preventDefault();
  });
  on("pointerup", (e, p, q) => {
    if (from && Math.abs(from[0] - p) > 6) zoom(f, ...[from, [p, q]].map(c => [x.drawn(c[0]), y.drawn(c[1])]));
    from = 0;
    set(f.box, {width: 0, height: 0});
  });
  on("pointerleave", hide);
  on("dblclick", () => back(f));
});
})();
