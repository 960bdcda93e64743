"""Render the videos of the documentation's gallery: one episode of each task."""

from pathlib import Path

from manip.programs.list import catalogue
from manip.programs.render import Render, render_video

FOLDER = Path(__file__).parents[1] / "docs" / "static" / "films"


def main() -> None:
    """Render an episode of every shipped policy that has the name of its task."""
    for task in catalogue()["tasks"]:
        film = FOLDER / f"{task}.mp4"
        render_video(Render(Path(task), film, episodes=1, width=320, height=240))
        print(film)


if __name__ == "__main__":
    main()
