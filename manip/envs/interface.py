"""The interface of a batch's robot: what a policy measures, and what its actions do."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.observation_formulas import needed_measurements, observation_formulas
from manip.envs.task_batch import TaskBatch
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors

Number = float | str | list[float] | list[str]

ROBOT = {
    "joint_pos": ("rad", "joints", "angles of the joints of the arm"),
    "joint_vel": ("rad/s", "joints", "velocities of the joints of the arm"),
    "gripper_qpos": ("m or rad", "joints", "positions of the finger joints"),
    "gripper_qvel": ("m/s or rad/s", "joints", "velocities of the finger joints"),
    "gripper_closing": ("", "", "gripper command: -1 open, 1 closed, 0 at the start"),
    "eef_pos": ("m", "world", "position of the grip site"),
    "eef_mat": ("", "world", "rotation matrix of the grip site, row by row"),
    "hand_quat": ("", "world", "rotation of the hand body, quaternion wxyz"),
    "base_pos": ("m", "world", "position of the base frame of the controller"),
    "base_mat": ("", "world", "rotation matrix of the base frame of the controller"),
}
"""Measurement of the robot -> unit, frame, meaning."""


@dataclass(frozen=True)
class Interface:
    """How a policy's numbers relate to a robot; see `PolicyCard` for the fields."""

    measurements: dict[str, dict[str, str]] = field(default_factory=dict)
    formulas: dict[str, str] = field(default_factory=dict)
    control: dict[str, Number] = field(default_factory=dict)


def interface_of(batch: TaskBatch, parts: Sequence[str]) -> Interface:
    """The interface of some parts of a batch's observation.

    It is empty for tasks of other libraries, whose measurements are their own, and for
    two robots: `manip.deploy` drives one.
    """
    if not isinstance(batch, NativeBatch) or len(batch.scene.layout.robots) > 1:
        return Interface()
    read = batch.read()
    formulas = observation_formulas(batch.task, read)
    chosen = {name: text for name, text in formulas.items() if name in parts}
    control = _control(batch.scene, batch.robot.controller)
    names = {*needed_measurements(chosen), *_of_target(control)}
    shapes = {name: read[name].shape[1:] for name in names & read.keys()}
    shapes |= {"base_pos": (3,), "base_mat": (9,)}
    known = ROBOT | dict(_of_task(batch.task.sensors))
    return Interface(
        {n: _described(shapes[n], known.get(n, ("", "", n))) for n in sorted(names)},
        chosen,
        control,
    )


def _described(shape: Sequence[int], words: tuple[str, str, str]) -> dict[str, str]:
    unit, frame, meaning = words
    plain = re.sub(r"[^\w .,:/+()-]", "_", meaning, flags=re.ASCII)[:200]
    size = " ".join(map(str, shape))
    return {"shape": size, "unit": unit, "frame": frame, "meaning": plain}


def _control(scene: Scene, controller: str) -> dict[str, Number]:
    """What an action of 1 commands, in which frame, with which gains."""
    arm, gripper = scene.layout.only_robot("an interface")
    turns = ["rad"] * (len(arm.scale) if not arm.osc else len(arm.scale) - 3)
    control: dict[str, Number] = {
        "law": controller,
        "input_range": [-1.0, 1.0],
        "output_max": arm.scale.tolist(),
        "output_min": (-arm.scale).tolist(),
        "unit": [*(["m"] * 3 if arm.osc else []), *turns],
        "relative_to": "the pose when the action arrives",
        "frame": "base" if arm.osc else "joints",
        "kp": arm.kp,
        "kd": arm.kd,
    }
    if arm.osc and not arm.moves_base.any():  # otherwise base_pos must be measured
        data = scene.stock.sim.data
        control["base_pos"] = data.site_xpos[arm.base].tolist()
        control["base_mat"] = data.site_xmat[arm.base].ravel().tolist()
    if len(gripper.speed):
        control["gripper"] = "last number: above 0 closes, below 0 opens, 0 stays"
        control["gripper_speed"] = float(abs(gripper.speed).max())
    return control


def _of_target(control: dict[str, Any]) -> set[str]:
    """Measurements from which the runner computes the target of the controller."""
    if control["frame"] == "joints":
        return {"joint_pos"}
    moving = set() if "base_pos" in control else {"base_pos", "base_mat"}
    return {"eef_pos", "eef_mat", *moving}


def _of_task(sensors: Sensors) -> Iterator[tuple[str, tuple[str, str, str]]]:
    """Measurement of the task's sensors -> unit, frame, meaning."""
    for name, body in sensors.bodies.items():
        yield f"{name}_pos", ("m", "world", f"position of body {body}")
        yield f"{name}_quat", ("", "world", f"rotation of {body}, quaternion wxyz")
        yield f"{name}_linvel", ("m/s", "world", f"velocity of body {body}")
        yield f"{name}_angvel", ("rad/s", "body", f"angular velocity of {body}")
    for name, site in sensors.sites.items():
        yield f"{name}_pos", ("m", "world", f"position of site {site}")
    for name, joint in sensors.joints.items():
        yield f"{name}_qpos", ("rad or m", "joints", f"position of joint {joint}")
        yield f"{name}_qvel", ("rad/s or m/s", "joints", f"velocity of joint {joint}")
    for name, (first, second) in sensors.touches.items():
        yield name, ("", "", f"1 while {first} and {second} touch, else 0")
    for name, (first, second) in sensors.counts.items():
        yield name, ("", "", f"number of contacts of {first} with {second}")
    for name, site in sensors.forces.items():
        yield name, ("N", "site", f"force at site {site}")
    for name, (array, target) in sensors.fields.items():
        yield name, ("", "parent body", f"{array} of {target}")
