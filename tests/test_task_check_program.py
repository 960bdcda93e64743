"""`manip check`: differences between a task and robosuite, and odd ranges."""

from dataclasses import replace

import numpy as np
import pytest
from scripted import ALL_TASKS

from manip.envs.task import Measures, Start
from manip.envs.task_registry import load_task
from manip.envs.waypoint_states import Yield
from manip.evaluation.task_problems import (
    open_task,
    range_problems,
    start_problems,
    step_problems,
)
from manip.evaluation.task_ranges import measure_ranges
from manip.programs import check
from manip.robot_config import RobotConfig
from manip.tasks.lift import Lift


class Slippery(Lift):
    """Moves the cube and sets a field in its start, which robosuite does not."""

    sensors = replace(
        Lift.sensors, fields={"cube_friction": ("geom_friction", "cube_g0")}
    )

    def sample_start(self, scene, streams) -> Start:
        start = super().sample_start(scene, streams)
        start.qpos[:, scene.free_qpos("cube_main").start] += 0.05
        return Start(start.qpos, {"cube_friction": np.full((len(streams), 3), 0.3)})

    def observe(self, m: Measures) -> dict[str, np.ndarray]:
        return {**super().observe(m), "odd": np.full((len(m["qpos"]), 1), 20.0)}


@pytest.mark.slow
def test_a_task_of_robosuite_has_no_problem(capsys: pytest.CaptureFixture) -> None:
    assert check.main(["Lift", "--episodes", "2"]) == 0
    assert "no problem" in capsys.readouterr().out


def test_what_only_the_native_side_does_is_reported() -> None:
    task = open_task(Slippery(), RobotConfig())
    starts = list(start_problems(task))
    assert len(starts) == 2
    assert "cube_pos" in starts[0]
    assert "cube_friction is (0.3, 0.3, 0.3) natively" in starts[1]
    assert list(step_problems(task)) == []
    ranges = measure_ranges(task.task, task.scene, 2)
    problems = list(range_problems(ranges.observations, ranges.terms, ranges.reward))
    assert problems == [
        "observation odd reaches 20: scale it to order one",
        "observation odd never changes",
    ]


def test_rewards_out_of_range_or_never_paid_are_reported() -> None:
    terms = {"reach": np.ones(3), "lift": np.zeros(3)}
    problems = list(range_problems({}, terms, np.array([0.0, 0.5, 1.2])))
    assert "lift was 0 in every step" in problems[0]
    assert "from 0 to 1.2" in problems[1]


def test_a_waypoint_with_too_few_states_is_reported() -> None:
    yields = {"grasp": Yield(128, 120, 100, 90), "lift": Yield(128, 120, 10, 2)}
    (problem,) = check.yield_problems(yields)
    assert "waypoint lift: training needs 256 states" in problem
    assert str(yields["lift"]).startswith("2 of 128 candidates are valid (2%)")


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_TASKS)
def test_every_task_agrees_with_robosuite(name: str) -> None:
    task = load_task(name)
    backends = open_task(task, RobotConfig())
    assert [*start_problems(backends), *step_problems(backends)] == []
