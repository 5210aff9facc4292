// Questions to the service that this page came from.

const API = "/api/v1";
const ANSWER_MS = 60_000; // a service that is frozen takes connections, and never answers

// An answer that is a problem document, or none at all (status 0).
export class Problem extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }

  // The same question gets the same answer.
  get isFinal() {
    return this.status >= 400 && this.status < 500;
  }
}

export const ask = (path, signal = null) => request(path, {}, signal);

// Sends a document, in the name of the owner of a token.
export const post = (path, document, token) => request(path, {
  method: "POST", body: JSON.stringify(document), headers: { "Content-Type": "application/json", ...shown(token) },
});

// The name that a token commands with.
export const commanderOf = (token) => request("/commander", { headers: shown(token) });

const shown = (token) => ({ Authorization: `Bearer ${token}` });

async function request(path, { headers = {}, ...more }, signal = null) {
  const late = AbortSignal.timeout(ANSWER_MS);
  let response;
  let text;
  try {
    response = await fetch(API + path, { ...more, signal: signal ? AbortSignal.any([signal, late]) : late, headers: { Accept: "application/json", ...headers } });
    text = await response.text();
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, "the service does not answer");
  }
  let document;
  try {
    document = JSON.parse(text);
  } catch {
    throw new Problem(response.status, text.slice(0, 200) || response.statusText);
  }
  if (!response.ok) throw new Problem(response.status, document.detail ?? response.statusText);
  return document;
}

export const runPath = (run) => `/runs/${encodeURIComponent(run)}`;
export const eventsOf = (run) => `${API}${runPath(run)}/events`;

// Asks at most once per `every` ms and one at a time; of what is asked meanwhile, the last. Old answers are dropped.
export class Latest {
  constructor(everyMs, question, answered) {
    Object.assign(this, { everyMs, question, answered, wanted: null, busy: false, turn: 0 });
  }

  want(...what) {
    this.wanted = what;
    if (!this.busy) this.next();
  }

  // What is under way no longer matters.
  forget() {
    this.wanted = null;
    this.turn += 1;
  }

  async next() {
    const [what, turn] = [this.wanted, this.turn];
    this.wanted = null;
    this.busy = true;
    const began = performance.now();
    let answer = null;
    let problem = null;
    try {
      answer = await this.question(...what);
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      problem = error;
    } finally {
      const rest = Math.max(0, this.everyMs - (performance.now() - began));
      setTimeout(() => {
        this.busy = false;
        if (this.wanted) this.next();
      }, rest);
    }
    if (turn === this.turn) this.answered(answer, problem, ...what);
  }
}
