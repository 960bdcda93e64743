"""Evaluate a policy under a suite of perturbations."""

import time

from manip.envs.external_task import ExternalTask
from manip.envs.task import Task
from manip.errors import UserError
from manip.evaluation.episodes import Episode
from manip.evaluation.robustness import Robustness, run_suite
from manip.evaluation.runners import EpisodeSettings, Progress, evaluate_policy
from manip.evaluation.stress_suite import Stress
from manip.sim.scene import load_scene
from manip.training.baselines import AnyPolicy
from manip.training.final_evaluation import (
    EvaluationOptions,
    episode_settings,
    evaluated,
)
from manip.versions import versions


def evaluate_under_stress(
    policy: AnyPolicy,
    task: Task,
    options: EvaluationOptions,
    suite: dict[str, Stress],
    progress: Progress = lambda _: None,
) -> Robustness:
    """Run the episodes without and with each perturbation of a suite.

    Args:
        policy: chooses the actions.
        task: that of the policy.
        options: the episodes of each level, the same ones.
        suite: name -> perturbation.
        progress: called with the number of episodes that have just ended.

    Raises:
        UserError: another library steps the task, or the task lacks what the policy
            observes.
    """
    if isinstance(task, ExternalTask):
        raise UserError(f"{task.name} is stepped by {task.library}: not perturbed")
    settings = episode_settings(options, policy, task)
    scene, began = None, time.monotonic()
    if options.env == "native":  # compiled once for all levels
        robot, fidelity = settings.robot, settings.fidelity
        scene = load_scene(task.robosuite_name, task.sensors, robot, fidelity)

    def run(level: EpisodeSettings) -> list[Episode]:
        return evaluate_policy(policy, level, progress, options.processes, scene)

    nominal, perturbed, left_out = run_suite(run, settings, suite)
    return Robustness(
        **evaluated(policy, settings),
        nominal=nominal,
        perturbed=perturbed,
        left_out=left_out,
        seconds=time.monotonic() - began,
        versions=versions(),
    )
