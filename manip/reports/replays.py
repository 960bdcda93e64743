"""The 3-D replay of recorded episodes: one scene with an animation for each."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from manip.envs.task_batch import TaskBatch
from manip.evaluation.episode_recording import RecordedEpisode
from manip.evaluation.episodes import Episode
from manip.io.glb import Motion, Node, Surface, write_glb
from manip.reports.recorded_episodes import RecordedEpisodes
from manip.sim.replay_scene import Part, PoseReader, replay_parts
from manip.sim.triangles import Triangles

Array = np.ndarray


@dataclass(frozen=True)
class Replays:
    """Episodes that can be replayed.

    Attributes:
        scene: binary glTF with an animation of each episode, named by its number.
        timelines: what happens in each episode, for the page's script: see `_timeline`.
    """

    scene: bytes
    timelines: list[dict[str, Any]]


def chosen_episodes(episodes: Sequence[Episode], count: int) -> list[Episode]:
    """At most `count` episodes in order: the first failures, and the first successes.

    Each kind gets half of the places, and those that the other does not need.
    """
    failed = [episode for episode in episodes if not episode.success_held]
    solved = [episode for episode in episodes if episode.success_held]
    share = max(count - count // 2, count - len(solved))
    chosen = failed[:share]
    chosen += solved[: count - len(chosen)]
    return sorted(chosen, key=lambda episode: episode.index)


def make_replays(record: RecordedEpisodes, count: int) -> Replays | None:
    """Make the replays of at most `count` episodes; None if no states are recorded."""
    chosen, recorder = chosen_episodes(record.episodes, count), record.recorder
    if recorder is None or not chosen:
        return None
    played, batch = [recorder.recorded(each) for each in chosen], recorder.batch
    model = played[0].model()
    reader = PoseReader(model)
    motions = {
        str(each.episode.index): _motion(each, batch.control_dt, reader)
        for each in played
    }
    nodes = [_node(part) for part in replay_parts(model)]
    timelines = [_timeline(each, batch) for each in played]
    return Replays(write_glb(nodes, motions), timelines)


def _motion(played: RecordedEpisode, control_dt: float, reader: PoseReader) -> Motion:
    times = np.arange(len(played.poses)) * control_dt
    return Motion(times, *reader.read(played.model(), played.poses))


def _node(part: Part) -> Node:
    """A part with its surfaces joined: one of the opaque, one of the transparent."""
    opaque = [each for each in part.surfaces if each[1][3] >= 1]
    clear = [each for each in part.surfaces if each[1][3] < 1]
    surfaces = [_joined(group) for group in (opaque, clear) if group]
    return Node(part.name, part.parent, surfaces)


def _joined(surfaces: Iterable[tuple[Triangles, Array]]) -> Surface:
    meshes, colours = zip(*surfaces, strict=True)
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    return Surface(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.repeat(colours, [len(mesh.positions) for mesh in meshes], axis=0),
        np.concatenate(
            [m.faces + start for m, start in zip(meshes, starts, strict=False)]
        ),
    )


def _timeline(played: RecordedEpisode, batch: TaskBatch) -> dict[str, Any]:
    """Number, length [s], outcome, reward of each step, and the spans of milestones.

    A span is [begin, end] in shares of the episode.
    """
    episode, names = played.episode, batch.task.milestone_names
    flags = dict(zip(names, played.milestones.T, strict=True))
    flags["success"] = played.success
    weights = np.array([*batch.reward_weights.values()])
    return {
        "number": episode.index,
        "seconds": round((episode.steps - 1) * batch.control_dt, 4),
        "outcome": outcome(episode),
        "reward": np.round(played.terms @ weights, 3).tolist(),
        "spans": {name: _spans(flag) for name, flag in flags.items()},
    }


def outcome(episode: Episode) -> str:
    """solved: success_held; lost: success before, but not at the end; else failed."""
    if episode.success_held:
        return "solved"
    return "lost" if episode.success_once else "failed"


def _spans(flags: Array) -> list[list[float]]:
    """Where flags [T] are true, as shares of T."""
    edges = np.flatnonzero(np.diff(np.r_[0, flags.astype(int), 0]))
    return np.round(edges.reshape(-1, 2) / len(flags), 4).tolist()
