// A target's look: colour, symbol and number. Colours are told apart with any colour vision; red is for loss alone.

const COLORS = {
  light: ["#0072b2", "#b35c00", "#00805c", "#a2468c", "#4a5866"],
  dark: ["#56b4e9", "#f0a830", "#2bc49a", "#e79ac8", "#d8dee6"],
};
// As the charts' library calls them. Five and six have no common factor: 30 targets, each unlike all others.
const SYMBOLS = ["circle", "square", "triangle-up", "diamond", "star", "triangle-down"];
const SIDES = { square: [4, 0.5, 1.2], "triangle-up": [3, 0.5, 1.25], "triangle-down": [3, 0, 1.25], diamond: [4, 0, 1.3] };

const chosen = matchMedia("(prefers-color-scheme: dark)");
const listeners = [];
let tokens = null;

export function isDark() {
  const theme = document.documentElement.dataset.theme;
  return theme ? theme === "dark" : chosen.matches;
}

export function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem("theme", theme);
  changed();
}

export function onTheme(listener) {
  listeners.push(listener);
}

function changed() {
  tokens = null;
  for (const listener of listeners) listener();
}

chosen.addEventListener("change", changed);
const kept = localStorage.getItem("theme");
if (kept === "dark" || kept === "light") document.documentElement.dataset.theme = kept;

// Colours of the style sheet, by name.
export function color(name) {
  tokens ??= { style: getComputedStyle(document.documentElement), found: {} };
  tokens.found[name] ??= tokens.style.getPropertyValue(`--${name}`).trim();
  return tokens.found[name];
}

export const colorOf = (target) => COLORS[isDark() ? "dark" : "light"][(target - 1) % 5];
export const symbolOf = (target) => SYMBOLS[(target - 1) % SYMBOLS.length];

// The outline of a target's symbol around (x, y), of about this radius.
export function trace(path, symbol, x, y, radius) {
  if (symbol === "circle") {
    path.moveTo(x + radius, y);
    path.arc(x, y, radius, 0, 2 * Math.PI);
    return;
  }
  const [corners, turn, size] = SIDES[symbol] ?? [10, 0.5, 1.35];
  for (let i = 0; i < corners; i += 1) {
    const angle = (2 * Math.PI * (i + turn)) / corners + (corners === 3 || corners === 10 ? Math.PI / 2 : 0);
    const r = radius * size * (corners === 10 && i % 2 === 0 ? 0.45 : 1);
    path[i ? "lineTo" : "moveTo"](x + r * Math.cos(angle), y + r * Math.sin(angle));
  }
  path.closePath();
}

// The same for a table or a legend.
export function glyph(target) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "-8 -8 16 16");
  svg.setAttribute("class", "glyph");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(svg.namespaceURI, "path");
  path.setAttribute("d", outline(symbolOf(target)));
  path.setAttribute("class", `color-${(target - 1) % 5}`);
  svg.append(path);
  return svg;
}

function outline(symbol) {
  const steps = [];
  const path = {
    moveTo: (x, y) => steps.push(`M${x.toFixed(2)} ${y.toFixed(2)}`),
    lineTo: (x, y) => steps.push(`L${x.toFixed(2)} ${y.toFixed(2)}`),
    arc: (x, y, r) => steps.push(`A${r} ${r} 0 1 1 ${x - r} ${y}A${r} ${r} 0 1 1 ${x + r} ${y}`),
    closePath: () => steps.push("Z"),
  };
  trace(path, symbol, 0, 0, 5.2);
  return steps.join("");
}
