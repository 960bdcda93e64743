"""Checkpoints with a valid checksum whose values do not fit the run: refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from training_runs import by_algorithm, copy_of, finished, new_trainer, stop_after, tiny

from manip.errors import UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.training.resume import resume
from manip.training.trainer import Trainer

Change = Callable[[Any], Any]


def at(path: str, change: Change) -> Change:
    """Change what lies at a path of keys and indices in a tree."""

    def apply(tree: Any) -> Any:
        *parents, last = [int(k) if k.isdigit() else k for k in path.split("/")]
        for key in parents:
            tree = tree[key]
        tree[last] = change(tree[last])
        return tree

    return apply


def set_to(value: Any) -> Change:
    return lambda _: value


def without(key: str) -> Change:
    return lambda tree: {k: v for k, v in tree.items() if k != key}


def filled(value: Any) -> Change:
    return lambda old: old * 0 + value


def wider(tensor: torch.Tensor) -> torch.Tensor:
    return torch.cat([tensor, tensor], -1)


MOMENTS = "optimisers/actor/state/0"
ENV = "collector/envs/0"
ROWS = "progress/rows"

COMMON = {
    "modules missing": lambda t: t.pop("modules"),
    "module missing": at("modules", without("actor")),
    "modules a list": at("modules", set_to([])),
    "optimiser missing": at("optimisers", without("critic")),
    "moments longer": at(f"{MOMENTS}/exp_avg", wider),
    "moments one number": at(f"{MOMENTS}/exp_avg", set_to(torch.zeros(1))),
    "moments scalar": at(f"{MOMENTS}/exp_avg_sq", set_to(torch.tensor(0.0))),
    "moments double": at(f"{MOMENTS}/exp_avg", lambda m: m.double()),
    "moments text": at(f"{MOMENTS}/exp_avg", set_to("a")),
    "moments negative": at(f"{MOMENTS}/exp_avg_sq", filled(-1)),
    "moments NaN": at(f"{MOMENTS}/exp_avg", filled(float("nan"))),
    "moments missing": at(MOMENTS, without("exp_avg")),
    "step negative": at(f"{MOMENTS}/step", filled(-1)),
    "step many": at(f"{MOMENTS}/step", set_to(torch.zeros(3))),
    "unknown parameter": at("optimisers/actor/state", lambda s: s | {99: s[0]}),
    "state a list": at("optimisers/actor/state", set_to([])),
    "no groups": at("optimisers/actor/param_groups", set_to([])),
    "groups a number": at("optimisers/actor/param_groups", set_to(3)),
    "other betas": at("optimisers/actor/param_groups/0/betas", set_to([5, 5])),
    "rate infinite": at("optimisers/actor/param_groups/0/lr", set_to(float("inf"))),
    "rate text": at("optimisers/actor/param_groups/0/lr", set_to("a")),
    "parameters twice": at("optimisers/actor/param_groups/0/params", set_to([0, 0])),
    "agent a list": at("agent", set_to([])),
    "one row of states": at(f"{ENV}/states", lambda s: s[:1]),
    "states a number": at(f"{ENV}/states", set_to(1.0)),
    "states of floats": at(f"{ENV}/states", lambda s: s.astype(np.float32)),
    "states a tensor": at(f"{ENV}/states", torch.from_numpy),
    "clocks one number": at(f"{ENV}/elapsed", lambda e: e[:1]),
    "clocks negative": at(f"{ENV}/elapsed", filled(-(10**9))),
    "clocks of floats": at(f"{ENV}/elapsed", lambda e: e * 1.0),
    "episodes huge": at(f"{ENV}/episode", filled(2**62)),
    "faults negative": at(f"{ENV}/fault_count", set_to(-5)),
    "faults text": at(f"{ENV}/fault_count", set_to("5")),
    "no environments": at("collector/envs", set_to([])),
    "no trackers": at("collector/trackers", set_to([])),
    "tracker shorter": at("collector/trackers/0/counters/0", lambda c: c[:1]),
    "turn text": at("collector/turn", set_to("1")),
    "pending a number": at("collector/pending", set_to(1)),
    "pending numbers": at("collector/pending", set_to([1])),
    "generator short": at("torch_rng", lambda r: r[:7]),
    "generator of floats": at("torch_rng", lambda r: r.float()),
    "steps infinite": at("progress/env_steps", set_to(float("inf"))),
    "steps NaN": at("progress/env_steps", set_to(float("nan"))),
    "steps a fraction": at("progress/env_steps", set_to(1.5)),
    "steps negative": at("progress/env_steps", set_to(-1)),
    "steps huge": at("progress/env_steps", set_to(10**30)),
    "steps true": at("progress/env_steps", set_to(True)),
    "seconds text": at("progress/seconds", set_to("1")),
    "seconds infinite": at("progress/cpu_seconds", set_to(float("inf"))),
    "best a number": at("progress/best", set_to(1.0)),
    "best of three": at("progress/best", set_to([1.0, 2.0, 3.0])),
    "best text": at("progress/best", set_to(["a", "b"])),
    "rows a number": at(ROWS, set_to(5)),
    "rows of numbers": at(ROWS, set_to([5])),
    "row of text": at(f"{ROWS}/0/seconds", set_to("a")),
    "row without steps": at(f"{ROWS}/0", without("env_steps")),
    "rows backwards": at(ROWS, lambda rows: rows[::-1]),
    "row in the future": at(f"{ROWS}/2/env_steps", set_to(10**6)),
    "learned a list": at("progress/learned", set_to([])),
    "episodes a number": at("progress/episodes", set_to(3)),
    "episode of text": at("progress/episodes/0/steps", set_to("a")),
    "episode without": at("progress/episodes/0", without("steps")),
    "milestones shorter": at("progress/episodes/0/milestones", set_to([True])),
    "terms shorter": at("progress/reward_terms/0", set_to([1.0])),
    "progress missing": lambda t: t.pop("progress"),
    "config a number": at("config", set_to(7)),
    "versions a number": at("versions", set_to(7)),
    "weights NaN": at("modules/actor", lambda m: {k: v * np.nan for k, v in m.items()}),
}

REPLAY = {
    "buffer wider": at("agent/buffer", lambda b: change_first(b, wider)),
    "buffer of doubles": at(
        "agent/buffer", lambda b: change_first(b, torch.Tensor.double)
    ),
    "buffer flat": at("agent/buffer", lambda b: change_first(b, torch.Tensor.flatten)),
    "buffer text": at("agent/buffer", set_to("a")),
    "buffer too long": at(
        "agent/buffer", lambda b: every(b, lambda t: torch.cat([t, t]))
    ),
    "cursor outside": at("agent/cursor", set_to(10**9)),
    "cursor negative": at("agent/cursor", set_to(-1)),
    "cursor text": at("agent/cursor", set_to("a")),
    "owed huge": at("agent/owed", set_to(1e12)),
    "owed NaN": at("agent/owed", set_to(float("nan"))),
    "rollout wider": at(
        "collector/pending/0/batch", lambda b: b | {"action": wider(b["action"])}
    ),
    "rollout without action": at("collector/pending/0/batch", without("action")),
    "rollout's dimensions": at("collector/pending/0/dimensions", set_to(0)),
    "rollout's steps": at("collector/pending/0/steps", set_to(10**9)),
    "rollout's episodes": at("collector/pending/0/episodes", set_to([3])),
    "rollouts many": at("collector/pending", lambda p: p * 5),
}


def change_first(buffer: Any, change: Change) -> Any:
    """Change a tensor, or the first of a dict of them."""
    if isinstance(buffer, dict):
        name = next(iter(buffer))
        return buffer | {name: change(buffer[name])}
    return change(buffer)


def every(buffer: Any, change: Change) -> Any:
    if isinstance(buffer, dict):
        return {name: change(tensor) for name, tensor in buffer.items()}
    return change(buffer)


@pytest.fixture(scope="module")
def trainer(tmp_path_factory: pytest.TempPathFactory) -> Trainer:
    """A run of SAC to restore checkpoints into."""
    config = copy_of(finished("sac"), tmp_path_factory.mktemp("sac") / "run")
    return new_trainer(replace(config, resume=True))


def assert_refused(trainer: Trainer, change: Change) -> None:
    latest = trainer.checkpoints.latest
    whole = latest.read_bytes()
    tree = load_tree(latest)
    change(tree)
    save_tree(latest, tree)
    try:
        with pytest.raises(UserError, match="damaged|another configuration") as refused:
            resume(trainer.config, trainer.parts, trainer.checkpoints)
    finally:
        latest.write_bytes(whole)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", COMMON)
def test_a_checkpoint_that_does_not_fit_is_refused(name: str, trainer) -> None:
    assert_refused(trainer, COMMON[name])


@pytest.mark.parametrize("name", REPLAY)
def test_a_replay_buffer_that_does_not_fit_is_refused(name: str, trainer) -> None:
    assert_refused(trainer, REPLAY[name])


@by_algorithm
def test_a_checkpoint_of_every_algorithm_fits(algo: str, tmp_path: Path) -> None:
    config = tiny(algo, tmp_path / "run")
    trainer = new_trainer(config)
    stop_after(trainer, 5)
    assert not trainer.run()
    again = new_trainer(replace(config, resume=True))
    state = resume(again.config, again.parts, again.checkpoints)
    assert state.env_steps == trainer.state.env_steps > 0


@by_algorithm
def test_the_example_of_a_rollout_has_the_form_of_a_rollout(
    algo: str, tmp_path: Path
) -> None:
    collector = new_trainer(tiny(algo, tmp_path / "run")).parts.collector
    example, rollout = collector.example(), collector.next()
    form = [
        {key: (v.shape, v.dtype) for key, v in e.batch.items(True, True)}
        for e in (example, rollout)
    ]
    assert form[0] == form[1]
    assert example.steps == rollout.steps
