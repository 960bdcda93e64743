"""Render the videos of the documentation's gallery: one episode of each task."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from manip.programs import cli
from manip.programs.list import catalogue
from manip.programs.render import Render, render_video


@dataclass(frozen=True)
class Films:
    """Render an episode of each task that has a shipped policy."""

    out: Path = Path("docs/static/films")
    """Folder for the videos."""
    seed: int = 1
    """Seed of the episodes' random streams."""


def main(arguments: Sequence[str]) -> int:
    """Render the videos, and print their paths."""
    options = cli.parse(Films, arguments, "films.py")
    known = catalogue()
    for task in (name for name in known["tasks"] if name in known["policies"]):
        film, seed = options.out / f"{task}.mp4", options.seed
        render_video(Render(Path(task), film, 1, seed=seed, width=320, height=240))
        print(film)
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main, sys.argv[1:]))
