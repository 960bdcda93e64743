"""A disk that is really full: a small one of memory, filled while a run is at work."""

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_training import assert_equal_runs, tiny

from manip.errors import UserError
from manip.training.trainer import Trainer

pytestmark = pytest.mark.slow


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 4 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("only root may mount a disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(path: Path) -> None:
    with suppress(OSError), path.open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_a_run_on_a_full_disk_goes_on_when_there_is_room(algo, disk, tmp_path) -> None:
    whole = Trainer(tiny(algo, tmp_path / "whole"))
    assert whole.run()
    config = tiny(algo, disk / "run")
    trainer, filler = Trainer(config), disk / "filler"
    update = trainer.agent.update

    def filling(batch: Any) -> dict[str, float]:
        if trainer.env_steps > 300:
            fill(filler)
        return update(batch)

    trainer.agent.update = filling
    with pytest.raises(UserError, match=r"No space left .*; the run is saved"):
        trainer.run()
    again = replace(config, resume=True)
    with pytest.raises(UserError, match="No space left on device"):
        Trainer(again).run()
    filler.unlink()
    assert Trainer(again).run()
    assert_equal_runs(whole.folder, config.folder)
