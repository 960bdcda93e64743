"""Collectors: groups of environments in threads or other processes, and their loss."""

import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from training_runs import ROLLOUT, assert_equal_runs, shared_scene, tiny

from manip.cluster.policy_weights import SharedWeights, whole
from manip.cluster.remote_rollout import (
    Collected,
    CollectorProcess,
    LostError,
    RemoteRollout,
)
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends import native_batch as native
from manip.errors import UserError
from manip.training.config import TrainConfig
from manip.training.progress import Progress
from manip.training.run import train, train_or_resume


@pytest.fixture(autouse=True)
def _scenes_are_built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "load_scene", shared_scene)


class Elsewhere:
    """A collector as in another process: all that it gets and gives is copied.

    Args:
        shared: stores the weights.
        lives: rollouts that it collects before it is lost; any number if None.
    """

    def __init__(
        self,
        arguments: tuple[Any, ...],
        lives: int | None = None,
        shared: SharedWeights | None = None,
    ) -> None:
        self._process = CollectorProcess(*copied(arguments))
        self._left, self._shared = lives, shared or SharedWeights(copied)

    def collect(self, policy: Any, *arguments: Any) -> Collected:
        if self._left == 0:
            raise LostError("the node has died")
        if self._left is not None:
            self._left -= 1
        policy = whole(*self._shared.split(policy))
        return copied(self._process.collect(policy, *copied(arguments)))


def copied(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


def elsewhere(
    lives: int | None = None, stored: list[Any] | None = None
) -> Callable[..., list[RemoteRollout]]:
    """All collectors elsewhere; the first process of each is lost after its lives.

    Weights that are stored for the collectors are appended to `stored`.
    """
    stored = [] if stored is None else stored

    def put(weights: Any) -> Any:
        stored.append(weights)
        return copied(weights)

    shared = SharedWeights(put)

    def place(config: TrainConfig, envs: Sequence[TaskEnv]) -> list[RemoteRollout]:
        def starter(group: int) -> Callable[[], Elsewhere]:
            left = iter([lives])
            arguments = (config, group, len(envs))
            return lambda: Elsewhere(arguments, next(left, None), shared)

        return [
            RemoteRollout(e, starter(g), f"collector {g}") for g, e in enumerate(envs)
        ]

    return place


@pytest.mark.parametrize("algo", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def test_a_run_does_not_depend_on_the_place_of_its_collectors(
    algo: str, tmp_path: Path
) -> None:
    """Two collectors in threads, elsewhere, and elsewhere with losses."""
    messages: list[str] = []
    stored: list[Any] = []

    def note(progress: Progress) -> None:
        messages.extend(progress.messages)

    for name, options in (
        ("here", {}),
        ("elsewhere", {"place": elsewhere(stored=stored)}),
        ("lost", {"place": elsewhere(3), "callback": note}),
    ):
        config = tiny(algo, tmp_path / name, collectors=2, steps=384)
        assert train(config, **options).finished
        assert_equal_runs(tmp_path / "here", tmp_path / name)
    lost = "collector 0 was lost and is replaced: the node has died"
    assert messages.count(lost) == 1
    rollouts = 384 // ROLLOUT[algo]
    assert 1 < len(stored) <= rollouts + 1  # once, not for each collector


def test_a_run_resumes_in_another_place(tmp_path: Path) -> None:
    whole = tiny("sac", tmp_path / "whole", collectors=2, steps=384)
    assert train(whole).finished
    stop = Event()
    config = tiny("sac", tmp_path / "stopped", collectors=2, steps=384)
    place, callback = elsewhere(), lambda progress: stop.set()
    assert not train(config, place=place, callback=callback, stop=stop).finished
    assert train_or_resume(config).finished
    assert_equal_runs(whole.folder, config.folder)


def test_collectors_change_the_run_but_not_its_experience(tmp_path: Path) -> None:
    """The environments are the same; the exploration noise is not."""
    for number in (1, 2):
        train(tiny("ppo", tmp_path / str(number), collectors=number, steps=64))
    texts = {(tmp_path / n / "metrics.csv").read_text() for n in "12"}
    assert len(texts) == 2


@pytest.mark.parametrize(
    ("algo", "options", "message"),
    [
        ("ppo", {"collectors": 3}, "num_envs 4 does not split evenly over 3 collect"),
        ("a3c", {"collectors": 2}, "--collectors has no use with a3c"),
        ("bc", {"collectors": 2}, "--collectors has no use with bc"),
        ("ppo", {"collectors": 0}, "collectors must be at least 1|from 1"),
    ],
)
def test_collectors_that_do_not_fit_are_refused(
    algo: str, options: dict[str, int], message: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=message):
        train(tiny(algo, tmp_path / "run", **options))


def test_a_collector_that_is_always_lost_ends_the_run(tmp_path: Path) -> None:
    def place(config: TrainConfig, envs: Sequence[TaskEnv]) -> list[RemoteRollout]:
        def start() -> Elsewhere:
            return Elsewhere((config, 0, 1), lives=0)

        return [RemoteRollout(envs[0], start, "collector 0")]

    with pytest.raises(UserError, match=r"collector 0 was lost 5 times.*continue with"):
        train(tiny("ppo", tmp_path / "run"), place=place)
