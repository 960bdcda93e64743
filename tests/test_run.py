"""train(): one call that trains, in any thread, with callback, reward and stop."""

import signal
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest
import torch
from tensordict import TensorDictBase
from training_runs import (
    assert_equal_runs,
    choices,
    finished,
    new_trainer,
    timeless,
    tiny,
)

from manip.errors import UserError
from manip.training.progress import Progress
from manip.training.run import train, train_or_resume
from manip.training.run_logs import read_metrics


def test_train_returns_the_result_of_its_run(tmp_path: Path) -> None:
    config = tiny("ppo", tmp_path / "run")
    result = train(config)
    assert (result.folder, result.env_steps, result.finished) == (config.out, 512, True)
    assert result.policy == config.out / "policy"
    assert result.seconds > 0
    best = max(
        choices(config.out),
        key=lambda r: (float(r["eval/success_held"]), float(r["eval/return"])),
    )
    assert result.success == {
        kind: float(best[f"eval/{kind}"])
        for kind in ("success_once", "success_at_end", "success_held")
    }
    assert_equal_runs(finished("ppo").folder, config.out)
    assert (config.out / "learning_curve.png").stat().st_size > 10_000


def test_train_works_in_another_thread(tmp_path: Path) -> None:
    config, results = tiny("ppo", tmp_path / "run"), []
    before = signal.getsignal(signal.SIGTERM)
    thread = Thread(target=lambda: results.append(train(config)))
    thread.start()
    thread.join()
    assert results[0].finished
    assert signal.getsignal(signal.SIGTERM) == before
    assert_equal_runs(finished("ppo").folder, config.out)


def test_the_callback_gets_a_report_after_every_rollout(tmp_path: Path) -> None:
    reports: list[Progress] = []
    train(tiny("ppo", tmp_path / "run"), callback=reports.append)
    steps = [report.env_steps for report in reports]
    assert steps == sorted(steps)
    assert set(steps) == set(range(64, 513, 64))
    messages = [message for report in reports for message in report.messages]
    choosing = [m for m in messages if m.startswith("step") and "(4" not in m]
    assert [m.split()[1] for m in choosing] == ["192", "384", "512"]
    assert any("(4 episodes)" in message for message in messages)
    assert messages[-1].startswith("checkpoint:")
    assert {report.total_steps for report in reports} == {512}
    assert "train/return" in reports[-1].averages


def test_the_stop_event_ends_a_run_that_goes_on_bit_for_bit(tmp_path: Path) -> None:
    config, stop = tiny("sac", tmp_path / "run"), Event()

    def stop_later(progress: Progress) -> None:
        if progress.env_steps >= 256:
            stop.set()

    result = train(config, callback=stop_later, stop=stop)
    assert (result.env_steps, result.finished) == (256, False)
    assert train_or_resume(config).finished
    assert_equal_runs(finished("sac").folder, config.out)


def test_a_run_stopped_before_it_began_is_saved_and_has_no_success(
    tmp_path: Path,
) -> None:
    stop = Event()
    stop.set()
    config = tiny("ppo", tmp_path / "run")
    result = train(config, stop=stop)
    assert (result.env_steps, result.finished, result.success) == (0, False, {})
    assert train(replace(config, resume=True)).finished
    assert_equal_runs(finished("ppo").folder, config.out)


def test_train_leaves_torch_threads_as_they_were(tmp_path: Path) -> None:
    torch.set_num_threads(3)
    threads = []
    try:
        train(
            tiny("ppo", tmp_path / "run", steps=64),
            callback=lambda _: threads.append(torch.get_num_threads()),
        )
        assert torch.get_num_threads() == 3
        with pytest.raises(UserError, match="already holds a run"):
            train(tiny("ppo", tmp_path / "run"))
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(1)
    assert set(threads) == {1}


@pytest.mark.parametrize("config", [None, {"task": "Reach"}, "Reach"])
def test_a_config_of_another_kind_is_refused(config) -> None:
    with pytest.raises(UserError, match="config must be a TrainConfig"):
        train(config)


def test_train_leaves_torchs_random_numbers_as_they_were(tmp_path: Path) -> None:
    before = torch.get_rng_state()
    train(tiny("ppo", tmp_path / "run", steps=64))
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.slow
def test_a_stop_in_the_last_report_leaves_a_finished_run(tmp_path: Path) -> None:
    config, stop = tiny("ppo", tmp_path / "run", steps=64), Event()

    def stop_at_the_end(progress: Progress) -> None:
        if progress.env_steps == progress.total_steps:
            stop.set()

    result = train(config, callback=stop_at_the_end, stop=stop)
    assert (result.env_steps, result.finished) == (64, True)


class Paid:
    """A reward function that stores what it is given and pays a constant."""

    def __init__(self, value: float) -> None:
        self.value, self.shapes = value, []

    def __call__(self, rollout: TensorDictBase) -> torch.Tensor:
        self.shapes.append((*rollout.shape, rollout["next", "reward_terms"].shape[-1]))
        return torch.full_like(rollout["next", "reward"], self.value)


def test_the_agent_learns_from_the_reward_function(tmp_path: Path) -> None:
    config, learned, reward = tiny("sac", tmp_path / "run"), [], Paid(0.25)
    trainer = new_trainer(config, reward)
    update = trainer.parts.agent.update

    def recorded(batch: TensorDictBase) -> dict[str, float]:
        learned.append(batch["next", "reward"].unique().tolist())
        return update(batch)

    trainer.parts.agent.update = recorded
    assert trainer.run()
    assert set(map(tuple, learned)) == {(0.25,)}
    assert set(reward.shapes) == {(4, 8, 2)}
    returns = [row["train/return"] for row in timeless(config.out)]
    assert returns != [row["train/return"] for row in timeless(finished("sac").folder)]


@pytest.mark.parametrize(
    ("reward", "message"),
    [
        (lambda r: r["next", "reward"][:, :1], r"Tensor \[4, 1, 1\], not"),
        (lambda r: 1.0, r"float \[\], not a tensor \[4, 16, 1\]"),
        (Paid(float("nan")), "numbers that are not finite"),
        (lambda r: r["next", "reward"] + 1j, "not finite or not real"),
    ],
)
def test_a_reward_of_another_form_is_refused(reward, message, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=f"the reward function returned .*{message}"):
        train(tiny("ppo", tmp_path / "run"), reward=reward)


def test_reward_terms_are_logged_as_weighted_contributions(tmp_path: Path) -> None:
    config = tiny("ppo", tmp_path / "run", steps=192, agent={"rollout_length": 16})
    trainer, rewards = new_trainer(config), []
    collect = trainer.parts.collector.next
    trainer.parts.collector.next = lambda: (e := collect(), rewards.append(e))[0]
    assert trainer.run()
    row = read_metrics(config.out / "metrics.csv")[-1]
    terms = [float(v) for k, v in row.items() if k.startswith("train/reward/")]
    paid = [e.batch["next", "reward"].mean().item() for e in rewards]
    assert len(terms) == 2
    assert sum(terms) == pytest.approx(sum(paid) / len(paid), rel=1e-5)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (["lift"], "reward weight 'lift' must be a name and a number, as in lift=0.6"),
        (["lift=a"], "reward weight 'lift=a' must be a name and a number"),
        (["near=nan"], "reward weight 'near=nan' must be a name and a number"),
        (["near=1", "near=2"], "reward weight 'near' is given twice"),
    ],
)
def test_wrong_reward_weights_are_refused(weights, message, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        tiny("ppo", tmp_path, reward_weights=weights)
