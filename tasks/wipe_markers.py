"""Wipe's markers of dirt: where robosuite puts them, and when they are wiped."""

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures

Array = np.ndarray

MARKERS = 100
"""Number of markers (robosuite/environments/manipulation/wipe.py)."""
EDGE = 0.6 * np.array([0.25, 0.4]) - 0.02
"""Half widths [m] of the part of the table on which markers lie (ibid.)."""
SPACING = 0.005
"""Distance [m] from one marker to the next (robosuite/models/arenas/wipe_arena.py)."""
TURN_STD = 0.5
"""Standard deviation [rad] of a turn of the line of markers (ibid.)."""
STRAIGHT = 0.7
"""Probability that the line continues straight at a marker (ibid.)."""
CANDIDATES = 128
"""Turns drawn per marker. The first that stays on the table is taken."""
WIPE_HEIGHT = 0.02
"""Height [m] above the wiper's face below which a marker is wiped (wipe.py)."""


def sample_markers(streams: EpisodeStreams) -> Array:
    """[100, n, 2] m from the table's centre: positions along a random walk."""
    direction = streams.uniform(-np.pi, np.pi, 1)[:, 0]
    place = streams.uniform(-EDGE, EDGE, 2)
    bends = streams.uniform(0, 1, MARKERS).T > STRAIGHT
    drawn = streams.normal(TURN_STD, MARKERS * CANDIDATES)
    turn = drawn.reshape(-1, MARKERS, CANDIDATES)
    places = [place]
    for i in range(1, MARKERS):
        # Each candidate turns further; without a bend the first does not turn at all.
        options = np.cumsum(turn[:, i], axis=1)
        options -= np.where(bends[i], 0, options[:, 0])[:, None]
        direction, place = _next_marker(place, direction[:, None] + options)
        places.append(place)
    return np.array(places)


def _next_marker(place: Array, directions: Array) -> tuple[Array, Array]:
    """The first of directions [n, k] rad that stays on the table; the position there.

    Returns:
        [n] rad, [n, 2] m.
    """
    ways = np.stack([np.sin(directions), np.cos(directions)], axis=2)
    places = place[:, None] + SPACING * ways
    first = (np.abs(places) < EDGE).all(axis=2).argmax(axis=1)
    rows = np.arange(len(place))
    return directions[rows, first], places[rows, first]


def under_wiper(markers: Array, m: Measures) -> Array:
    """[N, 100] bool: markers [N, 100, 3] m under the wiper's face, as stock tests.

    A marker is within WIPE_HEIGHT of the face, and on the same side of all its edges.
    """
    origin = m["corner2_pos"]
    u, v = _unit(m["corner1_pos"] - origin), _unit(m["corner4_pos"] - origin)
    offsets = markers - origin[:, None]
    height = np.einsum("nki,ni->nk", offsets, _unit(np.cross(u, v)))
    corners = np.stack([m[f"corner{i}_pos"] - origin for i in (1, 2, 4, 3, 1)], axis=1)
    face, points = _project(corners, u, v), _project(offsets, u, v)
    inside: Array = (height > 0) & (height < WIPE_HEIGHT)
    for side in range(4):
        a, b = face[:, side, None], face[:, side + 1, None]
        inside = inside & (_cross(b - a, points - a) < 0)
    return inside


def _unit(vectors: Array) -> Array:
    """[n, 3]: the vectors, scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _project(points: Array, u: Array, v: Array) -> Array:
    """[N, k, 2]: points [N, k, 3] along the axes u and v [N, 3]."""
    along = [np.einsum("nki,ni->nk", points, axis) for axis in (u, v)]
    return np.stack(along, axis=2)


def _cross(a: Array, b: Array) -> Array:
    """[...]: the cross product of vectors [..., 2]."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def remaining_markers(offsets: Array, dirty: Array) -> dict[str, Array]:
    """Nearest, farthest [N, 3] and mean `centroid` [N, 3] of the dirty markers.

    offsets [N, 100, 3] m from the tool; dirty [N, 100] bool. Zeros if none is dirty.
    """
    distance, rows = np.linalg.norm(offsets, axis=2), np.arange(len(offsets))
    any_dirty = dirty.max(axis=1, keepdims=True)
    nearest = np.where(dirty, distance, np.inf).argmin(axis=1)
    farthest = np.where(dirty, distance, -np.inf).argmax(axis=1)
    total = (offsets * dirty[..., None]).sum(axis=1)
    return {
        "nearest": any_dirty * offsets[rows, nearest],
        "farthest": any_dirty * offsets[rows, farthest],
        "centroid": total / np.maximum(1, dirty.sum(axis=1))[:, None],
    }
