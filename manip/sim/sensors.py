"""Which sensors a task reads, and which model fields it sets, by MuJoCo names."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Sensors:
    """What a task reads besides the arm, and what it sets, by MuJoCo names.

    bodies: name -> body; gives `<name>_pos` [3] m, `<name>_quat` [4] wxyz, and for a
        body on a free joint `<name>_linvel` [3] m/s, `<name>_angvel` [3] rad/s.
    sites: name -> site; gives `<name>_pos` [3] m.
    joints: name -> hinge or slide joint; gives `<name>_qpos` [1] and `<name>_qvel` [1]
        in rad and rad/s, or m and m/s.
    touches: name -> (side, side), a side being a geom group of the gripper (such as
        "left_fingerpad"), "arm" for the arm's links, a body with all below it ("world"
        for anything), or a geom that no body is named like; gives `<name>` [1], 1 in
        touch.
    counts: the same, but gives how many contacts there are.
    forces: name -> site; gives `<name>` [3] N, the force of the site's body on the one
        that carries it, in the site's frame.
    memory: name -> k; gives `<name>` [k], numbers that the task keeps of each world's
        episode, 0 at first (see `Task.update_memory`).
    fields: name -> (model array, object), such as ("site_pos", "goal"): entries of
        the model that every world has for itself and a reset may set.
    parked: bodies that the task drops out of the way; the fast fidelity does not hold
        them up.
    """

    bodies: Mapping[str, str] = field(default_factory=dict)
    sites: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)
    touches: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    counts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    forces: Mapping[str, str] = field(default_factory=dict)
    memory: Mapping[str, int] = field(default_factory=dict)
    fields: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    parked: tuple[str, ...] = ()
