"""The Ray actor beside the sweep's process: reports, requests to stop, run folders."""

from dataclasses import dataclass
from pathlib import Path

from manip.cluster.job import Report
from manip.io.atomic_files import replace_file


@dataclass(frozen=True)
class Setup:
    """What a task needs to know about the machine of the sweep.

    Attributes:
        directory: its working directory.
        token: a file in the sweep's folder; a node that sees it shares the storage.
        versions: of the packages that results may depend on.
    """

    directory: Path
    token: Path
    versions: dict[str, str]


class Head:
    """Collects the reports of tasks, and holds the run folders of nodes without them.

    Args:
        folders: name of a job -> its run folder.
    """

    def __init__(self, folders: dict[str, Path]) -> None:
        self._folders = folders
        self._reports: list[tuple[str, Report | None]] = []
        self._begun: set[str] = set()
        self._stopping = False

    def begin(self, name: str) -> bool:
        """Note that a task begins; return whether it may."""
        if not self._stopping:
            self._begun.add(name)
            self._reports.append((name, None))
        return not self._stopping

    def report(self, name: str, report: Report) -> bool:
        """Store a report; return whether the task is to stop."""
        self._reports.append((name, report))
        return self._stopping

    def take(self) -> list[tuple[str, Report | None]]:
        """The reports since the last call, in their order; None: a job begins."""
        reports, self._reports = self._reports, []
        return reports

    def stop(self) -> set[str]:
        """Have all tasks stop; return the names of those that have begun."""
        self._stopping = True
        return self._begun

    def files(self, name: str) -> dict[str, bytes]:
        """The files of a job's run folder: relative path -> content."""
        folder = self._folders[name]
        paths = [path for path in folder.rglob("*") if path.is_file()]
        return {str(p.relative_to(folder)): p.read_bytes() for p in paths}

    def store(self, name: str, path: str, content: bytes) -> None:
        """Write a file of a job's run folder, atomically."""
        target = self._folders[name] / path
        replace_file(target, lambda temporary: temporary.write_bytes(content))
