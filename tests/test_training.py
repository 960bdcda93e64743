"""Training runs: what they leave behind, and that they repeat bit for bit."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from training_runs import (
    ROLLOUT,
    TIMES,
    assert_equal_runs,
    assert_tensorboard_holds,
    by_algorithm,
    choices,
    finished,
    new_trainer,
    state_of,
    stop_after,
    tiny,
)

from manip.agents.policy import load_policy
from manip.errors import UserError
from manip.training.build import policy_of
from manip.training.config import (
    from_dict,
)
from manip.training.run_logs import MetricsTable, read_metrics


@by_algorithm
def test_a_run_leaves_config_metrics_events_checkpoint_and_policy(algo: str) -> None:
    run = finished(algo)
    names = {path.name for path in run.folder.iterdir()}
    files = {"config.yaml", "metrics.csv", "run.lock"}
    assert names == files | {"checkpoints", "policy", "tensorboard"}
    recorded = yaml.safe_load((run.folder / "config.yaml").read_text())
    assert recorded.pop("versions")["torch"]
    assert from_dict(recorded) == run.config
    checkpoints = {path.stem for path in (run.folder / "checkpoints").iterdir()}
    assert checkpoints == {"latest", "previous", "best"}
    assert state_of(run.folder)["progress"]["env_steps"] == run.state.env_steps == 512


@by_algorithm
def test_metrics_have_a_row_for_every_rollout_and_evaluation(algo) -> None:
    rows = read_metrics(finished(algo).folder / "metrics.csv")
    length = ROLLOUT[algo]
    steps = [int(row["env_steps"]) for row in rows]
    assert steps == sorted(set(steps))
    assert set(steps) >= set(range(length, 513, length))
    assert len(rows) >= 100 or algo == "a3c"
    whole = [row for row in rows if any(row[n] for n in row if "train/reward/" in n)]
    assert {int(row["env_steps"]) % length for row in whole} == {0}
    every = [str(-(-due // length) * length) for due in (192, 384, 512)]
    assert [row["env_steps"] for row in choices(finished(algo).folder)] == every
    light = {row["env_steps"] for row in rows if row["curve/return"]}
    assert light
    assert not light & set(every)
    seconds = [float(row["seconds"]) for row in rows]
    assert seconds == sorted(seconds)
    for name, value in rows[-1].items():
        assert name.startswith("curve/") or math.isfinite(float(value)), name
    groups = {name.split("/")[0] for name in rows[-1]}
    assert groups >= {"env_steps", *TIMES, "train", "eval", "curve", "learn"}


@by_algorithm
def test_tensorboard_holds_what_metrics_hold(algo) -> None:
    rows = read_metrics(finished(algo).folder / "metrics.csv")
    assert_tensorboard_holds(rows, finished(algo).folder)


def assert_holds(modules: dict[str, Any], weight: torch.Tensor) -> None:
    tensors = [tensor for state in modules.values() for tensor in state.values()]
    matching = [tensor for tensor in tensors if tensor.shape == weight.shape]
    assert any(torch.equal(tensor, weight) for tensor in matching)


def test_learning_rates_fall_to_zero_in_the_last_share(tmp_path, monkeypatch) -> None:
    run, rates_at = new_trainer(tiny("sac", tmp_path / "run", cool_down=0.5)), []
    update = run.parts.agent.update

    def recorded(batch):
        (group,) = run.parts.agent.optimisers()["critic"].param_groups
        rates_at.append((run.state.env_steps, group["lr"]))
        return update(batch)

    monkeypatch.setattr(run.parts.agent, "update", recorded)
    run.run()
    steps, rates = map(np.array, zip(*rates_at, strict=True))
    expected = run.config.agent.learning_rate * np.minimum(1, 2 * (1 - steps / 512))
    np.testing.assert_allclose(rates, expected, atol=1e-12)
    assert steps[-1] == 512
    (group,) = run.parts.agent.optimisers()["critic"].param_groups
    run.state.env_steps += 64  # the last rollout may pass the end
    for share, rate in ((0.5, 0.0), (0.0, run.config.agent.learning_rate)):
        run.config = replace(run.config, cool_down=share)
        run._set_learning_rates()
        assert group["lr"] == rate


@by_algorithm
def test_the_saved_policy_is_the_best_evaluated_one(algo) -> None:
    run = finished(algo)
    rows = choices(run.folder)
    best = max(
        rows, key=lambda r: (float(r["eval/success_held"]), float(r["eval/return"]))
    )
    policy, checkpoint = load_policy(run.folder), state_of(run.folder, "best")
    card = policy.card
    assert card.env_steps == int(best["env_steps"])
    assert checkpoint["progress"]["env_steps"] == card.env_steps
    assert_holds(checkpoint["modules"], policy.actor.body[-1].weight)
    assert (card.task, card.robot, card.algo) == ("Reach", "Panda", algo)
    spec = run.parts.evaluator.env.batch.observation_spec
    assert card.observation_spec == spec


def test_evaluations_are_of_the_same_episodes(tmp_path: Path) -> None:
    """A policy that does not learn has the same results each time."""
    agent = {"learning_rate": 0.0, "normalise": False}
    config = tiny("ppo", tmp_path / "run", agent=agent)
    new_trainer(config).run()
    rows = read_metrics(config.folder / "metrics.csv")
    for kind, least in (("eval", 3), ("curve", 2)):
        evaluated = {
            tuple(v for k, v in row.items() if k.startswith(f"{kind}/"))
            for row in rows
            if row[f"{kind}/return"]
        }
        assert len(evaluated) == 1
        assert sum(bool(row[f"{kind}/return"]) for row in rows) >= least


def test_light_evaluations_do_not_change_what_is_learned(tmp_path: Path) -> None:
    without = new_trainer(tiny("sac", tmp_path / "run", curve_episodes=0))
    assert without.run()
    policies = [
        folder / "policy" / "policy.safetensors"
        for folder in (without.folder, finished("sac").folder)
    ]
    assert policies[0].read_bytes() == policies[1].read_bytes()
    assert "curve/return" not in read_metrics(without.folder / "metrics.csv")[0]


@by_algorithm
def test_the_same_seed_gives_the_same_run_bit_for_bit(algo, tmp_path) -> None:
    again = new_trainer(tiny(algo, tmp_path / "again"))
    assert again.run()
    assert_equal_runs(finished(algo).folder, again.folder)


@by_algorithm
@pytest.mark.parametrize("threads", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_the_number_of_threads_does_not_change_a_run(
    threads: int, algo: str, tmp_path: Path
) -> None:
    again = new_trainer(tiny(algo, tmp_path / "again", threads=threads))
    assert again.run()
    assert_equal_runs(finished(algo).folder, again.folder)


@pytest.mark.slow
@by_algorithm
def test_sixteen_environments_give_the_same_run_twice(
    algo: str, tmp_path: Path
) -> None:
    for name in ("first", "second"):
        assert new_trainer(tiny(algo, tmp_path / name, num_envs=16, steps=2048)).run()
    assert_equal_runs(tmp_path / "first", tmp_path / "second")


@pytest.mark.parametrize(("overlap", "ages"), [(True, [0, 1, 1, 1]), (False, [0] * 3)])
def test_overlap_acts_with_the_policy_of_one_round_before(
    overlap: bool, ages: list[int], tmp_path: Path
) -> None:
    config = tiny("sac", tmp_path / "run", overlap=overlap, steps=3 * ROLLOUT["sac"])
    trainer, rounds, known = new_trainer(config), [], []
    policy, update = trainer.parts.agent.policy, trainer.parts.agent.update
    trainer.parts.agent.policy = lambda: (known.append(len(rounds)), policy())[1]
    trainer.parts.agent.update = lambda batch: (update(batch), rounds.append(1))[0]
    assert trainer.run()
    assert [round_ - start for round_, start in enumerate(known)] == ages


def test_another_seed_gives_another_run(tmp_path) -> None:
    other = new_trainer(tiny("ppo", tmp_path / "other", seed=1))
    assert other.run()
    pairs = zip(choices(finished("ppo").folder), choices(other.folder), strict=True)
    assert all(one["eval/return"] != two["eval/return"] for one, two in pairs)


def test_a_table_starts_with_its_rows_and_may_get_new_columns(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    table = MetricsTable(path, [{"env_steps": 10, "a": 1.5}])
    table.add({"env_steps": 20, "a": 2.5, "b": 3})
    table.add({"env_steps": 30, "b": 4})
    assert [row["b"] for row in read_metrics(path)] == ["", "3", "4"]
    with path.open("a") as file:
        file.write("40,2")
    assert [row["env_steps"] for row in read_metrics(path)] == ["10", "20", "30"]


@pytest.mark.parametrize("content", [b"\xff\xfe\n", b"a" * 200_000 + b"\n1\n"])
def test_a_file_that_is_no_table_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    path.write_bytes(content)
    with pytest.raises(UserError, match=f"{path} is damaged"):
        read_metrics(path)


def test_faults_are_reported_counted_and_stored_and_a_run_continues(
    tmp_path: Path, capsys
) -> None:
    config = tiny("ppo", tmp_path / "run")
    for updates in (1, None):
        trainer = new_trainer(replace(config, resume=updates is None))
        pay_nan(trainer.parts.envs[0].batch.task, 2)
        if updates:
            stop_after(trainer, updates)
        assert trainer.run() is (updates is None)
        printed = capsys.readouterr().err
        assert "Reach: reward term 'near' of environment 2 is not finite" in printed
        assert printed.count("its episode is lost") == 1
    assert [row["faults"] for row in choices(config.folder)] == ["2"] * 3
    assert len(list((config.folder / "dumps").iterdir())) == 2


def pay_nan(task: Any, env_id: int) -> None:
    """Make the task's sixth reward from now NaN in one environment."""
    terms, number = task.reward_terms, iter(range(10_000))

    def with_nan(m: Any, reward: str) -> dict[str, np.ndarray]:
        values = terms(m, reward)
        if next(number) == 5:
            values["near"] = values["near"].copy()
            values["near"][env_id] = np.nan
        return values

    task.reward_terms = with_nan


@by_algorithm
def test_a_policy_is_what_the_agent_would_do(algo) -> None:
    run = finished(algo)
    policy = policy_of(
        run.parts.agent, run.config, run.parts.evaluator.env, run.state.env_steps
    )
    env = run.parts.evaluator.env
    state = env.observe()
    expected = run.parts.agent.actor.decide(state["observation"])
    assert torch.equal(policy(env.parts(state)), expected)
    assert policy.card.observation_dim == state["observation"].shape[1]
