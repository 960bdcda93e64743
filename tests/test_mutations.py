"""Damaged and malicious files: refused with one line, and never run as code."""

import pickle
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pytest
import torch
from bomb import Bomb, archived, bare
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sameness import assert_same
from test_policy import make_policy
from toy import QUICK_SAC, make_agent

from manip.agents.policy import WEIGHTS, load_policy
from manip.envs.backends.native_batch import DUMP_FORMAT
from manip.envs.faults import Fault
from manip.errors import DamagedError
from manip.io.tensor_trees import save_tree
from manip.programs import cli, evaluate, render, replay, train
from manip.training.checkpoint import FORMAT, Checkpoints

RUN = """
    --task Reach --algo ppo --num-envs 4 --horizon 20 --steps 64 --threads 1
    --eval-every 64 --eval-episodes 1 --agent.rollout-length 8
    --agent.actor-hidden 8 --agent.critic-hidden 8
"""


class Stored:
    """A file, its content, and how it is read."""

    def __init__(self, path: Path, load: Callable[[], object]) -> None:
        self.path, self.load = path, load
        self.whole, self.loaded = path.read_bytes(), load()


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Stored]:
    """A policy and a checkpoint."""
    folder = tmp_path_factory.mktemp("stored")
    make_policy().save(folder)
    agent = make_agent(QUICK_SAC, seed=0)
    modules = {name: m.state_dict() for name, m in agent.modules().items()}
    state = {"format": FORMAT, "modules": modules, "progress": {"env_steps": 64}}
    Checkpoints(folder).save(state, best=False)
    return {
        "policy": Stored(folder / WEIGHTS, lambda: load_policy(folder).card),
        "checkpoint": Stored(Checkpoints(folder).latest, Checkpoints(folder).load),
    }


@st.composite
def damages(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Ways to damage a file: flip, cut, add, zero, repeat, move."""
    share, other = draw(st.floats(0, 1)), draw(st.floats(0, 1))
    length, bit = draw(st.integers(1, 4096)), draw(st.integers(0, 7))
    noise, kind = draw(st.binary(min_size=1, max_size=64)), draw(st.integers(0, 6))

    def damage(whole: bytes) -> bytes:
        at, to = int(share * (len(whole) - 1)), int(other * len(whole))
        piece = whole[at : at + length]
        rest = whole[:at] + whole[at + length :]
        flipped = bytes([whole[at] ^ 1 << bit])
        return (
            whole[:at] + flipped + whole[at + 1 :],
            whole[:at],
            rest,
            whole[:at] + noise + whole[at:],
            whole[:at] + bytes(len(piece)) + whole[at + length :],
            whole[:at] + piece + whole[at:],
            rest[:to] + piece + rest[to:],
        )[kind]

    return damage


def assert_refused_unless_whole(file: Stored, damage: Callable[[bytes], bytes]) -> None:
    damaged = damage(file.whole)
    file.path.write_bytes(damaged)
    if damaged == file.whole:
        assert_same(file.load(), file.loaded)
        return
    with pytest.raises(DamagedError, match=str(file.path)) as refused:
        file.load()
    assert "\n" not in str(refused.value)


mutated = settings(
    deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.filterwarnings("ignore:.*trying the checkpoint before")
@pytest.mark.parametrize("kind", ["policy", "checkpoint"])
@settings(mutated, max_examples=30, derandomize=True)
@given(damage=damages())
def test_damage_is_refused(kind: str, stored, damage) -> None:
    assert_refused_unless_whole(stored[kind], damage)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*trying the checkpoint before")
@pytest.mark.parametrize("kind", ["policy", "checkpoint"])
@settings(mutated, max_examples=500)
@given(damage=damages())
def test_a_thousand_damages_are_refused(kind: str, stored, damage) -> None:
    assert_refused_unless_whole(stored[kind], damage)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with every file that a run can write."""
    folder = tmp_path_factory.mktemp("run") / "run"
    assert cli.run(train.main, [*RUN.split(), "--out", str(folder)]) == 0
    save_tree(folder / "dumps" / "env0-episode0-step1.safetensors", {"format": 1})
    return folder


def use(folder: Path) -> list[int]:
    """Exit codes of the programs that read a run folder."""
    (dump,) = (folder / "dumps").iterdir()
    return [
        cli.run(train.main, ["--resume", "--out", str(folder)]),
        cli.run(evaluate.main, [str(folder), "--env", "native", "--episodes", "1"]),
        cli.run(replay.main, [str(dump)]),
    ]


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize(
    ("wrap", "open_up"),
    [
        (bare, pickle.loads),
        (archived, lambda content: torch.load(BytesIO(content), weights_only=False)),
    ],
)
def test_pickles_in_every_file_are_never_run(
    run, wrap, open_up, tmp_path, capfd
) -> None:
    folder, mark = tmp_path / "run", tmp_path / "mark"
    shutil.copytree(run, folder)
    for path in files(folder):
        path.write_bytes(wrap(Bomb(mark)))
    assert use(folder) == [2, 2, 2]
    printed = capfd.readouterr().err.splitlines()
    assert len(printed) == 3
    assert all(line.startswith("manip: error: ") for line in printed)
    assert not mark.exists()
    open_up(files(folder)[0].read_bytes())
    assert mark.exists()


def test_code_beside_the_files_of_a_run_is_never_imported(
    run, tmp_path, monkeypatch, capfd
) -> None:
    folder, mark = tmp_path / "run", tmp_path / "mark"
    shutil.copytree(run, folder)
    (folder / "evil.py").write_text(f"open({str(mark)!r}, 'w')")
    policy = load_policy(folder)
    card = replace(policy.card, task="evil:Task")
    replace(policy, card=card).save(folder / "policy")
    config = folder / "config.yaml"
    config.write_text(config.read_text().replace("task: Reach", "task: evil:Task"))
    (dump,) = (folder / "dumps").iterdir()
    fault = Fault("Task", "physics", 0, 0, 1)._asdict()
    save_tree(dump, {"format": DUMP_FORMAT, "fault": fault, "task": "evil:Task"})
    for here in (folder, folder.parent):
        monkeypatch.chdir(here)
        monkeypatch.setattr(sys, "path", [*sys.path, str(folder)])
        codes = [*use(folder), cli.run(evaluate.main, [str(folder / "policy")])]
        codes += [cli.run(render.main, [str(folder), "--steps", "1"])]
        assert codes == [2] * 5
        printed = capfd.readouterr().err.splitlines()
        assert len(printed) == 5
        for line in printed:
            assert line.startswith("manip: error: ")
            assert "task 'evil:Task'" in line
    assert not mark.exists()


@pytest.mark.slow
def test_a_pickle_in_any_file_is_never_run(run, tmp_path, capfd) -> None:
    for number, file in enumerate(files(run)):
        folder, mark = tmp_path / f"run{number}", tmp_path / "mark"
        shutil.copytree(run, folder)
        (folder / file.relative_to(run)).write_bytes(bare(Bomb(mark)))
        assert set(use(folder)) <= {0, 2}, file
        assert "Traceback" not in capfd.readouterr().err
        assert not mark.exists(), file
