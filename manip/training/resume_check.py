"""Check that a checkpoint fits a run, before it is restored."""

from dataclasses import replace
from typing import Any

import torch

from manip.agents.agent import Agent
from manip.envs.adapters.torchrl import TaskEnv
from manip.training.agent_state import state_of, unfit
from manip.training.build import build_agent
from manip.training.collector import Collector
from manip.training.config import TrainConfig
from manip.training.experience import plain
from manip.training.run_state import episode_of
from manip.training.state_check import (
    check_finite,
    check_keys,
    check_like,
    check_optimiser,
    check_rows,
    check_steps,
)


class ResumeCheck:
    """Compare the state of a checkpoint with that of a new run.

    Args:
        config: options of the run.
        env: environments of the kind that the agent is built for.
        agent, collector: of the run, before anything is restored.
    """

    def __init__(
        self, config: TrainConfig, env: TaskEnv, agent: Agent, collector: Collector
    ) -> None:
        self._config, self._env = config, env
        self._agent, self._collector = agent, collector
        self._milestones = len(env.batch.task.milestone_names)

    def __call__(self, state: dict[str, Any]) -> None:
        """Check keys, types, shapes, dtypes and ranges of a state.

        Raises:
            UserError: the state does not fit the run.
        """
        new = state_of(self._agent, self._collector, buffer=True)
        try:
            check_keys({k: v for k, v in state.items() if k in new}, new, "checkpoint")
            check_like(state["modules"], new["modules"], "modules")
            check_finite(state["modules"], new["modules"], "modules")
            check_like(state["torch_rng"], new["torch_rng"], "torch_rng")
            self._check_optimisers(state["optimisers"])
            self._check_agent(state["agent"], new["agent"])
            self._check_collector(state["collector"], new["collector"])
        except Exception as error:  # odd values may lead to any
            raise unfit(error) from error

    def _check_optimisers(self, states: dict[str, Any]) -> None:
        optimisers = self._agent.optimisers()
        check_keys(states, optimisers, "optimisers")
        for name, optimiser in optimisers.items():
            check_optimiser(states[name], optimiser, f"optimisers/{name}")

    def _check_agent(self, state: dict[str, Any], new: dict[str, Any]) -> None:
        """Check what an agent stores besides its networks, with its replay buffer."""
        check_keys(state, new, "agent")
        filled = new
        if "buffer" in new:
            filled = new | self._filled_agent().extra_state()
        for name, expected in filled.items():
            value = state[name]
            if name == "buffer" and value is None:
                continue
            if name == "buffer" or _shape(new[name]) != _shape(expected):
                check_rows(value, expected, f"agent/{name}")
            else:
                check_like(value, expected, f"agent/{name}")
        self._check_buffer(state)

    def _check_buffer(self, state: dict[str, Any]) -> None:
        buffer = state.get("buffer")
        rows = 0 if buffer is None else check_rows(buffer, buffer, "agent/buffer")
        capacity = getattr(self._config.agent, "buffer_size", 0)
        _check_range("rows of agent/buffer", rows, capacity)
        _check_range("agent/cursor", state.get("cursor", 0), capacity)
        _check_range("agent/owed", state.get("owed", 0), 1)

    def _filled_agent(self) -> Agent:
        """An agent like the run's that has stored one rollout, of zeros."""
        batch = self._collector.example().batch
        options: Any = self._config.agent  # of an algorithm with a replay buffer
        options = replace(options, buffer_size=max(1, batch.numel()))
        agent = build_agent(replace(self._config, agent=options), self._env)
        agent.update(batch)
        return agent

    def _check_collector(self, state: dict[str, Any], new: dict[str, Any]) -> None:
        pending, trackers = state["pending"], new["trackers"]
        for tracker, saved in zip(trackers, state["trackers"], strict=True):
            tracker["milestones"] = self._milestones_of(tracker, saved)
        self._check_envs(state["envs"], new["envs"])
        check_like(state | {"pending": [], "envs": []}, new | {"envs": []}, "collector")
        _check_range("rollouts of collector", len(pending), len(new["envs"]))
        for number, rollout in enumerate(pending):
            self._check_pending(rollout, f"collector/pending/{number}")

    def _check_envs(self, states: list[Any], new: list[dict[str, Any]]) -> None:
        """Check environments; `actions` has a row for each step of an episode."""
        for number, (state, own) in enumerate(zip(states, new, strict=True)):
            name = f"collector/envs/{number}"
            check_keys(state, own, name)
            for key, expected in own.items():
                check = check_steps if key == "actions" else check_like
                check(state[key], expected, f"{name}/{key}")

    def _milestones_of(self, new: dict[str, Any], saved: dict[str, Any]) -> Any:
        """Milestones [N, M] of episodes under way; None before the first step."""
        if saved["milestones"] is None:
            return None
        return torch.zeros(len(new["counters"][0]), self._milestones, dtype=torch.bool)

    def _check_pending(self, rollout: dict[str, Any], name: str) -> None:
        expected = plain(self._collector.example())
        check_like(rollout | {"episodes": []}, expected, name)
        if rollout["dimensions"] != expected["dimensions"]:
            raise ValueError(f"{name}/dimensions must be {expected['dimensions']}")
        _check_range(f"{name}/steps", rollout["steps"], expected["steps"])
        for episode in rollout["episodes"]:
            episode_of(episode, self._milestones)


def _shape(value: Any) -> Any:
    return getattr(value, "shape", None)


def _check_range(name: str, value: float, most: float) -> None:
    if not 0 <= value <= most:
        raise ValueError(f"{name} must be from 0 to {most}, not {value}")
