"""`manip report`: one HTML page about runs, their evaluation and their episodes."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.console import Console
from rich.progress import Progress, TaskID

from manip.errors import UserError, at_least
from manip.evaluation.episode_recording import Progress as Progressed
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output
from manip.io.printable import printable
from manip.programs import cli
from manip.reports.films import Film, draw_films
from manip.reports.page import make_page
from manip.reports.recorded_episodes import record_episodes
from manip.reports.replays import make_replays
from manip.reports.run_record import RunRecord, load_records
from manip.reports.sections import RunSection, make_section
from manip.reports.stored_results import stored_evaluation, stored_robustness
from manip.sim.gl import use_backend
from manip.training.run_folder import run_folders

MOST_RUNS, MOST_EPISODES, MOST_REPLAYS, MOST_VIDEOS = 20, 1000, 200, 10
"""States are stored until the page is written, and the page must stay small."""


@dataclass(frozen=True)
class Report:
    """Write a page about one or more trained policies, to be opened in a browser.

    The policies act in episodes on the batch engine, in robosuite's own physics. The
    page shows success with its interval, how far the episodes get and where they are
    lost, learning curves, reward terms, options, the commands that repeat the results,
    and each episode as a 3-D replay. It is one file, and loads nothing from elsewhere.
    """

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, folders of run folders (of `manip train --seeds`, of a sweep),
    policy folders, or names of shipped policies (see `manip list`)."""
    out: Path = Path("report.html")
    """HTML file to write."""
    episodes: int = 100
    """Number of episodes of each policy. More episodes narrow the intervals."""
    seed: int = 0
    """Seed of the episodes' random streams, the same as of `manip evaluate`."""
    replays: int = 50
    """Most episodes of each policy that can be replayed in 3-D: failures and successes,
    half of each if there are enough. More of them make the page larger."""
    videos: int = 0
    """Number of these episodes of which the page holds a video, too."""


def main(arguments: Sequence[str]) -> int:
    """Run the episodes, write the page, print its path and size."""
    options = cli.parse(Report, arguments, "manip report")
    _check(options)
    torch.set_num_threads(1)
    command = shlex.join(["manip", "report", *arguments])
    write_text(options.out, make_report(options, command))
    size = options.out.stat().st_size / 1e6 if options.out.is_file() else 0
    print(printable(f"{options.out} ({size:.1f} MB)"))
    return 0


def make_report(options: Report, command: str) -> str:
    """The page's text, with a progress bar on stderr while the episodes run.

    Raises:
        UserError: there is no such policy, or a video cannot be drawn here.
    """
    records = load_records(_runs(options))
    for record in records:  # files that the page shows, read before the episodes run
        stored_evaluation(record.path)
        stored_robustness(record.path)
    sections, films = [], []
    with Progress(console=Console(stderr=True), transient=True) as bar:
        for record in records:
            running = bar.add_task(record.name, total=1.0)
            progress = partial(_advance, bar, running)
            section, drawn = _section(record, options, progress)
            sections.append(section)
            films.append(drawn)
    return make_page(sections, films, printable(command))


def _check(options: Report) -> None:
    number = len(_runs(options))
    if not 1 <= number <= MOST_RUNS:
        raise UserError(f"name 1 to {MOST_RUNS} runs, not {number}")
    cli.check_range("--episodes", options.episodes, 1, MOST_EPISODES)
    cli.check_range("--replays", options.replays, 0, MOST_REPLAYS)
    cli.check_range("--videos", options.videos, 0, MOST_VIDEOS)
    at_least(0, "--seed", options.seed)
    check_output(options.out, "--out", (".html",))
    if options.videos:
        use_backend()


def _runs(options: Report) -> list[Path]:
    """What RUN names, with the runs of a folder in its place."""
    return [path for run in options.runs for path in run_folders(run) or [run]]


def _section(
    record: RunRecord, options: Report, progress: Progressed
) -> tuple[RunSection, list[Film]]:
    """Run a policy's episodes; what the page shows of them, and videos."""
    played = record_episodes(
        record.policy, record.task, options.episodes, options.seed, progress
    )
    replays = make_replays(played, options.replays)
    films = draw_films(played, options.videos)
    return make_section(record, played, replays), films


def _advance(bar: Progress, running: TaskID, share: float) -> None:
    bar.update(running, completed=share)
