// The keyboard: every button's short cut. The help lists them.

import { byId } from "./text.js";

const KEPT_AS = "keys";

// `acts` maps keys to what they do. Keys that an element in focus uses itself are left to it.
export function listen(acts) {
  const switched = byId("keys-on");
  switched.checked = localStorage.getItem(KEPT_AS) !== "off";
  switched.addEventListener("change", () => localStorage.setItem(KEPT_AS, switched.checked ? "on" : "off"));
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || document.querySelector("dialog[open]")) return;
    const on = event.target.closest?.("input, select, textarea, button, a");
    if (on?.matches("input:not([type=range], [type=checkbox]), textarea")) return;
    const isSlider = on?.matches("input[type=range]");
    if (on && event.key === " " && !isSlider) return;
    if (on?.matches("select") && (event.key.startsWith("Arrow") || /^\d$/.test(event.key))) return;
    // Letters, digits and signs can be switched off: speech that is typed would press them.
    if (!switched.checked && event.key.length === 1 && event.key !== " ") return;
    const act = scrolls(event) ? null : acts[event.key] ?? (/^[1-9]$/.test(event.key) ? acts.digit : null);
    if (!act) return;
    event.preventDefault();
    act(event);
  });
}

// Whether it scrolls what is in focus.
function scrolls({ key, target }) {
  const place = target.closest?.(".scroll");
  if (!place) return false;
  return key === "Home" || key === "End" || (/^Arrow(Left|Right)$/.test(key) && place.scrollWidth > place.clientWidth);
}
