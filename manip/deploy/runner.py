"""Turn measurements into commands for a robot, one control period after the other.

runner = Runner("lift.onnx")
command = runner.step({"joint_pos": ..., "eef_pos": ..., "cube_pos": ...})
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from manip.deploy.exported_policy import open_policy
from manip.deploy.formulas import evaluate, parse_formula

Array = np.ndarray


class Command(NamedTuple):
    """What to send to the robot's controllers for the next control period.

    Attributes:
        action: [A] in [-1, 1], what the policy chose.
        position, rotation: [3] m and [3, 3], the pose to reach with the grip site, in
            the frame of the arm's base; None where the controller takes other targets,
            or the hand's pose was not measured.
        joints: [n] rad to reach; None unless the controller takes joint positions.
        closing: in [-1, 1], how far the gripper is commanded to close.
    """

    action: Array
    position: Array | None
    rotation: Array | None
    joints: Array | None
    closing: float


class Runner:
    """Turn measurements into commands, one control period after the other.

    Args:
        path: a file of `manip export`, .onnx or .npz.

    Attributes:
        card: the policy's card; `card["measurements"]` says what to measure.
        closing: the gripper's command, which is 0 at the start of an episode.
    """

    def __init__(self, path: str) -> None:
        self.card, self._act = open_policy(path)
        self.parts = self.card["observation"]
        formulas = self.card["formulas"]
        vectors = [p["name"] for p in self.parts if p["role"] != "camera"]
        if missing := [name for name in vectors if name not in formulas]:
            raise ValueError(f"the card has no formula for {', '.join(missing)}")
        self._formulas = {name: parse_formula(formulas[name]) for name in vectors}
        self.reset()

    def reset(self) -> None:
        """Begin an episode: the gripper is half open."""
        self.closing = 0.0

    def observe(self, measured: Mapping[str, Any]) -> dict[str, Array]:
        """Part of the observation -> numbers float32, or a camera's image uint8.

        Raises:
            ValueError: a measurement is missing, of another shape, not finite, or no
                image of whole numbers from 0 to 255.
        """
        values: dict[str, Array] = {"gripper_closing": np.array(self.closing)}
        for name, expected in self.card["measurements"].items():
            if name in measured:
                values[name] = np.asarray(measured[name], np.float64)
            elif name not in values:
                raise ValueError(f"{name} is missing: {expected['meaning']}")
            shape = " ".join(map(str, np.shape(values[name])))
            if shape != expected["shape"] or not np.isfinite(values[name]).all():
                raise ValueError(
                    f"{name} must be finite numbers of shape [{expected['shape']}] in "
                    f"{expected['unit'] or '0 to 1'}, not {measured[name]!r}"
                )
        return {p["name"]: self._part(p, values, measured) for p in self.parts}

    def _part(
        self, part: Mapping[str, Any], values: Mapping[str, Array], measured: Any
    ) -> Array:
        name = part["name"]
        if part["role"] == "camera":
            if name not in measured:
                raise ValueError(f"{name} is missing: uint8 {part['shape']}")
            return _image(name, measured[name], part["shape"])
        numbers = np.asarray(evaluate(self._formulas[name], values), np.float32)
        return numbers.reshape(part["shape"])

    def act(self, parts: Mapping[str, Array]) -> Array:
        """The action [A] in [-1, 1] for the parts of an observation."""
        cameras = [p["name"] for p in self.parts if p["role"] == "camera"]
        vector = [parts[name].ravel() for name in self._formulas]
        joined = np.concatenate([np.zeros(0, np.float32), *vector])
        action = self._act(joined[None], *(parts[name][None] for name in cameras))[0]
        return np.clip(action, -1.0, 1.0)

    def step(self, measured: Mapping[str, Any]) -> Command:
        """The command for one control period, from what is measured at its start."""
        action = self.act(self.observe(measured))
        control = self.card["control"]
        if control.get("gripper_speed"):
            moved = self.closing + control["gripper_speed"] * np.sign(action[-1])
            self.closing = float(np.clip(moved, -1.0, 1.0))
        return Command(action, *self._target(action, measured), self.closing)

    def _target(
        self, action: Array, measured: Mapping[str, Any]
    ) -> tuple[Array | None, Array | None, Array | None]:
        control = self.card["control"]
        output = np.array(control["output_max"]) if control else np.zeros(0)
        motion = output * action[: len(output)]
        if self.card["controller"] == "JOINT_POSITION":
            return None, None, np.asarray(measured["joint_pos"]) + motion
        base = {
            key: measured.get(key, control.get(key)) for key in ("base_pos", "base_mat")
        }
        if base["base_mat"] is None or not {"eef_pos", "eef_mat"} <= measured.keys():
            return None, None, None
        turn = np.reshape(base["base_mat"], (3, 3))
        away = np.asarray(measured["eef_pos"]) - np.asarray(base["base_pos"])
        rotation = turn.T @ np.reshape(measured["eef_mat"], (3, 3))
        if len(motion) == 6:
            rotation = rotation_of(motion[3:]) @ rotation
        return turn.T @ away + motion[:3], rotation, None


def _image(name: str, value: Any, shape: list[int]) -> Array:
    """The image [H, W, C] as uint8; other arrays are refused, not converted."""
    image = np.asarray(value)
    pixels = image.dtype.kind in "iu" and image.shape == tuple(shape)
    if not pixels or image.min() < 0 or image.max() > 255:
        raise ValueError(
            f"{name} must be whole numbers from 0 to 255 of shape {shape}, not "
            f"{image.dtype} of shape {[*image.shape]}"
        )
    return image.astype(np.uint8)


def rotation_of(vector: Array) -> Array:
    """[3, 3], the rotation about `vector` [3] by its length [rad] (Rodrigues)."""
    angle = np.linalg.norm(vector) or 1.0
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
