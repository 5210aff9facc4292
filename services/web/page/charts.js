// The charts beside the scope.

import { Course } from "./course.js";
import { onTheme } from "./palette.js";
import { Pattern } from "./pattern.js";

export class Charts {
  // `seek(t)` goes to a dwell that was clicked on.
  constructor(seek) {
    this.pattern = new Pattern();
    this.course = new Course(seek);
    onTheme(() => this.redraw());
    const sizes = new ResizeObserver(() => this.redraw());
    for (const chart of [this.pattern, this.course]) sizes.observe(chart.node);
  }

  // Another run: nothing of the one before stays.
  clear() {
    this.pattern.clear();
    this.course.clear();
  }

  // What is not seen is not drawn.
  show(picture) {
    this.pattern.show(picture);
    this.course.show(picture);
  }

  redraw() {
    if (!this.pattern.node.clientWidth) return;
    this.pattern.draw();
    this.course.draw();
  }
}
