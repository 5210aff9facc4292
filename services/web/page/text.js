// Numbers as text: always as many digits after the point, a dash for what is not known. From a hundred thousand on 5.7e17:
// an estimate that is lost may be as far off as it likes.

const LONG = 1e5;

export function fixed(value, digits = 1) {
  if (value === null || value === undefined) return "–";
  const text = Math.abs(value) < LONG ? value.toFixed(digits) : value.toExponential(1).replace("e+", "e");
  return text.replace("-", "−");
}

export const percent = (share, digits = 1) => fixed(share === null || share === undefined ? null : 100 * share, digits);

// Three digits or so, whatever the size.
export function short(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  return fixed(value, size >= 100 || Number.isInteger(value) ? 0 : size >= 10 ? 1 : 2);
}

export function bytes(value) {
  return value === null || value === undefined ? "–" : `${(value / 2 ** 20).toFixed(0)}`;
}

// Sets what differs: the browser lays out no more than it must.
export function put(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function make(tag, className, text) {
  const node = document.createElement(tag);
  if (className) node.className = className;
  if (text !== undefined) node.textContent = text;
  return node;
}

export const byId = (id) => document.getElementById(id);

// Where a filter leaves nothing: says so, with a button that clears it.
export function noMatch(node, isSaid, kind, filter) {
  const text = isSaid ? `No ${kind} matches “${filter.value.trim()}”.` : "";
  if ((node.firstChild?.textContent ?? "") === text) return;
  node.replaceChildren();
  if (!text) return;
  const button = make("button", "", "Clear the filter");
  button.type = "button";
  button.addEventListener("click", () => {
    filter.value = "";
    filter.dispatchEvent(new Event("input"));
    filter.focus();
  });
  node.append(make("span", "", text), button);
}
