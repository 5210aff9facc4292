// A table that is wider than its panel says so: above it, and by fading where it goes on.

import { make, put } from "./text.js";

const LEAST = 1; // px that are hidden: less is the browser's rounding

export function mark(place) {
  const words = make("p", "goes-on muted");
  words.setAttribute("aria-hidden", "true"); // it is read whole all the same
  place.before(words);
  const look = () => {
    const hidden = place.scrollWidth - place.clientWidth;
    const sides = { left: place.scrollLeft > LEAST, right: hidden - place.scrollLeft > LEAST };
    place.dataset.goesOn = Object.keys(sides).filter((side) => sides[side]).join(" ");
    words.hidden = hidden <= LEAST;
    put(words, `${sides.left ? "← " : ""}more columns${sides.right ? " →" : ""}`);
  };
  place.addEventListener("scroll", look, { passive: true });
  const observer = new ResizeObserver(look);
  for (const node of [place, place.firstElementChild]) observer.observe(node);
}
