"""Generate the states of a task's waypoints: by kinematics, checked by the engine.

A candidate of `Task.sample_waypoint` becomes a state in four steps:

1. Inverse kinematics bring the tool to its pose, with the gripper open.
2. Nothing may penetrate anything by more than `DEEPEST`.
3. If the waypoint is closed, the gripper closes without gravity, so that an object in
   the air stays between the fingers. A slow gripper stops once the milestone has lasted
   for `GRIP_STEPS` control steps: closing fully, it squeezes the object out.
4. With gravity, the arm stays for `HOLD_STEPS` control steps. In the second half of
   them the milestone must be reached all the time, and the task's success never.

The state after the last step is complete: velocities, contacts and commands are the
engine's own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_streams import TRAINING, EpisodeStreams
from manip.envs.task import Task, Waypoint
from manip.envs.task_check import check_waypoint, check_waypoint_names
from manip.envs.task_errors import blamed
from manip.envs.waypoint_starts import WaypointStates
from manip.errors import UserError
from manip.sim.engine import Snapshot
from manip.sim.inverse_kinematics import InverseKinematics
from manip.sim.placed_states import open_gripper, penetration, weightless
from manip.sim.scene import Scene

Array = np.ndarray

STATES = 256
"""States of each waypoint."""
CANDIDATES = 64
"""Candidates that are tried at a time."""
ROUNDS = 40
"""Rounds of candidates after which a waypoint that has too few states is an error."""
DEEPEST = 0.001
"""Deepest penetration [m] of a candidate, before the gripper closes."""
GRIP_STEPS = 20
"""Control steps for which the milestone must last before the gripper stops closing."""
SPARE_STEPS = 4
"""Control steps for which the gripper goes on closing once it is commanded fully."""
HOLD_STEPS = 10
"""Control steps for which the state must last under gravity."""
FIRST_FAMILY = 2
"""Family of random streams of the first waypoint; each waypoint has its own."""


@dataclass(frozen=True)
class Yield:
    """How many candidates of a waypoint were tried, and passed each check.

    Attributes:
        tried: candidates.
        reached: the arm reaches the tool's pose.
        free: of these, nothing penetrates.
        valid: of these, the milestone lasts on the engine.
    """

    tried: int = 0
    reached: int = 0
    free: int = 0
    valid: int = 0

    def __add__(self, other: "Yield") -> "Yield":
        return Yield(
            self.tried + other.tried,
            self.reached + other.reached,
            self.free + other.free,
            self.valid + other.valid,
        )

    def enough_for(self, number: int, rounds: int) -> bool:
        """Whether as many rounds of such candidates would give a number of states."""
        return self.valid * rounds * CANDIDATES >= number * self.tried

    def __str__(self) -> str:
        share = self.valid / max(1, self.tried)
        return (
            f"{self.valid} of {self.tried} candidates are valid ({share:.0%}): the arm "
            f"reaches {self.reached}, {self.free} of these do not penetrate, and "
            f"{self.valid} of these last"
        )


class Trial(NamedTuple):
    """Valid states of a round, and its counts."""

    snapshot: Snapshot
    counts: Yield


class WaypointMaker:
    """Try out candidates of a task's waypoints.

    Args:
        task: it must have waypoints.
        scene: of the environments that the states are for.
        seed: of the random streams.
        threads: native threads; the CPUs this process may use by default.

    Raises:
        UserError: the task has no waypoints, a wrong name among them, or two robots.
    """

    def __init__(
        self, task: Task, scene: Scene, seed: int, threads: int | None = None
    ) -> None:
        check_waypoint_names(task)
        self._task, self._scene, self._seed = task, scene, seed
        self._robot = scene.layout.only_robot("generating waypoints")
        self._kinematics = InverseKinematics(scene)
        self._fingers, self._command = open_gripper(scene)
        scenes = weightless(scene), scene
        self._floating, self._heavy = (
            NativeBatch(task, CANDIDATES, scene=each, threads=threads, seed=seed)
            for each in scenes
        )
        everywhere = np.arange(CANDIDATES)
        self._floating.begin(everywhere)
        self._heavy.begin(everywhere)

    def make(self, milestone: str, number: int) -> tuple[Snapshot, Yield]:
        """Valid states of one waypoint, and how many candidates they took.

        Raises:
            UserError: too few candidates are valid.
        """
        trials: list[Trial] = []
        counts = Yield()
        while counts.valid < number:
            if len(trials) == ROUNDS:
                raise UserError(
                    f"task {self._task.name!r}: waypoint {milestone!r} gives too few "
                    f"states, {number} are needed: {counts}. Mend sample_waypoint, "
                    "or leave its name out of waypoint_names"
                )
            trials.append(self.try_out(milestone, len(trials)))
            counts += trials[-1].counts
        states = np.concatenate([trial.snapshot.states for trial in trials])
        readings = np.concatenate([trial.snapshot.readings for trial in trials])
        return Snapshot(states[:number], readings[:number]), counts

    def measure(self, milestone: str, rounds: int) -> Yield:
        """What becomes of some rounds of candidates of one waypoint."""
        trials = (self.try_out(milestone, number) for number in range(rounds))
        return sum((trial.counts for trial in trials), Yield())

    def try_out(self, milestone: str, number: int) -> Trial:
        """Try round `number` of candidates of one waypoint."""
        with blamed(self._task):
            waypoint = self._sample(milestone, number)
        start = waypoint.start
        qpos = start.qpos.copy()
        qpos[:, self._scene.layout.finger_qpos[0]] = self._fingers
        pose = waypoint.tool_pos, waypoint.tool_mat
        reached = self._kinematics.solve(qpos, *pose)
        depth = penetration(self._scene, qpos, start.fields)
        free = reached & (depth < DEEPEST)
        self._place(waypoint, qpos)
        if waypoint.closed:
            self._close(milestone)
        valid = free & self._lasting(milestone, waypoint.closed)
        flags = np.ones(CANDIDATES, bool), reached, free, valid
        counts = Yield(*(int(each.sum()) for each in flags))
        return Trial(self._heavy.engine.save(np.flatnonzero(valid)), counts)

    def _sample(self, milestone: str, number: int) -> Waypoint:
        family = FIRST_FAMILY + self._task.waypoint_names.index(milestone)
        candidates, rounds = np.arange(CANDIDATES), np.full(CANDIDATES, number)
        streams = EpisodeStreams(self._seed, candidates, rounds, TRAINING, family)
        waypoint = self._task.sample_waypoint(milestone, self._scene, streams)
        check_waypoint(self._task, self._scene, waypoint, CANDIDATES)
        return waypoint

    def _place(self, waypoint: Waypoint, qpos: Array) -> None:
        """Set the candidates' states, with the gripper open."""
        start, joints = waypoint.start, self._scene.layout.joint_qpos
        self._floating.engine.set_state(
            np.arange(CANDIDATES),
            qpos,
            np.zeros((CANDIDATES, self._scene.physics.nv)),
            start_pos=start.qpos[:, joints],
            gripper_command=np.tile(self._command, (CANDIDATES, 1)),
            fields=start.fields,
        )

    def _close(self, milestone: str) -> None:
        """Close the grippers without gravity: fully, or until the milestone lasts."""
        lasted = np.zeros(CANDIDATES, int)
        for _ in range(self._closing_steps()):
            step = self._floating.step(self._action(lasted < GRIP_STEPS))
            lasted = np.where(step.milestones[milestone], lasted + 1, 0)
            if (lasted >= GRIP_STEPS).all():
                break

    def _lasting(self, milestone: str, closed: bool) -> Array:
        """[n] bool: with gravity, the milestone lasts."""
        self._heavy.engine.restore(self._floating.engine.save())
        action = self._action(1.0 if closed else -1.0)
        lasting = np.ones(CANDIDATES, bool)
        for number in range(HOLD_STEPS):
            step = self._heavy.step(action)
            if number >= HOLD_STEPS // 2:
                lasting &= step.milestones[milestone] & ~step.success
        return lasting & ~self._heavy.engine.broken

    def _action(self, gripper: Array | float) -> Array:
        """[n, A]: the arm waits; `gripper` [n] or a number for all of them."""
        action = np.zeros((CANDIDATES, self._floating.action_dim))
        action[:, len(self._robot.arm.scale) :] = np.reshape(gripper, (-1, 1))
        return action

    def _closing_steps(self) -> int:
        """Control steps in which the gripper's command goes from open to closed."""
        speed = np.abs(self._robot.gripper.speed).min(initial=1.0)
        return int(np.ceil(2 / speed)) + SPARE_STEPS


def measure_yields(task: Task, scene: Scene, rounds: int = 2) -> dict[str, Yield]:
    """Waypoint -> what became of some rounds of candidates; empty without waypoints.

    Raises:
        UserError: a waypoint is no milestone, or its states are impossible.
    """
    if not task.waypoint_names:
        return {}
    maker = WaypointMaker(task, scene, seed=0)
    return {name: maker.measure(name, rounds) for name in task.waypoint_names}


def make_waypoint_states(
    task: Task,
    scene: Scene,
    seed: int,
    threads: int | None = None,
    report: Callable[[str], object] = lambda _: None,
) -> WaypointStates:
    """Generate the states of all waypoints of a task.

    Args:
        task, scene, seed, threads: as in `WaypointMaker`.
        report: called with a line about each waypoint, once it is done.

    Raises:
        UserError: the task has no waypoints, or one of them gives too few states.
    """
    maker = WaypointMaker(task, scene, seed, threads)
    snapshots = []
    for milestone in task.waypoint_names:
        snapshot, counts = maker.make(milestone, STATES)
        snapshots.append(snapshot)
        report(f"waypoint {milestone}: {counts}")
    return WaypointStates(
        task.waypoint_names,
        np.stack([snapshot.states for snapshot in snapshots]),
        np.stack([snapshot.readings for snapshot in snapshots]),
    )
