// Files that the page hands out: made here, of what it shows.

const FRAMES_HZ = 20; // of a film

export function save(blob, name) {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(blob);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}

// A canvas as a PNG on this background.
export function saveCanvas(canvas, background, name) {
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  paint(copy, canvas, background);
  copy.toBlob((blob) => save(blob, name), "image/png");
}

// Records a canvas as a film on this background, until the function that is returned is called: it saves the film.
export function record(canvas, background, name) {
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const recorder = new MediaRecorder(copy.captureStream(FRAMES_HZ), { mimeType: "video/webm" });
  const parts = [];
  recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
  recorder.addEventListener("stop", () => save(new Blob(parts, { type: "video/webm" }), name));
  const timer = setInterval(() => paint(copy, canvas, background), 1000 / FRAMES_HZ);
  paint(copy, canvas, background);
  recorder.start();
  return () => {
    clearInterval(timer);
    recorder.stop();
  };
}

// As large as the copy was made: a film's frames have one size.
function paint(copy, canvas, background) {
  const context = copy.getContext("2d");
  context.fillStyle = background;
  context.fillRect(0, 0, copy.width, copy.height);
  context.drawImage(canvas, 0, 0, copy.width, copy.height);
}
