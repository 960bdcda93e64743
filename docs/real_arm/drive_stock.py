"""Stock robosuite in the place of a robot: `manip.deploy` drives it over a pipe.

    python docs/real_arm/drive_stock.py Lift lift.onnx --episodes 20

The runner is another process, in which torch, mujoco and robosuite cannot be imported.
It gets what a robot measures and answers with actions. The same episodes are then run
with the policy itself, in this process.
"""

import argparse
import json
import subprocess
import sys

import numpy as np

from manip.agents.policy import load_policy
from manip.envs import TaskEnv, make_batch
from manip.envs.episode_streams import EVALUATION
from manip.evaluation.episodes import run_episodes
from manip.sim.robosuite_log import quiet_robosuite

FORBIDDEN = ("torch", "mujoco", "robosuite", "numba", "tensordict")

RUNNER = f"""
import runpy, sys
for name in {FORBIDDEN}:
    sys.modules[name] = None  # an import of it fails
sys.argv = ["manip.deploy", sys.argv[1]]
runpy.run_module("manip.deploy", run_name="__main__")
"""


class Pipe:
    """The runner in its process: measurements in, actions out."""

    def __init__(self, path: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", RUNNER, path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def send(self, message: dict) -> None:
        """Write a line to the runner."""
        self._process.stdin.write(json.dumps(message) + "\n")
        self._process.stdin.flush()

    def step(self, measured: dict) -> dict:
        """The runner's answer to measurements."""
        self.send(measured)
        answer = json.loads(self._process.stdout.readline())
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def close(self) -> None:
        """End the runner."""
        self._process.stdin.close()
        self._process.wait(timeout=10)


def measure(batch, names) -> dict:
    """What a robot would measure now: name -> numbers."""
    read = batch.read()
    return {name: read[name][0].tolist() for name in names if name in read}


def goal_error(batch, command: dict) -> float:
    """Distance [m] of the runner's target from the goal that robosuite has set."""
    goal = batch.stock.robots[0].part_controllers["right"].goal_pos
    return float(np.abs(np.array(command["position"]) - goal).max())


def run_over_pipe(batch, path: str, names, episodes: int) -> tuple[list[bool], float]:
    """Success at the end of each episode, and the largest error of a target [m]."""
    pipe, success, worst = Pipe(path), [], 0.0
    for index in range(episodes):
        batch.restart(episode=index)
        batch.begin(np.arange(1))
        pipe.send({"reset": True})
        for _ in range(batch.horizon):
            measured = measure(batch, names - {"gripper_closing"})
            command = pipe.step(measured)
            step = batch.step(np.array([command["action"]]))
            worst = max(worst, goal_error(batch, command))
        success.append(bool(step.success[0]))
    pipe.close()
    return success, worst


def main() -> None:
    """Compare both ways of driving the same episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policy", help="run folder or name of a shipped policy")
    parser.add_argument("file", help="what `manip export` wrote of it")
    parser.add_argument("--episodes", type=int, default=20)
    options = parser.parse_args()
    quiet_robosuite()
    policy = load_policy(options.policy)
    card = policy.card
    env = TaskEnv(
        make_batch(
            card.task,
            backend="stock",
            robot=card.robot_config,
            purpose=EVALUATION,
            hard_reset=True,
        )
    )
    names = {*card.measurements}
    over, worst = run_over_pipe(env.batch, options.file, names, options.episodes)
    here = []
    for index in range(options.episodes):
        env.batch.restart(episode=index)
        here += [e.success_at_end for e in run_episodes(env, policy, 1)]
    print(f"over the pipe {sum(over)}, in this process {sum(here)} of {len(here)}")
    print(f"largest distance of a target from robosuite's goal: {worst:.1e} m")


if __name__ == "__main__":
    main()
