"""Put both nuts over their pegs. robosuite's `NutAssembly`.

Success: both nuts are on their pegs and away from the tool, as in `nut_assembly`.
Failure: none; an episode ends by its time limit.
Start: both nuts where each starts alone in `nut_assembly`, on its peg's side; the arm
    as there.
Order: the nut between the finger pads, else the square one, then the round one.
Shaped reward, in [0, 1] per step: see `one_at_a_time` and `nut_assembly_rewards`.
"""

from typing import ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Weights
from manip.rewards.kernels import near
from manip.sim.scene import Scene
from manip.tasks import nut_assembly_rewards as rewards
from manip.tasks.arm import start_qpos
from manip.tasks.experts.nut_assembly_expert import assemble_nuts
from manip.tasks.nut_assembly import (
    CENTRE,
    NutAssemblyRound,
    NutAssemblySquare,
    OneNut,
    nut_sensors,
)
from manip.tasks.nut_assembly_waypoints import NAMES
from manip.tasks.one_at_a_time import OneAtATime, of_all, sensors_of, staged_reward

Array = np.ndarray


class NutAssembly(OneAtATime):
    """Put both nuts over their pegs; see the module's docstring for the numbers."""

    robosuite_name = "NutAssembly"
    sensors = sensors_of(
        {
            "Square": nut_sensors("SquareNut", "peg1"),
            "Round": nut_sensors("RoundNut", "peg2"),
        }
    )
    parts: ClassVar[dict[str, OneNut]] = {
        "Square": NutAssemblySquare(),
        "Round": NutAssemblyRound(),
    }
    centre, object_pos = CENTRE, "nut_pos"
    proprioception = OneNut.proprioception
    horizon = 350
    milestone_names = ("near", "grasp", "lift", "over", "on_peg", "one", "both")
    waypoint_names = (*NAMES, "one")
    weights: ClassVar[Weights] = {
        "shaped": rewards.WEIGHTS["shaped"],
        "stock": {"staged": 0.35, "done": 1.0},
    }

    def sample_start(self, scene: Scene, streams: EpisodeStreams) -> Start:
        """Draw the pose of each nut as its own task does."""
        qpos = start_qpos(scene, streams)
        for task in self.parts.values():
            qpos[:, scene.free_qpos(task.body)] = task.sample_pose(streams)
        return Start(qpos)

    def stock_terms(self, m: Measures) -> dict[str, Array]:
        """Terms of robosuite's shaped reward (`NutAssembly.staged_rewards`)."""
        each, done = self.each(m), m["done"]
        below = rewards.LIFTED - of_all(each, "height")
        over = 0.2 * near(of_all(each, "aside"), 0.1)
        staged = staged_reward(each, ~done, below, lambda lift: lift + over)
        return {"staged": staged / 0.7, "done": done.mean(axis=1)}

    def expert(self, m: Measures) -> Array:
        """See `manip.tasks.experts.nut_assembly_expert`."""
        return assemble_nuts(m)
