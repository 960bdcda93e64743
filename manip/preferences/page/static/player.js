// Two videos with one clock: they start together, and again when both have ended.

const PAUSE_AT_END = 700; // [ms] on the last frames, so that the start is noticed
const SPEEDS = [1, 0.5, 0.25];

export class Player {
  constructor(videos, elements) {
    this.videos = videos;
    this.elements = elements; // replay, pause, time, clock, speed
    this.speed = 0; // index in SPEEDS
    this.paused = false;
    for (const video of videos) video.addEventListener("ended", () => this.#ended());
    elements.replay.addEventListener("click", () => this.replay());
    elements.pause.addEventListener("click", () => this.togglePause());
    elements.speed.addEventListener("click", () => this.changeSpeed());
    elements.time.addEventListener("input", () => this.#seek());
    const tick = () => { this.#showTime(); requestAnimationFrame(tick); };
    tick();
  }

  async show(urls) {
    clearTimeout(this.timer);
    await Promise.all(this.videos.map((video, i) => loaded(video, urls[i])));
    await this.replay();
  }

  clear() {
    clearTimeout(this.timer);
    for (const video of this.videos) video.pause();
  }

  async replay() {
    clearTimeout(this.timer);
    for (const video of this.videos) video.currentTime = 0;
    this.#setPaused(false);
    await this.#play();
  }

  togglePause() {
    if (this.videos.every((video) => video.ended)) return this.replay();
    clearTimeout(this.timer);
    this.#setPaused(!this.paused);
    if (this.paused) for (const video of this.videos) video.pause();
    else this.#play();
  }

  changeSpeed() {
    this.speed = (this.speed + 1) % SPEEDS.length;
    this.#applySpeed();
  }

  async #play() {
    this.#applySpeed();
    const running = this.videos.filter((video) => !video.ended);
    try {
      await Promise.all(running.map((video) => video.play()));
    } catch (error) {
      if (error.name !== "AbortError") this.#setPaused(true); // autoplay is blocked
    }
  }

  #applySpeed() {
    for (const video of this.videos) video.playbackRate = SPEEDS[this.speed];
    const names = ["1", "1/2", "1/4"];
    this.elements.speed.querySelector("span").textContent = `Speed ${names[this.speed]}`;
  }

  #ended() {
    if (!this.videos.every((video) => video.ended) || this.paused) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.replay(), PAUSE_AT_END);
  }

  #seek() {
    clearTimeout(this.timer);
    this.#setPaused(true);
    const time = (this.elements.time.value / 1000) * this.#duration();
    for (const video of this.videos) {
      video.pause();
      // The last frame lasts until the end: at the end itself some browsers show none.
      video.currentTime = Math.min(time, Math.max(0, video.duration - 0.001));
    }
  }

  #setPaused(paused) {
    this.paused = paused;
    this.elements.pause.querySelector("span").textContent = paused ? "Play" : "Pause";
  }

  #duration() {
    return Math.max(...this.videos.map((video) => video.duration || 0));
  }

  #showTime() {
    const duration = this.#duration();
    const now = Math.max(...this.videos.map((video) => video.currentTime));
    const { time, clock } = this.elements;
    if (document.activeElement !== time || !this.paused) {
      time.value = duration ? (1000 * now) / duration : 0;
    }
    clock.textContent = `${now.toFixed(2)} / ${duration.toFixed(2)} s`;
  }
}

function loaded(video, url) {
  return new Promise((resolve, reject) => {
    video.onloadeddata = resolve;
    video.onerror = () => reject(new Error("This browser cannot play the clip."));
    video.src = url;
  });
}
