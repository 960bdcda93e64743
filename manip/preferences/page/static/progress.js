// What is said about the labeller's progress.

const at = (id) => document.getElementById(id);

export function showFooter(progress) {
  at("progress").max = Math.max(1, progress.total);
  at("progress").value = progress.answered;
  at("count").textContent = `${progress.answered} of ${progress.total} pairs answered`;
  at("agreement").textContent = agreement(progress);
  at("left-over").textContent = timeLeft(progress.seconds_left);
}

export function showEnd(view) {
  const { answered, total } = view.progress;
  at("end-title").textContent = total ? "All pairs are answered. Thank you!" : "There are no pairs yet";
  at("end-text").textContent = total
    ? `${answered} pairs are answered and saved. A training run that waits for them goes on `
      + "with manip train --resume. You can close this page; while manip label runs, it shows "
      + "new pairs by itself."
    : "This page goes on by itself when a training run has stored pairs to compare.";
  at("end-agreement").textContent = agreement(view.progress);
}

function agreement({ own, between }) {
  const parts = [];
  if (own.total) parts.push(`you gave the same answer to ${of(own)} repeated pairs`);
  if (between.total) parts.push(`people agree on ${of(between)}`);
  return parts.join("; ");
}

const of = ({ same, total }) => `${same} of ${total}`;

function timeLeft(seconds) {
  if (seconds === null || seconds === 0) return "";
  if (seconds < 60) return "less than a minute left";
  const minutes = Math.round(seconds / 60);
  return `about ${minutes} minute${minutes > 1 ? "s" : ""} left`;
}
