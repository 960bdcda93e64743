// The labelling page: shows a pair, saves the answer, goes on when it is saved.

import * as server from "./server.js";
import { keepOnly, load } from "./clip_store.js";
import { Player } from "./player.js";
import { showFooter, showEnd } from "./progress.js";

const SETTLE = 350; // [ms] in which a new pair takes no answer: it was meant for the last
const MARKED = 150; // [ms] for which the answer stays marked, so that it is noticed
const RETRY = 2000; // [ms] between attempts while the server is away or a run is awaited

const at = (id) => document.getElementById(id);
const player = new Player([at("left"), at("right")], {
  replay: at("replay"), pause: at("pause"), time: at("time"), clock: at("clock"), speed: at("speed"),
});
const buttons = [...document.querySelectorAll("[data-answer]")];

let labeller = "";
let pair = null; // the pair on the screen
let playing = false; // both clips are there; otherwise the pair can only be skipped
let shownAt = 0; // [ms]
let busy = false; // an answer is being saved, or a pair loaded
let retry = 0;

function showOnly(id) {
  for (const main of document.querySelectorAll("main")) main.hidden = main.id !== id;
}

const canGive = (answer) => pair && (playing || answer === "skip");

function enable() {
  for (const button of buttons) button.disabled = busy || !canGive(button.dataset.answer);
}

function later() {
  clearTimeout(retry);
  retry = setTimeout(() => attempt(() => server.view(labeller)), RETRY);
}

// Shows what the server sent: a pair, or that there is none.
async function show(view) {
  clearTimeout(retry);
  showFooter(view.progress);
  at("undo").disabled = at("end-undo").disabled = !view.can_undo;
  if (!view.pair) {
    pair = null;
    player.clear();
    showEnd(view);
    showOnly("end");
    return later();
  }
  showOnly("work");
  const { left, right } = pair = view.pair;
  playing = false;
  const waiting = setTimeout(() => { at("veil").textContent = "Drawing the clips …"; }, 150);
  try {
    const urls = await Promise.all([load(left), load(right)]);
    await player.show(urls);
  } finally {
    clearTimeout(waiting);
  }
  at("veil").textContent = "";
  keepOnly([left, right, ...view.ahead]);
  for (const id of view.ahead) load(id).catch(() => {});
  playing = true;
  shownAt = performance.now();
  document.body.dataset.pair = `${left} ${right}`;
}

// Runs a request and shows its answer; says what failed, and leaves the pair as it is.
async function attempt(request, failed = "") {
  if (busy) return;
  busy = true;
  enable();
  try {
    await show(await request());
    at("message").textContent = "";
  } catch (error) {
    if (error instanceof server.LockedError) return showOnly("locked");
    if (at("end").hidden) at("message").textContent = failed + error.message;
    if (!playing) later();
  } finally {
    busy = false;
    mark(null);
    enable();
  }
}

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

function mark(answer) {
  for (const button of buttons) button.classList.toggle("chosen", button.dataset.answer === answer);
  for (const side of ["left", "right"]) {
    at(side).parentElement.classList.toggle("chosen", side === answer);
  }
}

function give(answer) {
  const seconds = (performance.now() - shownAt) / 1000;
  if (busy || !canGive(answer) || seconds * 1000 < SETTLE) return;
  mark(answer);
  const { left, right } = pair;
  const save = () => server.answer({ labeller, left, right, answer, seconds });
  attempt(async () => (await Promise.all([save(), pause(MARKED)]))[0], "Not saved. ");
}

const undo = () => attempt(() => server.undo(labeller));

const KEYS = {
  ArrowLeft: () => give("left"),
  ArrowRight: () => give("right"),
  ArrowDown: () => give("equal"),
  "=": () => give("equal"),
  e: () => give("equal"),
  s: () => give("skip"),
  u: undo,
  Backspace: undo,
  r: () => player.replay(),
  " ": () => player.togglePause(),
  v: () => player.changeSpeed(),
};

function onKey(event) {
  if (at("work").hidden && at("end").hidden) return;
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action) return;
  event.preventDefault();
  document.activeElement?.blur(); // Space would press the button that has the focus
  action();
}

async function start(name) {
  let view;
  try {
    view = await server.view(name);
  } catch (error) {
    sessionStorage.removeItem("labeller");
    at("start-error").textContent = error.message;
    return askName();
  }
  labeller = name;
  sessionStorage.setItem("labeller", name);
  at("who").textContent = name;
  await attempt(() => view);
}

function askName() {
  showOnly("start");
  at("name").focus();
}

async function open() {
  let settings;
  try {
    settings = await server.settings();
    at("message").textContent = "";
  } catch (error) {
    if (error instanceof server.LockedError) return showOnly("locked");
    at("message").textContent = error.message;
    return void setTimeout(open, RETRY);
  }
  at("question").textContent = at("start-question").textContent = settings.question;
  at("change").hidden = settings.labeller !== null;
  const name = settings.labeller ?? sessionStorage.getItem("labeller");
  return name ? start(name) : askName();
}

for (const button of buttons) button.addEventListener("click", () => give(button.dataset.answer));
at("undo").addEventListener("click", undo);
at("end-undo").addEventListener("click", undo);
at("change").addEventListener("click", askName);
document.addEventListener("keydown", onKey);
at("name-form").addEventListener("submit", (event) => {
  event.preventDefault();
  start(at("name").value);
});
open();
