"""How a robot moves in an episode: speeds, torques, jerks, changes of the action."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Array = np.ndarray


class ArmLimits(NamedTuple):
    """Limits of each joint.

    Attributes:
        speed: [rad/s], as the maker states it.
        torque: [N m], as robosuite's model of the arm has it.
        jerk: [rad/s^3], as the maker states it; empty where none is stated.
    """

    speed: tuple[float, ...]
    torque: tuple[float, ...]
    jerk: tuple[float, ...] = ()


ARM_LIMITS = {
    "Panda": ArmLimits(
        speed=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
        torque=(80, 80, 80, 80, 80, 12, 12),
        jerk=(7500, 3750, 5000, 6250, 7500, 10000, 10000),
    ),
    "Sawyer": ArmLimits(
        speed=(1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545),
        torque=(80, 80, 40, 40, 9, 9, 9),
    ),
    "IIWA": ArmLimits(
        speed=(1.48, 1.48, 1.75, 1.31, 2.27, 2.36, 2.36),
        torque=(176, 176, 110, 110, 110, 40, 40),
    ),
    "Kinova3": ArmLimits(
        speed=(1.39, 1.39, 1.39, 1.39, 1.22, 1.22, 1.22),
        torque=(32, 32, 32, 32, 32, 13, 13),
    ),
    "Jaco": ArmLimits(
        speed=(0.63, 0.63, 0.63, 0.63, 0.84, 0.84, 0.84),
        torque=(30.5, 30.5, 30.5, 30.5, 30.5, 6.8, 6.8),
    ),
    "XArm7": ArmLimits(speed=(3.14,) * 7, torque=(80,) * 7),
}
"""Speeds and jerks from data sheets: Franka Emika (libfranka, limits of the Panda),
Rethink (Sawyer, URDF), KUKA (LBR iiwa 14 R820: 85, 85, 100, 75, 130, 135, 135
degree/s), Kinova (Gen3: 80 and 70 degree/s; Jaco: 36 and 48 degree/s), UFACTORY (xArm
7: 180 degree/s)."""


@dataclass(frozen=True)
class Motion:
    """Motion of one episode; values for each joint of the arm, or of both arms.

    Attributes:
        peak_speed: largest speed [rad/s], over all substeps.
        peak_torque: largest torque of the motor [N m], over all substeps.
        peak_jerk: largest jerk [rad/s^3], second difference of the speeds at the ends
            of the control steps.
        action_change: mean over steps and numbers of |a_t - a_(t-1)|, clipped actions.
        hand_tilt: largest angle between a tool and straight down [rad].
        self_contact: share of the steps in which an arm touches itself or its hand.
    """

    peak_speed: tuple[float, ...]
    peak_torque: tuple[float, ...]
    peak_jerk: tuple[float, ...]
    action_change: float
    hand_tilt: float
    self_contact: float

    def columns(self) -> dict[str, float]:
        """Name -> value, as in episodes.csv; joints are numbered from 1."""
        peaks = {
            f"{name}/{joint}": value
            for name in ("peak_speed", "peak_torque", "peak_jerk")
            for joint, value in enumerate(getattr(self, name), start=1)
        }
        single = ("action_change", "hand_tilt", "self_contact")
        return peaks | {name: getattr(self, name) for name in single}


class MotionTracker:
    """Accumulate the motion of N episodes.

    Args:
        num_envs: N.
        control_dt: control period [s].
    """

    def __init__(self, num_envs: int, control_dt: float) -> None:
        self._dt = control_dt
        self._rows: list[list[Mapping[str, Array]]] = [[] for _ in range(num_envs)]

    def update(self, action: Array, motion: Mapping[str, Array]) -> None:
        """Add a step: actions [N, A], and what `TaskBatch.motion` returned after it."""
        named = {"action": np.clip(action, -1, 1), **motion}
        for env_id, rows in enumerate(self._rows):
            rows.append({name: values[env_id] for name, values in named.items()})

    def finish(self, env_id: int) -> Motion:
        """The motion of an environment's episode, which has ended."""
        rows, self._rows[env_id] = self._rows[env_id], []
        named = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        still = np.zeros((1, named["joint_vel"].shape[1]))
        jerk = np.diff(np.concatenate([still, named["joint_vel"]]), 2, axis=0)
        change = np.abs(np.diff(named["action"], axis=0))
        return Motion(
            peak_speed=_largest(named["peak_speed"]),
            peak_torque=_largest(named["peak_torque"]),
            peak_jerk=_largest(np.abs(jerk) / self._dt**2),
            action_change=float(change.mean()) if change.size else 0.0,
            hand_tilt=float(named["hand_tilt"].max()),
            self_contact=float(named["self_contact"].mean()),
        )


def _largest(values: Array) -> tuple[float, ...]:
    """[n] of values [T, n]; 0 without steps."""
    return tuple(map(float, values.max(axis=0, initial=0.0)))


def share_of_limits(motion: Motion, arm: str) -> dict[str, float]:
    """Largest share of the arm's limits over its joints: speed, torque, jerk if known.

    Empty for an arm whose limits are not known.
    """
    limits = ARM_LIMITS.get(arm)
    peaks = zip(
        limits._fields if limits else (),
        (motion.peak_speed, motion.peak_torque, motion.peak_jerk),
        limits or (),
        strict=False,
    )
    return {
        name: float(np.divide(np.reshape(peak, (-1, len(most))), most).max())
        for name, peak, most in peaks
        if most
    }
