// Replays of a report's episodes: one viewer for each run, opened when it is seen.
const HOME = { target: "-0.1m 1.02m 0m", orbit: "42deg 72deg 2.25m" };

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream();
  const plain = stream.pipeThrough(new DecompressionStream("gzip"));
  const blob = await new Response(plain).blob();
  return URL.createObjectURL(blob);
}

function element(name, className, text = "") {
  const made = document.createElement(name);
  made.className = className;
  made.textContent = text;
  return made;
}

class Replay {
  constructor(panel) {
    this.panel = panel;
    const one = (selector) => panel.querySelector(selector);
    [this.screen, this.notice] = [one(".screen"), one(".notice")];
    [this.toggle, this.range, this.clock] = [one(".toggle"), one("input[type=range]"), one(".clock")];
    [this.timeline, this.speed] = [one(".timeline"), one(".speed select")];
    const lines = JSON.parse(one(".timelines").textContent);
    this.lines = new Map(lines.map((line) => [String(line.number), line]));
    this.rows = new Map([...panel.querySelectorAll("tr.playable")].map((row) => [row.dataset.episode, row]));
    for (const [number, row] of this.rows)
      row.addEventListener("click", () => this.play(number));
    this.toggle.addEventListener("click", () => this.playing ? this.pause() : this.resume());
    this.range.addEventListener("input", () => { this.pause(); this.seek(Number(this.range.value)); });
    this.speed.addEventListener("change", () => {
      if (this.playing) this.viewer.timeScale = Number(this.speed.value);
    });
    one(".previous").addEventListener("click", () => this.step(-1));
    one(".next").addEventListener("click", () => this.step(1));
    one(".home").addEventListener("click", () => this.home());
    new IntersectionObserver((seen, watch) => {
      if (!seen.some((entry) => entry.isIntersecting)) return;
      watch.disconnect();
      this.open();
    }, { rootMargin: "400px" }).observe(this.screen);
  }

  async open() {
    if (!document.createElement("canvas").getContext("webgl2")) {
      this.fail("This browser cannot draw 3-D scenes: WebGL 2 is off or missing.");
      return;
    }
    const viewer = this.viewer = document.createElement("model-viewer");
    const settings = {
      "camera-controls": "", "interaction-prompt": "none", "animation-crossfade-duration": "0",
      "min-camera-orbit": "auto auto 0.3m", "max-camera-orbit": "auto 175deg 5m", "field-of-view": "38deg",
      "min-field-of-view": "10deg", "touch-action": "pan-y", exposure: "0.72", "shadow-intensity": "0",
      alt: "3-D replay of an episode; drag to turn it",
    };
    for (const [name, value] of Object.entries(settings)) viewer.setAttribute(name, value);
    this.home();
    viewer.addEventListener("load", () => this.start(), { once: true });
    viewer.addEventListener("error", () => this.fail("The 3-D scene cannot be drawn here."));
    this.screen.prepend(viewer);
    try {
      viewer.src = await unpack(this.panel.querySelector(".scene").textContent);
    } catch (error) {
      this.fail(`The 3-D scene cannot be read: ${error.message}`);
    }
  }

  fail(text) {
    this.notice.textContent = text;
    this.notice.hidden = false;
  }

  async start() {
    this.notice.hidden = true;
    this.tag = element("p", "tag");
    this.screen.append(this.tag);
    for (const control of this.panel.querySelectorAll(".controls button, input[type=range]")) control.disabled = false;
    const failed = [...this.lines.values()].find((line) => line.outcome !== "solved");
    await this.show(this.wanted ?? String((failed ?? this.lines.values().next().value).number));
    if (this.wanted) this.resume();
    this.panel.dataset.ready = "true";
  }

  home() {
    this.viewer.cameraTarget = HOME.target;
    this.viewer.cameraOrbit = HOME.orbit;
  }

  // Shows an episode, and plays it as soon as the scene is there.
  async play(number) {
    this.screen.scrollIntoView({ block: "nearest" });
    this.wanted = number;
    if (!this.tag) return;
    await this.show(number);
    this.resume();
  }

  async show(number) {
    this.pause();
    const line = this.line = this.lines.get(number);
    for (const [other, row] of this.rows) row.classList.toggle("current", other === number);
    this.tag.textContent = `episode ${number}: ${line.outcome}`;
    this.range.max = line.seconds;
    this.range.step = line.seconds / Math.max(1, line.reward.length - 1);
    this.draw();
    this.viewer.animationName = number;
    await this.viewer.updateComplete;
    this.viewer.pause();
    this.seek(0);
  }

  step(by) {
    const shown = [...this.rows].filter(([, row]) => row.offsetParent);
    const numbers = shown.map(([number]) => number);
    const at = numbers.indexOf(String(this.line.number));
    const next = numbers[(at + by + numbers.length) % numbers.length];
    if (next === undefined) return;
    const row = this.rows.get(next), list = this.panel.querySelector(".list");
    list.scrollTop = row.offsetTop - list.clientHeight / 2;
    this.play(next);
  }

  seek(seconds) {
    // A seek is multiplied by the speed. At its very end, a loop shows its beginning.
    this.viewer.timeScale = 1;
    this.viewer.currentTime = Math.min(seconds, this.line.seconds - 0.001);
    this.mark(seconds);
  }

  resume() {
    this.playing = true;
    this.toggle.textContent = "Pause";
    this.viewer.timeScale = Number(this.speed.value);
    this.viewer.play();
    const follow = () => {
      if (!this.playing) return;
      this.mark(Math.min(this.viewer.currentTime, this.line.seconds));
      requestAnimationFrame(follow);
    };
    follow();
  }

  pause() {
    if (this.playing) this.viewer.pause();
    this.playing = false;
    this.toggle.textContent = "Play";
  }

  mark(seconds) {
    this.range.value = seconds;
    this.clock.textContent = `${seconds.toFixed(2)} of ${this.line.seconds.toFixed(2)} s`;
    this.needle.style.left = `${100 * seconds / Math.max(this.line.seconds, 1e-9)}%`;
  }

  draw() {
    const rows = Object.entries(this.line.spans).map(([name, spans], index) => {
      const row = element("div", `row c${index % 8}`);
      row.append(element("b", "", name));
      for (const [begin, end] of spans) {
        const bar = element("i", "");
        bar.style.left = `${100 * begin}%`;
        bar.style.width = `${100 * (end - begin)}%`;
        row.append(bar);
      }
      return row;
    });
    const needle = element("div", "needle");
    this.needle = element("i", "");
    needle.append(this.needle);
    this.timeline.replaceChildren(...rows, this.rewards(), needle);
  }

  rewards() {
    const [space, reward] = ["http://www.w3.org/2000/svg", this.line.reward];
    const svg = document.createElementNS(space, "svg"), path = document.createElementNS(space, "polyline");
    const low = Math.min(0, ...reward), high = Math.max(1, ...reward);
    const points = reward.map((value, i) => `${i},${(38 * (high - value) / (high - low) + 1).toFixed(1)}`);
    path.setAttribute("points", points.join(" "));
    svg.setAttribute("viewBox", `0 0 ${Math.max(1, reward.length - 1)} 40`);
    svg.setAttribute("preserveAspectRatio", "none");
    svg.append(path);
    return svg;
  }
}

for (const panel of document.querySelectorAll(".replay")) {
  const only = panel.querySelector(".only-failed");
  only.addEventListener("change", () => panel.classList.toggle("only-failed-shown", only.checked));
  if (panel.querySelector(".scene")) new Replay(panel);
}
