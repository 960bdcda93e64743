"""Wipe's dirt: how robosuite lays it out, and when it counts as wiped."""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures

Array = np.ndarray

MARKERS = 100
"""Number of markers (robosuite/environments/manipulation/wipe.py)."""
EDGE = 0.6 * np.array([0.25, 0.4]) - 0.02
"""Half widths [m] of the part of the table where markers lie (ibid.)."""
STRIDE, BEND, STRAIGHT = 0.005, 0.5, 0.7
"""Distance [m] of two markers, standard deviation [rad] of a turn, and how probable it
is that there is none (robosuite/models/arenas/wipe_arena.py)."""
TURNS = 128
"""Turns drawn for each marker, of which the first that stays on the table is taken."""
THICK = 0.02
"""Height [m] above the wiper's face, below which a marker is wiped (wipe.py)."""


def walk(streams: EpisodeStreams) -> Array:
    """[100, n, 2] m from the table's centre: where markers lie, in turn."""
    direction = streams.uniform(-np.pi, np.pi, 1)[:, 0]
    place = streams.uniform(-EDGE, EDGE, 2)
    bends = streams.uniform(0, 1, MARKERS).T > STRAIGHT
    turn = streams.normal(BEND, MARKERS * TURNS).reshape(-1, MARKERS, TURNS)
    places = [place]
    for i in range(1, MARKERS):
        options = np.cumsum(turn[:, i], axis=1)
        options -= np.where(bends[i], 0, options[:, 0])[:, None]
        direction, place = _stride(place, direction[:, None] + options)
        places.append(place)
    return np.array(places)


def _stride(place: Array, directions: Array) -> tuple[Array, Array]:
    """The first direction [n] of some [n, k] that stays on the table, and where to."""
    ways = np.stack([np.sin(directions), np.cos(directions)], axis=2)
    reached = place[:, None] + STRIDE * ways
    first = (np.abs(reached) < EDGE).all(axis=2).argmax(axis=1)
    rows = np.arange(len(place))
    return directions[rows, first], reached[rows, first]


def below(marks: Array, m: Measures) -> Array:
    """[N, 100] bool: markers [N, 100, 3] over the wiper's face, as robosuite tests."""
    origin = m["corner2_pos"]
    u, v = _unit(m["corner1_pos"] - origin), _unit(m["corner4_pos"] - origin)
    height = np.einsum("nki,ni->nk", marks - origin[:, None], _unit(np.cross(u, v)))
    corners = np.stack([m[f"corner{i}_pos"] - origin for i in (1, 2, 4, 3, 1)], axis=1)
    face, points = _flat(corners, u, v), _flat(marks - origin[:, None], u, v)
    inside: Array = (height > 0) & (height < THICK)
    for side in range(4):
        a, b = face[:, side, None], face[:, side + 1, None]
        inside = inside & (_cross(b - a, points - a) < 0)
    return inside


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _flat(points: Array, u: Array, v: Array) -> Array:
    """[N, k, 2]: points [N, k, 3] along two axes [N, 3]."""
    along = [np.einsum("nki,ni->nk", points, axis) for axis in (u, v)]
    return np.stack(along, axis=2)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def left(offsets: Array, dirty: Array) -> dict[str, Array]:
    """Of offsets [N, 100, 3] the `dirty` [N, 100]: nearest, mean, farthest [N, 3]."""
    distance, rows = np.linalg.norm(offsets, axis=2), np.arange(len(offsets))
    some = dirty.max(axis=1, keepdims=True)
    nearest = np.where(dirty, distance, np.inf).argmin(axis=1)
    farthest = np.where(dirty, distance, -np.inf).argmax(axis=1)
    total = (offsets * dirty[..., None]).sum(axis=1)
    return {
        "nearest": some * offsets[rows, nearest],
        "farthest": some * offsets[rows, farthest],
        "centroid": total / np.maximum(1, dirty.sum(axis=1))[:, None],
    }
