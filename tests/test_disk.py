"""A full disk: a small file system in memory, filled while a run trains."""

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from training_runs import assert_equal_runs, finished, new_trainer, tiny

from manip.errors import UserError

pytestmark = pytest.mark.slow


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 4 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("only root may mount a file system")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(path: Path) -> None:
    with suppress(OSError), path.open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_a_run_on_a_full_disk_resumes_when_there_is_room(algo: str, disk: Path) -> None:
    config = tiny(algo, disk / "run")
    trainer, filler = new_trainer(config), disk / "filler"
    update = trainer.parts.agent.update

    def filling(batch: Any) -> dict[str, float]:
        if trainer.state.env_steps > 300:
            fill(filler)
        return update(batch)

    trainer.parts.agent.update = filling
    with pytest.raises(UserError, match=r"No space left .*; the run is saved"):
        trainer.run()
    again = replace(config, resume=True)
    with pytest.raises(UserError, match="No space left on device"):
        new_trainer(again).run()
    filler.unlink()
    assert new_trainer(again).run()
    assert_equal_runs(finished(algo).folder, config.folder)
