"""Which sensors a task reads, and which model fields it sets, by MuJoCo names."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Sensors:
    """What a task reads besides the arm, and what it sets, by MuJoCo names.

    Attributes:
        bodies: name -> body; gives `<name>_pos` [3] m, `<name>_quat` [4] wxyz, and for
            a body on a free joint `<name>_linvel` [3] m/s, `<name>_angvel` [3] rad/s.
        sites: name -> site; gives `<name>_pos` [3] m.
        joints: name -> hinge or slide joint; gives `<name>_qpos` [1] and `<name>_qvel`
            [1] in rad and rad/s, or m and m/s.
        touches: name -> (side, side); gives `<name>`, 1 while the sides touch, else 0.
            A side is a geom group of the gripper (such as "left_fingerpad"), "arm" for
            the arm's links, a body with all bodies below it ("world" for anything), or
            a geom if no body has that name.
        counts: the same; gives the number of contacts instead.
        forces: name -> site; gives `<name>` [3] N, the force of the site's body on its
            parent, in the site's frame.
        memory: name -> k; gives `<name>` [k], numbers that the task stores during an
            episode, 0 when it starts (see `Task.update_memory`).
        fields: name -> (model array, object), such as ("site_pos", "goal"); gives
            `<name>` [k], entries of MjModel that differ between environments and that a
            reset may set. A reset that does not set a field puts the model's value
            back. Arrays are the float arrays that begin with `body_`, `geom_`, `site_`,
            `dof_`, `jnt_`, `actuator_`, `cam_`, `light_` or `mat_` (a `dof_` array
            takes the name of a joint and covers all its degrees of freedom). Cameras,
            lights, materials, colours and visual geoms change images only. MuJoCo's
            derived constants stay those of the compiled model (mj_setConst is not
            called): with a geom_size set its geom_rbound as well, and with a body_mass
            its body_inertia.
        parked: bodies that the task places out of the way; the fast fidelity lets them
            fall through the floor.
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
