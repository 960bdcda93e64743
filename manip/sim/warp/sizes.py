"""How many constraint rows and contacts MuJoCo Warp allocates."""

from typing import NamedTuple

from manip.errors import UserError, at_least
from manip.sim.scene import Scene


class Sizes(NamedTuple):
    """Sizes of the memory of N environments, by mujoco_warp's names.

    Attributes:
        njmax: constraint rows of an environment.
        nconmax: contacts of an environment, on average over the N; pairs of geoms whose
            bounding boxes overlap count, too (the broadphase's candidates).
    """

    njmax: int
    nconmax: int


MEASURED = {
    "Door": Sizes(85, 38),
    "Lift": Sizes(57, 29),
    "NutAssemblyRound": Sizes(377, 68),
    "NutAssemblySquare": Sizes(377, 59),
    "PickGoal": Sizes(53, 36),
    "PickPlaceBread": Sizes(105, 75),
    "PickPlaceCan": Sizes(105, 73),
    "PickPlaceCereal": Sizes(105, 59),
    "PickPlaceMilk": Sizes(105, 63),
    "Push": Sizes(59, 32),
    "Reach": Sizes(24, 28),
    "Stack": Sizes(82, 33),
    "ToolHang": Sizes(393, 80),
    "Wipe": Sizes(217, 85),
}
"""robosuite's environment -> the most that 12 episodes of the expert and of random
actions needed with a Panda; pairs of geoms are counted by their bounding spheres."""

UNKNOWN = Sizes(320, 160)
"""Assumed of all other environments."""

HEAD_ROOM = 1.5
"""Allocated for what was measured."""


def sizes_of(scene: Scene, njmax: int | None, nconmax: int | None) -> Sizes:
    """The given sizes, or those that fit the scene's environment."""
    at_least(1, "njmax", 1 if njmax is None else njmax)
    at_least(1, "nconmax", 1 if nconmax is None else nconmax)
    needed = MEASURED.get(type(scene.stock).__name__, UNKNOWN)
    return Sizes(
        njmax or with_head_room(needed.njmax), nconmax or with_head_room(needed.nconmax)
    )


def with_head_room(number: float) -> int:
    """The number to allocate, a multiple of 16."""
    return 16 * -(-int(HEAD_ROOM * number) // 16)


def check_demand(sizes: Sizes, num_envs: int, rows: int, contacts: int) -> None:
    """Compare what a control period needed with what is allocated.

    Args:
        rows: the most constraint rows of any environment.
        contacts: the most contacts, or candidates, of all environments together.

    Raises:
        UserError: it was more: contacts were lost, perhaps those of other environments.
    """
    if rows > sizes.njmax:
        raise UserError(
            f"an environment needs {rows} constraint rows, and njmax is {sizes.njmax}: "
            f"give --njmax {with_head_room(rows)}"
        )
    if contacts > sizes.nconmax * num_envs:
        raise UserError(
            f"{num_envs} environments need {contacts} contacts, and nconmax is "
            f"{sizes.nconmax} for each: give --nconmax "
            f"{with_head_room(contacts / num_envs)}"
        )
